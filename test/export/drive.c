/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* Runs many parameter sets of one law on the same signals; compiled with -DNAME=law -DHEADER="law.h".
 *
 * Standard input, doubles but for the first three words (uint64): sets, samples, chunk; then the parameters of all
 * sets; five numbers of the start; and for each sample event (0 step, 1 hold, 2 init), command, reading and offset.
 * Standard output, for each set: the voltage of each sample, and after each chunk terms and state.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include HEADER

#define JOIN(a, b) a##_##b
#define OF(a, b) JOIN(a, b)

static void take(void *to, size_t bytes)
{
    if (fread(to, 1, bytes, stdin) != bytes)
        exit(3);
}

int main(void)
{
    uint64_t counts[3];
    take(counts, sizeof counts);
    uint64_t sets = counts[0], samples = counts[1], chunk = counts[2];
    OF(NAME, params_t) *params = calloc(sets, sizeof *params);
    double *rows = calloc(samples, 4 * sizeof *rows);
    OF(NAME, signals_start_t) start;
    if (!params || !rows)
        return 4;
    take(params, sets * sizeof *params);
    take(&start, sizeof start);
    take(rows, samples * 4 * sizeof *rows);
    for (uint64_t i = 0; i < sets; i++) {
        OF(NAME, state_t) state;
        OF(NAME, terms_t) terms;
        double voltage = 0.0;
        memset(&terms, 0, sizeof terms);
        OF(NAME, init)(params + i, &state, &start);
        for (uint64_t k = 0; k < samples; k++) {
            const double *row = rows + 4 * k;
            if (row[0] == 0.0) {
                voltage = OF(NAME, step)(params + i, &state, row[1], row[2], row[3], &terms);
            } else if (row[0] == 1.0) {
                OF(NAME, hold)(params + i, &state, row[1], row[2], voltage);
            } else {
                OF(NAME, signals_start_t) again = {row[2], voltage, row[2], row[3], row[3]};
                OF(NAME, init)(params + i, &state, &again);
            }
            fwrite(&voltage, sizeof voltage, 1, stdout);
            if ((k + 1) % chunk == 0) {
                fwrite(&terms, sizeof terms, 1, stdout);
                fwrite(&state, sizeof state, 1, stdout);
            }
        }
    }
    free(params);
    free(rows);
    return 0;
}
