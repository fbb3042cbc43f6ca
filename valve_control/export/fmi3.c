/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* FMI 3.0 for co-simulation around the sampled steps of model.h. Types and functions are declared here by hand after
 * the FMI standard, version 3.0.2 (modelica.org, whose headers are under the BSD-2 licence); none of its files is used.
 */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

typedef void *fmi3Instance;
typedef void *fmi3FMUState;
typedef void *fmi3InstanceEnvironment;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
typedef const char *fmi3String;
typedef const uint8_t *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3Callback)(void);

typedef struct {
    model_t model; /* first, as fmi.h asks for */
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance_t;

static fmi3Status refuse(fmi3Instance of, const char *text)
{
    const instance_t *c = of;
    if (c && c->log)
        c->log(c->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

#define STATUS fmi3Status
#define INSTANCE fmi3Instance
#define REFERENCE fmi3ValueReference
#define OK fmi3OK
#include "fmi.h"

const char *fmi3GetVersion(void)
{
    return "3.0";
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, bool on, size_t count, const fmi3String categories[])
{
    return fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                          bool logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    return 0;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                         bool logging, bool events, bool early, const fmi3ValueReference required[],
                                         size_t count, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3Callback update)
{
    if (events || !token || strcmp(token, MODEL_TOKEN) != 0)
        return 0;
    instance_t *made = calloc(1, sizeof *made);
    if (!made)
        return 0;
    made->log = log;
    made->environment = environment;
    model_reset(&made->model);
    return made;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                               bool logging, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3Callback update, fmi3Callback lock,
                                               fmi3Callback unlock)
{
    return 0;
}

void fmi3FreeInstance(fmi3Instance c)
{
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, bool given, fmi3Float64 tolerance, fmi3Float64 start, bool ends,
                                       fmi3Float64 stop)
{
    ((instance_t *)c)->model.time = start;
    return fmi3OK;
}

NOTHING_TO_DO(fmi3ExitInitializationMode)
NOTHING_TO_DO(fmi3Terminate)
NOTHING_TO_DO(fmi3EnterConfigurationMode)
NOTHING_TO_DO(fmi3ExitConfigurationMode)
NOTHING_TO_DO(fmi3EvaluateDiscreteStates)

#define NO_SUCH_MODE(name)                                                                                             \
    fmi3Status name(fmi3Instance c)                                                                                    \
    {                                                                                                                  \
        return refuse(c, "co-simulation without events has no such mode");                                             \
    }

NO_SUCH_MODE(fmi3EnterEventMode)
NO_SUCH_MODE(fmi3EnterStepMode)
NO_SUCH_MODE(fmi3EnterContinuousTimeMode)

fmi3Status fmi3Reset(fmi3Instance c)
{
    return reset(c);
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count, fmi3Float64 value[],
                          size_t values)
{
    return values == count ? get_numbers(c, vr, count, value) : refuse(c, "each variable has one value");
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t count, const fmi3Float64 value[],
                          size_t values)
{
    return values == count ? set_numbers(c, vr, count, value) : refuse(c, "each variable has one value");
}

#define NONE(Type, argument)                                                                                           \
    NO_VARIABLES(fmi3Get##Type, argument value[], size_t values)                                                       \
    NO_VARIABLES(fmi3Set##Type, const argument value[], size_t values)

NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(Int32, int32_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, bool)
NONE(String, fmi3String)
NO_VARIABLES(fmi3GetBinary, size_t sizes[], fmi3Binary value[], size_t values)
NO_VARIABLES(fmi3SetBinary, const size_t sizes[], const fmi3Binary value[], size_t values)
NO_VARIABLES(fmi3GetClock, bool value[])
NO_VARIABLES(fmi3SetClock, const bool value[])

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, bool keep, bool *event, bool *terminate,
                      bool *early, fmi3Float64 *last)
{
    *event = *terminate = *early = false;
    const fmi3Status status = advance(c, step);
    *last = status == fmi3OK ? time + step : time;
    return status;
}

MISSING(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *count)
MISSING(fmi3GetVariableDependencies, fmi3ValueReference vr, size_t elements[], fmi3ValueReference independents[],
        size_t independent_elements[], int kinds[], size_t count)
MISSING(fmi3GetFMUState, fmi3FMUState *state)
MISSING(fmi3SetFMUState, fmi3FMUState state)
MISSING(fmi3FreeFMUState, fmi3FMUState *state)
MISSING(fmi3SerializedFMUStateSize, fmi3FMUState state, size_t *size)
MISSING(fmi3SerializeFMUState, fmi3FMUState state, uint8_t bytes[], size_t size)
MISSING(fmi3DeserializeFMUState, const uint8_t bytes[], size_t size, fmi3FMUState *state)
MISSING(fmi3GetDirectionalDerivative, const fmi3ValueReference unknown[], size_t unknowns,
        const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 sensitivity[], size_t sensitivities)
MISSING(fmi3GetAdjointDerivative, const fmi3ValueReference unknown[], size_t unknowns,
        const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 sensitivity[], size_t sensitivities)
MISSING(fmi3GetIntervalDecimal, const fmi3ValueReference vr[], size_t count, fmi3Float64 intervals[], int qualifiers[])
MISSING(fmi3GetIntervalFraction, const fmi3ValueReference vr[], size_t count, uint64_t counters[],
        uint64_t resolutions[], int qualifiers[])
MISSING(fmi3GetShiftDecimal, const fmi3ValueReference vr[], size_t count, fmi3Float64 shifts[])
MISSING(fmi3GetShiftFraction, const fmi3ValueReference vr[], size_t count, uint64_t counters[],
        uint64_t resolutions[])
MISSING(fmi3SetIntervalDecimal, const fmi3ValueReference vr[], size_t count, const fmi3Float64 intervals[])
MISSING(fmi3SetIntervalFraction, const fmi3ValueReference vr[], size_t count, const uint64_t counters[],
        const uint64_t resolutions[])
MISSING(fmi3SetShiftDecimal, const fmi3ValueReference vr[], size_t count, const fmi3Float64 shifts[])
MISSING(fmi3SetShiftFraction, const fmi3ValueReference vr[], size_t count, const uint64_t counters[],
        const uint64_t resolutions[])
MISSING(fmi3UpdateDiscreteStates, bool *needed, bool *terminate, bool *nominals, bool *values, bool *defined,
        fmi3Float64 *next)
MISSING(fmi3CompletedIntegratorStep, bool keep, bool *event, bool *terminate)
MISSING(fmi3SetTime, fmi3Float64 time)
MISSING(fmi3SetContinuousStates, const fmi3Float64 states[], size_t count)
MISSING(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t count)
MISSING(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t count)
MISSING(fmi3GetContinuousStates, fmi3Float64 states[], size_t count)
MISSING(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t count)
MISSING(fmi3GetNumberOfEventIndicators, size_t *count)
MISSING(fmi3GetNumberOfContinuousStates, size_t *count)
MISSING(fmi3GetOutputDerivatives, const fmi3ValueReference vr[], size_t count, const int32_t orders[],
        fmi3Float64 values[], size_t number)
MISSING(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
