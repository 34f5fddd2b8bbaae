/* The functions of FMI 3.0 for co-simulation. Unsupported ones are in fmi3_unsupported.c. */
#include "fmi3Functions.h"

#include "instance.h"

#define BEGIN(states) \
    if (!instance_begin(instance_, __func__, states)) return fmi3Error
#define instance_ ((instance *)c)

enum {
    SETTABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE,
    SAVABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE | TERMINATED
};

static fmi3Status status_of(fmu_status status) { return (fmi3Status)status; }

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    BEGIN(ANY_STATE);
    return log_categories(c, loggingOn, nCategories, categories) ? fmi3OK : fmi3Error;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    const instance_request request = {
        .version = 3, .name = instanceName, .token = instantiationToken, .resources = resourcePath,
        .log3 = logMessage, .environment = instanceEnvironment, .logging = loggingOn};
    (void)visible, (void)earlyReturnAllowed; /* no step ever returns early */
    (void)requiredIntermediateVariables, (void)intermediateUpdate;
    if (eventModeUsed)
        return instance_refuse(&request, __func__, "eventModeUsed is true, but hasEventMode is false");
    if (nRequiredIntermediateVariables > 0)
        return instance_refuse(&request, __func__, "intermediate variables are required, but "
                               "providesIntermediateUpdate is false");
    return instance_create(&request, __func__);
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    const instance_request request = {.version = 3, .name = instanceName, .log3 = logMessage,
                                      .environment = instanceEnvironment};
    (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    return instance_refuse(&request, __func__, "this FMU is for co-simulation, not for model exchange");
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption)
{
    const instance_request request = {.version = 3, .name = instanceName, .log3 = logMessage,
                                      .environment = instanceEnvironment};
    (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn, (void)clockUpdate;
    (void)lockPreemption, (void)unlockPreemption;
    return instance_refuse(&request, __func__, "this FMU is for co-simulation, not for scheduled execution");
}

void fmi3FreeInstance(fmi3Instance c) { instance_free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined,
                                       fmi3Float64 stopTime)
{
    (void)toleranceDefined, (void)tolerance;
    BEGIN(INSTANTIATED);
    const fmu_status status = instance_setup(c, startTime, stopTimeDefined, stopTime);
    if (status == FMU_OK) instance_->state = INITIALIZATION_MODE;
    return status_of(status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    BEGIN(INITIALIZATION_MODE);
    return status_of(instance_initialized(c));
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    BEGIN(STEP_MODE | FAILED);
    return status_of(instance_terminate(c));
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    BEGIN(ANY_STATE);
    return status_of(instance_reset(c));
}

#define ACCESS(name, kind, format, c_type)                                                         \
    fmi3Status fmi3Get##name(fmi3Instance c, const fmi3ValueReference valueReferences[],           \
                             size_t nValueReferences, c_type values[], size_t nValues)             \
    {                                                                                              \
        BEGIN(ANY_STATE);                                                                          \
        return status_of(                                                                          \
            instance_get(c, kind, format, valueReferences, nValueReferences, values, nValues));    \
    }                                                                                              \
    fmi3Status fmi3Set##name(fmi3Instance c, const fmi3ValueReference valueReferences[],           \
                             size_t nValueReferences, const c_type values[], size_t nValues)       \
    {                                                                                              \
        BEGIN(SETTABLE);                                                                           \
        return status_of(                                                                          \
            instance_set(c, kind, format, valueReferences, nValueReferences, values, nValues));    \
    }
ACCESS(Float64, FMU_REAL, AS_DOUBLE, fmi3Float64)
ACCESS(Int32, FMU_INTEGER, AS_INT32, fmi3Int32)
ACCESS(Int64, FMU_ENUMERATION, AS_INT64, fmi3Int64)
ACCESS(Boolean, FMU_BOOLEAN, AS_BOOL, fmi3Boolean)

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, fmi3String values[], size_t nValues)
{
    BEGIN(ANY_STATE);
    return status_of(instance_get_texts(c, valueReferences, nValueReferences, values, nValues));
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, const fmi3String values[], size_t nValues)
{
    BEGIN(SETTABLE);
    return status_of(instance_set_texts(c, valueReferences, nValueReferences, values, nValues));
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *FMUState)
{
    BEGIN(SAVABLE);
    return status_of(state_get(c, FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState FMUState)
{
    BEGIN(ANY_STATE);
    return status_of(state_set(c, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *FMUState)
{
    BEGIN(ANY_STATE);
    state_free(FMUState);
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState FMUState, size_t *size)
{
    BEGIN(ANY_STATE);
    return status_of(state_size(c, FMUState, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size)
{
    BEGIN(ANY_STATE);
    return status_of(state_serialize(c, FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    BEGIN(ANY_STATE);
    return status_of(state_deserialize(c, serializedState, size, FMUState));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    if (eventHandlingNeeded) *eventHandlingNeeded = fmi3False;
    if (terminateSimulation) *terminateSimulation = fmi3False;
    if (earlyReturn) *earlyReturn = fmi3False;
    if (c && lastSuccessfulTime) *lastSuccessfulTime = instance_->f.time;
    BEGIN(STEP_MODE);
    const fmu_status status = instance_step(c, currentCommunicationPoint, communicationStepSize);
    if (lastSuccessfulTime) *lastSuccessfulTime = instance_->f.time;
    return status_of(status);
}
