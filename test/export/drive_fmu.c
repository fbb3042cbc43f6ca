/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* Runs an FMU from its sources, as a master would; compiled with -DWRAPPER="fmi2.c" -DVERSION=2, or 3.
 *
 * Each variable is read and, where it can be set, set to numbers within and out of its range. Communication steps are
 * shorter and longer than a sample. Standard output: variables that can be read and that took a number, calls refused.
 */
#include <stdio.h>

#include WRAPPER

#if VERSION == 2
typedef fmi2Component handle_t;
#define OF(name) fmi2##name
#define GET(c, vr, value) (fmi2GetReal(c, vr, 1, value) == fmi2OK)
#define SET(c, vr, value) (fmi2SetReal(c, vr, 1, value) == fmi2OK)
#define STEP(c, time, step) (fmi2DoStep(c, time, step, 1) == fmi2OK)
#else
typedef fmi3Instance handle_t;
#define OF(name) fmi3##name
#define GET(c, vr, value) (fmi3GetFloat64(c, vr, 1, value, 1) == fmi3OK)
#define SET(c, vr, value) (fmi3SetFloat64(c, vr, 1, value, 1) == fmi3OK)
#define STEP(c, time, step) (fmi3DoStep(c, time, step, 1, flags, flags + 1, flags + 2, &reached) == fmi3OK)
static bool flags[3];
static double reached;
#endif

static handle_t begun(void)
{
#if VERSION == 2
    static const fmi2CallbackFunctions callbacks = {0, 0, 0, 0, 0};
    handle_t c = fmi2Instantiate("one", 1, MODEL_TOKEN, "", &callbacks, 0, 0);
    if (c)
        fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0), fmi2EnterInitializationMode(c);
#else
    handle_t c = fmi3InstantiateCoSimulation("one", MODEL_TOKEN, "", 0, 0, 0, 0, 0, 0, 0, 0, 0);
    if (c)
        fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0);
#endif
    if (c)
        OF(ExitInitializationMode)(c);
    return c;
}

int main(void)
{
    const double tried[] = {0.0, -1.0, 3.7, 1e300, -1e300, NAN, INFINITY};
    size_t readable = 0, settable = 0, refused = 0;
    handle_t c = begun(), other = begun();
    if (!c || !other)
        return 4;
    for (int round = 0; round < 2; round++) {
        double time = 0.0, value = 0.0;
        for (unsigned k = 0; k < 1500; k++) {
            const double step = MODEL_PERIOD * (k % 3 == 0 ? 0.4 : k % 3 == 1 ? 1.0 : 7.3);
            for (unsigned vr = 1; vr <= 2; vr++)
                value = 3.0 * sin(0.01 * k + vr), refused += !SET(c, &vr, &value);
            refused += !STEP(c, time, step);
            time += step;
        }
        for (unsigned vr = 0; vr < 2000; vr++) {
            readable += (size_t)GET(c, &vr, &value);
            for (size_t i = 0; i < sizeof tried / sizeof tried[0]; i++) {
                settable += i == 2 && SET(c, &vr, tried + i);
                refused += i != 2 && !SET(c, &vr, tried + i);
                refused += vr < 40 && !STEP(c, time, MODEL_PERIOD);
            }
        }
        for (size_t i = 0; i < sizeof tried / sizeof tried[0]; i++)
            refused += tried[i] != 3.7 && !STEP(c, time, tried[i]);
        OF(Reset)(c);
    }
    OF(Terminate)(c);
    OF(FreeInstance)(c);
    OF(FreeInstance)(other);
    OF(FreeInstance)(0);
    printf("%zu %zu %zu\n", readable / 2, settable / 2, refused);
    return 0;
}
