/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* Runs the exported watch of one law with the exported valve through one fault; compiled with -DNAME=law. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "law.h"
#include "valve.h"

#define JOIN(a, b) a##_##b
#define OF(a, b) JOIN(a, b)

typedef struct {
    int64_t begin, late; /* first sample of the fault; samples by which readings are late then */
    int64_t stays, held, unpowered; /* the last sound reading is added; the spool stands; 0 V reach the valve */
    double scale, offset; /* of the reading; V */
    double grain, coulomb; /* V step of the converter, 0.0: none; V friction */
} fault_t;

void run(const fault_t *f, int64_t samples, const double *command, const double *noise, const double *beside,
         double *position, double *voltage, int8_t *off)
{
    OF(NAME, watch_state_t) s;
    valve_state_t spool;
    valve_params_t plant = valve_exported;
    double memory[VALVE_MEMORY], past[64], last = 0.0;
    memset(&s, 0, sizeof s);
    OF(NAME, watch_init)(&s);
    valve_init(&spool, memory);
    valve_set_friction_coulomb(&plant, f->coulomb);
    for (int64_t k = 0; k < samples; k++) {
        bool faulty = k >= f->begin;
        double reading = past[k % 64] = valve_read(&plant, &spool, noise[k]);
        if (!faulty)
            last = reading;
        else if (f->late)
            reading = k >= f->late ? past[(k - f->late) % 64] : 0.0;
        else
            reading = f->scale * reading + (f->stays ? last : f->offset);
        reading += beside[k];
        if (f->grain > 0.0)
            reading = f->grain * floor(reading / f->grain + 0.5);
        OF(NAME, watch_command)(&OF(NAME, exported), &s, command[k]);
        voltage[k] = OF(NAME, watch_sample)(&OF(NAME, exported), &s, reading, 0);
        position[k] = spool.x.x0;
        off[k] = s.trust.blocked != 0;
        if (!(faulty && f->held))
            valve_step(&plant, &spool, faulty && f->unpowered ? 0.0 : voltage[k]);
    }
}
