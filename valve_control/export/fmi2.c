/* SPDX-FileCopyrightText: 2026 valve_control developers */
/* SPDX-License-Identifier: Apache-2.0 */
/* FMI 2.0 for co-simulation around the sampled steps of model.h. Types and functions are declared here by hand after
 * the FMI standard, version 2.0.4 (modelica.org, whose headers are under the BSD-2 licence); none of its files is used.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

typedef void *fmi2Component;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef int fmi2Type;
typedef int fmi2StatusKind;
typedef struct {
    void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    model_t model; /* first, as fmi.h asks for */
    const fmi2CallbackFunctions *callbacks;
    char *name;
} component_t;

static fmi2Status refuse(fmi2Component of, const char *text)
{
    const component_t *c = of;
    if (c && c->callbacks && c->callbacks->logger)
        c->callbacks->logger(c->callbacks->componentEnvironment, c->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

#define STATUS fmi2Status
#define INSTANCE fmi2Component
#define REFERENCE fmi2ValueReference
#define OK fmi2OK
#include "fmi.h"

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    if (type != 1 || !guid || strcmp(guid, MODEL_TOKEN) != 0 || !name)
        return 0;
    component_t *made = calloc(1, sizeof *made);
    if (!made)
        return 0;
    made->name = malloc(strlen(name) + 1);
    if (!made->name) {
        free(made);
        return 0;
    }
    strcpy(made->name, name);
    made->callbacks = callbacks;
    model_reset(&made->model);
    return made;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (c)
        free(((component_t *)c)->name);
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean ends, fmi2Real stop)
{
    ((component_t *)c)->model.time = start;
    return fmi2OK;
}

NOTHING_TO_DO(fmi2EnterInitializationMode)
NOTHING_TO_DO(fmi2ExitInitializationMode)
NOTHING_TO_DO(fmi2Terminate)

fmi2Status fmi2Reset(fmi2Component c)
{
    return reset(c);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, fmi2Real value[])
{
    return get_numbers(c, vr, count, value);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Real value[])
{
    return set_numbers(c, vr, count, value);
}

NO_VARIABLES(fmi2GetInteger, fmi2Integer value[])
NO_VARIABLES(fmi2SetInteger, const fmi2Integer value[])
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean value[])
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean value[])
NO_VARIABLES(fmi2GetString, fmi2String value[])
NO_VARIABLES(fmi2SetString, const fmi2String value[])

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep)
{
    return advance(c, step);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "no step is pending");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != 2)
        return fmi2Discard;
    *value = ((component_t *)c)->model.time; /* fmi2LastSuccessfulTime */
    return fmi2OK;
}

#define NO_STATUS(name, argument)                                                                                      \
    fmi2Status name(fmi2Component c, const fmi2StatusKind kind, argument *value)                                        \
    {                                                                                                                  \
        return fmi2Discard;                                                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)

MISSING(fmi2GetFMUstate, fmi2FMUstate *state)
MISSING(fmi2SetFMUstate, fmi2FMUstate state)
MISSING(fmi2FreeFMUstate, fmi2FMUstate *state)
MISSING(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
MISSING(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
MISSING(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
MISSING(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t unknowns,
        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[], fmi2Real sensitivity[])
MISSING(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[],
        const fmi2Real value[])
MISSING(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[],
        fmi2Real value[])
