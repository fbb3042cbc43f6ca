/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* The batch's closed loop around the exported C of a law and of the valve; one valve after the other.
 *
 * Compiled with -DLAW=arc -DLAW_SOURCE="arc.c". The structs of the parameters have the fields of the NamedTuples in
 * their order, all doubles. Noise comes from numpy's own C library (libnpyrandom) with the generators of numpy, so
 * that results can be compared. The sources are those that valve-control export writes, included here so that the
 * compiler sees law and valve at once, as in the batch.
 */
#include LAW_SOURCE
#include "valve.c"

typedef struct bitgen bitgen;
void random_standard_normal_fill(bitgen *, intptr_t, double *);

#define JOIN(a, b) a##_##b
#define OF(a, b) JOIN(a, b)

/* What the caller's rows must have, or they were not these structs. */
intptr_t bytes_law(void) { return sizeof(OF(LAW, params_t)); }
intptr_t bytes_valve(void) { return sizeof(valve_params_t); }

/* Indices e_M, e_F, e_rms, u_rms, c_u of `count` valves of n samples each; noise is a buffer of n. */
void run(const OF(LAW, params_t) *laws, const valve_params_t *valves, bitgen **generators, intptr_t count,
         const double *commands, double *noise, intptr_t n, intptr_t last_begin, double *indices)
{
    for (intptr_t i = 0; i < count; i++) {
        double memory[VALVE_MEMORY];
        valve_state_t spool;
        OF(LAW, state_t) state;
        double most = 0.0, final = 0.0, squares = 0.0, voltages = 0.0, changes = 0.0, before = 0.0;
        random_standard_normal_fill(generators[i], n, noise);
        valve_init(&spool, memory);
        double first = valve_read(valves + i, &spool, noise[0]);
        OF(LAW, signals_start_t) start = {first, 0.0, first, 0.0, 0.0};
        OF(LAW, init)(laws + i, &state, &start);
        for (intptr_t k = 0; k < n; k++) {
            double measurement = valve_read(valves + i, &spool, noise[k]);
            double voltage = OF(LAW, step)(laws + i, &state, commands[k], measurement, 0.0, 0);
            double error = fabs(measurement - commands[k]);
            double change = k > 0 ? voltage - before : 0.0;
            if (error > most)
                most = error;
            if (k >= last_begin && error > final)
                final = error;
            squares += error * error;
            voltages += voltage * voltage;
            changes += change * change;
            before = voltage;
            valve_step(valves + i, &spool, voltage);
        }
        double u_rms = sqrt(voltages / n);
        indices[5 * i] = most;
        indices[5 * i + 1] = final;
        indices[5 * i + 2] = sqrt(squares / n);
        indices[5 * i + 3] = u_rms;
        indices[5 * i + 4] = u_rms > 0.0 ? sqrt(changes / (n - 1)) / u_rms : 0.0;
    }
}
