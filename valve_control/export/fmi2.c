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
    model_t model;
    const fmi2CallbackFunctions *callbacks;
    char *name;
} component_t;

static fmi2Status refuse(component_t *c, const char *text)
{
    if (c && c->callbacks && c->callbacks->logger)
        c->callbacks->logger(c->callbacks->componentEnvironment, c->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

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
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
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
    (void)given, (void)tolerance, (void)ends, (void)stop;
    ((component_t *)c)->model.time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    model_reset(&((component_t *)c)->model);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, fmi2Real value[])
{
    for (size_t i = 0; i < count; i++)
        if (!model_get(&((component_t *)c)->model, vr[i], value + i))
            return refuse(c, "there is no variable of this value reference");
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Real value[])
{
    for (size_t i = 0; i < count; i++)
        if (!model_set(&((component_t *)c)->model, vr[i], value[i]))
            return refuse(c, "the variable cannot be set, or the value is out of its range");
    return fmi2OK;
}

#define NONE(Type, argument)                                                                                           \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t count, argument value[])             \
    {                                                                                                                  \
        (void)vr, (void)value;                                                                                         \
        return count ? refuse(c, "all variables are Real") : fmi2OK;                                                   \
    }                                                                                                                  \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t count, const argument value[])       \
    {                                                                                                                  \
        (void)vr, (void)value;                                                                                         \
        return count ? refuse(c, "all variables are Real") : fmi2OK;                                                   \
    }

NONE(Integer, fmi2Integer)
NONE(Boolean, fmi2Boolean)
NONE(String, fmi2String)

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep)
{
    (void)time, (void)keep;
    component_t *own = c;
    if (!model_advance(&own->model, step))
        return refuse(own, "the communication step must be above 0 s, and at most 1e9 sample periods");
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "no step is pending");
}

#define STATUS(Type, argument)                                                                                         \
    fmi2Status fmi2Get##Type##Status(fmi2Component c, const fmi2StatusKind kind, argument *value)                        \
    {                                                                                                                  \
        (void)c, (void)kind, (void)value;                                                                              \
        return fmi2Discard;                                                                                            \
    }

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != 2)
        return fmi2Discard;
    *value = ((component_t *)c)->model.time; /* fmi2LastSuccessfulTime */
    return fmi2OK;
}

STATUS(Integer, fmi2Integer)
STATUS(Boolean, fmi2Boolean)
STATUS(String, fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)state;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    (void)state;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)state;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)state, (void)size;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)state, (void)bytes, (void)size;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    (void)bytes, (void)size, (void)state;
    return refuse(c, "states cannot be kept");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real sensitivity[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)sensitivity;
    return refuse(c, "a sampled law has no derivatives");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)count, (void)order, (void)value;
    return refuse(c, "inputs are held over a step");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t count,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)count, (void)order, (void)value;
    return refuse(c, "a sampled law has no derivatives");
}
