/* FMI 2.0 for co-simulation, of the unit in fmu_unit.h. Source: Functional Mock-up Interface 2.0.4, chapters 2 and 4. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_unit.h"

typedef void *fmi2Component;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String message, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(void *environment, fmi2Status status);
    void *environment;
} fmi2CallbackFunctions;

#define EXPORT __attribute__((visibility("default")))

typedef struct {
    instance_t instance;
    const fmi2CallbackFunctions *functions;
    char name[128];
} component_t;

static fmi2Status fail(fmi2Component c, fmi2String message)
{
    component_t *component = c;
    if (component->functions != NULL && component->functions->logger != NULL) {
        component->functions->logger(
            component->functions->environment, component->name, fmi2Error, "error", "%s", message);
    }
    return fmi2Error;
}

@SHARED@

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT fmi2Component fmi2Instantiate(
    fmi2String name, fmi2Type type, fmi2String token, fmi2String resources, const fmi2CallbackFunctions *functions,
    fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || token == NULL || strcmp(token, TOKEN) != 0) {
        return NULL;
    }
    component_t *component = calloc(1, sizeof(component_t));
    if (component != NULL) {
        component->functions = functions;
        strncpy(component->name, name != NULL ? name : "", sizeof(component->name) - 1);
        begin(&component->instance);
    }
    return component;
}

EXPORT void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

EXPORT fmi2Status fmi2SetupExperiment(
    fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((component_t *)c)->instance.time = start;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, fmi2Real value[])
{
    return get(c, vr, count, value);
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Real value[])
{
    return put(c, vr, count, value);
}

#define NONE(name, type)                                                                                               \
    EXPORT fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t count, type value[])                 \
    {                                                                                                                  \
        (void)vr, (void)value;                                                                                         \
        return count == 0 ? fmi2OK : fail(c, #name ": all variables are of type Real");                                \
    }

NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2SetString, const fmi2String)

EXPORT fmi2Status fmi2GetDirectionalDerivative(
    fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns, const fmi2ValueReference known[],
    size_t knowns, const fmi2Real change[], fmi2Real found[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)change, (void)found;
    return fail(c, "fmi2GetDirectionalDerivative: not provided");
}

EXPORT fmi2Status fmi2SetRealInputDerivatives(
    fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)count, (void)order, (void)value;
    return fail(c, "fmi2SetRealInputDerivatives: inputs are held between steps");
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(
    fmi2Component c, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)count, (void)order, (void)value;
    return fail(c, "fmi2GetRealOutputDerivatives: not provided");
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real length, fmi2Boolean no_state_before)
{
    (void)no_state_before;
    const char *message = advance(&((component_t *)c)->instance, time, length);
    return message == NULL ? fmi2OK : fail(c, message);
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c)
{
    return fail(c, "fmi2CancelStep: a step is never pending");
}

#define STATUS(name, type)                                                                                             \
    EXPORT fmi2Status name(fmi2Component c, const fmi2StatusKind kind, type *value)                                    \
    {                                                                                                                  \
        (void)c, (void)kind, (void)value;                                                                              \
        return fmi2Discard;                                                                                            \
    }

STATUS(fmi2GetStatus, fmi2Status)
STATUS(fmi2GetIntegerStatus, fmi2Integer)
STATUS(fmi2GetBooleanStatus, fmi2Boolean)
STATUS(fmi2GetStringStatus, fmi2String)

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    *value = ((component_t *)c)->instance.time;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
