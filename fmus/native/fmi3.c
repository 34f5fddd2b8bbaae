/* The functions of FMI 3.0 for co-simulation. Unsupported ones are in fmi3_unsupported.c. */
#include "fmi3Functions.h"

#include "instance.h"

/* Calls a function of the instance in the allowed states. */
#define CALL(states, function) return instance_begin(c, __func__, states) ? (fmi3Status)(function) : fmi3Error

enum {
    SETTABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE,
    SAVABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE | TERMINATED
};

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    CALL(ANY_STATE, log_categories(c, loggingOn, nCategories, categories) ? FMU_OK : FMU_ERROR);
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
    return instance_refuse(&request, __func__, "this FMU is for co-simulation, not for scheduled execution");
}

void fmi3FreeInstance(fmi3Instance c) { instance_free(c); }

static fmu_status enter_initialization(instance *c, double start_time, bool has_stop_time, double stop_time)
{
    const fmu_status status = instance_setup(c, start_time, has_stop_time, stop_time);
    if (status == FMU_OK) c->state = INITIALIZATION_MODE;
    return status;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined,
                                       fmi3Float64 stopTime)
{
    CALL(INSTANTIATED, enter_initialization(c, startTime, stopTimeDefined, stopTime));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { CALL(INITIALIZATION_MODE, instance_initialized(c)); }

fmi3Status fmi3Terminate(fmi3Instance c) { CALL(STEP_MODE | FAILED, instance_terminate(c)); }

fmi3Status fmi3Reset(fmi3Instance c) { CALL(ANY_STATE, instance_reset(c)); }

#define REFERENCES fmi3Instance c, const fmi3ValueReference references[], size_t count
#define ACCESS(name, kind, format, c_type)                                                  \
    fmi3Status fmi3Get##name(REFERENCES, c_type values[], size_t nValues)                   \
    {                                                                                       \
        CALL(ANY_STATE, instance_get(c, kind, format, references, count, values, nValues)); \
    }                                                                                       \
    fmi3Status fmi3Set##name(REFERENCES, const c_type values[], size_t nValues)             \
    {                                                                                       \
        CALL(SETTABLE, instance_set(c, kind, format, references, count, values, nValues));  \
    }
ACCESS(Float64, FMU_REAL, AS_DOUBLE, fmi3Float64)
ACCESS(Int32, FMU_INTEGER, AS_INT32, fmi3Int32)
ACCESS(Int64, FMU_ENUMERATION, AS_INT64, fmi3Int64)
ACCESS(Boolean, FMU_BOOLEAN, AS_BOOL, fmi3Boolean)
ACCESS(String, FMU_STRING, AS_TEXT, fmi3String)

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *FMUState) { CALL(SAVABLE, state_get(c, FMUState)); }

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState FMUState) { CALL(ANY_STATE, state_set(c, FMUState)); }

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *FMUState)
{
    CALL(ANY_STATE, (state_free(FMUState), FMU_OK));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState FMUState, size_t *size)
{
    CALL(ANY_STATE, state_size(c, FMUState, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState FMUState, fmi3Byte state[], size_t size)
{
    CALL(ANY_STATE, state_serialize(c, FMUState, state, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte state[], size_t size, fmi3FMUState *FMUState)
{
    CALL(ANY_STATE, state_deserialize(c, state, size, FMUState));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    if (eventHandlingNeeded) *eventHandlingNeeded = fmi3False;
    if (terminateSimulation) *terminateSimulation = fmi3False;
    if (earlyReturn) *earlyReturn = fmi3False;
    const bool allowed = instance_begin(c, __func__, STEP_MODE);
    const fmu_status status = allowed ? instance_step(c, currentCommunicationPoint, communicationStepSize) : FMU_ERROR;
    if (c && lastSuccessfulTime) *lastSuccessfulTime = ((instance *)c)->f.time;
    if (status != FMU_DISCARD) return (fmi3Status)status;
    if (terminateSimulation) *terminateSimulation = fmi3True; /* the FMU cannot go on */
    return fmi3OK;
}
