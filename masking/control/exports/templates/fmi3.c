/* FMI 3.0 for co-simulation, of the unit in fmu_unit.h. Source: Functional Mock-up Interface 3.0, chapters 2 and 4. */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_unit.h"

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(
    fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment environment);
typedef void (*fmi3IntermediateUpdateCallback)(
    fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean is_set, fmi3Boolean is_got,
    fmi3Boolean is_finished, fmi3Boolean may_return, fmi3Boolean *returns, fmi3Float64 *return_time);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

#define EXPORT __attribute__((visibility("default")))

typedef struct {
    instance_t instance;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} component_t;

static fmi3Status fail(fmi3Instance instance, fmi3String message)
{
    component_t *component = instance;
    if (component->log != NULL) {
        component->log(component->environment, fmi3Error, "error", message);
    }
    return fmi3Error;
}

@SHARED@

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)early, (void)required, (void)count, (void)update;
    if (events || token == NULL || strcmp(token, TOKEN) != 0) {
        return NULL;
    }
    component_t *component = calloc(1, sizeof(component_t));
    if (component != NULL) {
        component->environment = environment;
        component->log = log;
        begin(&component->instance);
    }
    return component;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return NULL;
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

EXPORT void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

EXPORT fmi3Status fmi3EnterInitializationMode(
    fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop,
    fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((component_t *)instance)->instance.time = start;
    return fmi3OK;
}

EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, fmi3Float64 values[], size_t length)
{
    if (count != length) {
        return fail(instance, "fmi3GetFloat64: give one value for each value reference");
    }
    return get(instance, vr, count, values);
}

EXPORT fmi3Status fmi3SetFloat64(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, const fmi3Float64 values[], size_t length)
{
    if (count != length) {
        return fail(instance, "fmi3SetFloat64: give one value for each value reference");
    }
    return put(instance, vr, count, values);
}

#define NONE(name, type)                                                                                               \
    EXPORT fmi3Status name(                                                                                            \
        fmi3Instance instance, const fmi3ValueReference vr[], size_t count, type values[], size_t length)              \
    {                                                                                                                  \
        (void)vr, (void)values, (void)length;                                                                          \
        return count == 0 ? fmi3OK : fail(instance, #name ": all variables are of type Float64");                      \
    }

NONE(fmi3GetFloat32, fmi3Float32)
NONE(fmi3SetFloat32, const fmi3Float32)
NONE(fmi3GetInt8, fmi3Int8)
NONE(fmi3SetInt8, const fmi3Int8)
NONE(fmi3GetUInt8, fmi3UInt8)
NONE(fmi3SetUInt8, const fmi3UInt8)
NONE(fmi3GetInt16, fmi3Int16)
NONE(fmi3SetInt16, const fmi3Int16)
NONE(fmi3GetUInt16, fmi3UInt16)
NONE(fmi3SetUInt16, const fmi3UInt16)
NONE(fmi3GetInt32, fmi3Int32)
NONE(fmi3SetInt32, const fmi3Int32)
NONE(fmi3GetUInt32, fmi3UInt32)
NONE(fmi3SetUInt32, const fmi3UInt32)
NONE(fmi3GetInt64, fmi3Int64)
NONE(fmi3SetInt64, const fmi3Int64)
NONE(fmi3GetUInt64, fmi3UInt64)
NONE(fmi3SetUInt64, const fmi3UInt64)
NONE(fmi3GetBoolean, fmi3Boolean)
NONE(fmi3SetBoolean, const fmi3Boolean)
NONE(fmi3GetString, fmi3String)
NONE(fmi3SetString, const fmi3String)

EXPORT fmi3Status fmi3GetBinary(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, size_t sizes[], fmi3Binary values[],
    size_t length)
{
    (void)vr, (void)sizes, (void)values, (void)length;
    return count == 0 ? fmi3OK : fail(instance, "fmi3GetBinary: all variables are of type Float64");
}

EXPORT fmi3Status fmi3SetBinary(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, const size_t sizes[],
    const fmi3Binary values[], size_t length)
{
    (void)vr, (void)sizes, (void)values, (void)length;
    return count == 0 ? fmi3OK : fail(instance, "fmi3SetBinary: all variables are of type Float64");
}

EXPORT fmi3Status fmi3GetClock(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, fmi3Clock values[])
{
    (void)vr, (void)values;
    return count == 0 ? fmi3OK : fail(instance, "fmi3GetClock: there are no clocks");
}

EXPORT fmi3Status fmi3SetClock(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t count, const fmi3Clock values[])
{
    (void)vr, (void)values;
    return count == 0 ? fmi3OK : fail(instance, "fmi3SetClock: there are no clocks");
}

EXPORT fmi3Status fmi3DoStep(
    fmi3Instance instance, fmi3Float64 time, fmi3Float64 length, fmi3Boolean no_state_before, fmi3Boolean *event,
    fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)no_state_before;
    component_t *component = instance;
    const char *message = advance(&component->instance, time, length);
    *event = *terminate = *early = false;
    *last = component->instance.time;
    return message == NULL ? fmi3OK : fail(instance, message);
}

/* What the standard wants to be there, of capabilities that this FMU does not have. */
#define ABSENT(name, ...)                                                                                              \
    EXPORT fmi3Status name(__VA_ARGS__);                                                                               \
    EXPORT fmi3Status name(__VA_ARGS__)                                                                                \
    {                                                                                                                  \
        return fmi3Error;                                                                                              \
    }

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

ABSENT(fmi3EnterEventMode, fmi3Instance instance)
ABSENT(fmi3GetNumberOfVariableDependencies, fmi3Instance instance, fmi3ValueReference valueReference,
    size_t* nDependencies)
ABSENT(fmi3GetVariableDependencies, fmi3Instance instance, fmi3ValueReference dependent,
    size_t elementIndicesOfDependent[], fmi3ValueReference independents[], size_t elementIndicesOfIndependents[],
    fmi3DependencyKind dependencyKinds[], size_t nDependencies)
ABSENT(fmi3GetDirectionalDerivative, fmi3Instance instance, const fmi3ValueReference unknowns[],
    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
    fmi3Float64 sensitivity[], size_t nSensitivity)
ABSENT(fmi3GetAdjointDerivative, fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
    fmi3Float64 sensitivity[], size_t nSensitivity)
ABSENT(fmi3EnterConfigurationMode, fmi3Instance instance)
ABSENT(fmi3ExitConfigurationMode, fmi3Instance instance)
ABSENT(fmi3GetIntervalDecimal, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetIntervalFraction, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
    fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetShiftDecimal, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3Float64 shifts[])
ABSENT(fmi3GetShiftFraction, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
ABSENT(fmi3SetIntervalDecimal, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Float64 intervals[])
ABSENT(fmi3SetIntervalFraction, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3SetShiftDecimal, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Float64 shifts[])
ABSENT(fmi3SetShiftFraction, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3EvaluateDiscreteStates, fmi3Instance instance)
ABSENT(fmi3UpdateDiscreteStates, fmi3Instance instance, fmi3Boolean* discreteStatesNeedUpdate,
    fmi3Boolean* terminateSimulation, fmi3Boolean* nominalsOfContinuousStatesChanged,
    fmi3Boolean* valuesOfContinuousStatesChanged, fmi3Boolean* nextEventTimeDefined, fmi3Float64* nextEventTime)
ABSENT(fmi3EnterContinuousTimeMode, fmi3Instance instance)
ABSENT(fmi3CompletedIntegratorStep, fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
    fmi3Boolean* enterEventMode, fmi3Boolean* terminateSimulation)
ABSENT(fmi3SetTime, fmi3Instance instance, fmi3Float64 time)
ABSENT(fmi3SetContinuousStates, fmi3Instance instance, const fmi3Float64 continuousStates[], size_t nContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives, fmi3Instance instance, fmi3Float64 derivatives[], size_t nContinuousStates)
ABSENT(fmi3GetEventIndicators, fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
ABSENT(fmi3GetContinuousStates, fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates, fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators, fmi3Instance instance, size_t* nEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates, fmi3Instance instance, size_t* nContinuousStates)
ABSENT(fmi3GetOutputDerivatives, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues)
ABSENT(fmi3ActivateModelPartition, fmi3Instance instance, fmi3ValueReference clockReference,
    fmi3Float64 activationTime)
