/* The functions of FMI 2.0 for co-simulation. */
#include "fmi2Functions.h"

#include "instance.h"

/* Calls a function of the instance in the allowed states. */
#define CALL(states, function) return instance_begin(c, __func__, states) ? (fmi2Status)(function) : fmi2Error

enum {
    SETTABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE,
    SAVABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE | TERMINATED
};

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    CALL(ANY_STATE, log_categories(c, loggingOn, nCategories, categories) ? FMU_OK : FMU_ERROR);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    const instance_request request = {
        .version = 2, .name = instanceName, .token = fmuGUID, .resources = fmuResourceLocation,
        .log2 = functions ? functions->logger : NULL,
        .environment = functions ? functions->componentEnvironment : NULL, .logging = loggingOn};
    if (fmuType != fmi2CoSimulation)
        return instance_refuse(&request, __func__, "this FMU is for co-simulation, not for model exchange");
    return instance_create(&request, __func__);
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    CALL(INSTANTIATED, instance_setup(c, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    CALL(INSTANTIATED, (((instance *)c)->state = INITIALIZATION_MODE, FMU_OK));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { CALL(INITIALIZATION_MODE, instance_initialized(c)); }

fmi2Status fmi2Terminate(fmi2Component c) { CALL(STEP_MODE | FAILED, instance_terminate(c)); }

fmi2Status fmi2Reset(fmi2Component c) { CALL(ANY_STATE, instance_reset(c)); }

#define REFERENCES fmi2Component c, const fmi2ValueReference vr[], size_t nvr
#define ACCESS(name, kind, format, c_type)                                    \
    fmi2Status fmi2Get##name(REFERENCES, c_type value[])                      \
    {                                                                         \
        CALL(ANY_STATE, instance_get(c, kind, format, vr, nvr, value, nvr));  \
    }                                                                         \
    fmi2Status fmi2Set##name(REFERENCES, const c_type value[])                \
    {                                                                         \
        CALL(SETTABLE, instance_set(c, kind, format, vr, nvr, value, nvr));   \
    }
ACCESS(Real, FMU_REAL, AS_DOUBLE, fmi2Real)
ACCESS(Integer, FMU_INTEGER, AS_INT, fmi2Integer)
ACCESS(Boolean, FMU_BOOLEAN, AS_INT, fmi2Boolean)
ACCESS(String, FMU_STRING, AS_TEXT, fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) { CALL(SAVABLE, state_get(c, FMUstate)); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) { CALL(ANY_STATE, state_set(c, FMUstate)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    CALL(ANY_STATE, (state_free(FMUstate), FMU_OK));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    CALL(ANY_STATE, state_size(c, FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte state[], size_t size)
{
    CALL(ANY_STATE, state_serialize(c, FMUstate, (unsigned char *)state, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte state[], size_t size, fmi2FMUstate *FMUstate)
{
    CALL(ANY_STATE, state_deserialize(c, (const unsigned char *)state, size, FMUstate));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    CALL(STEP_MODE, instance_step(c, currentCommunicationPoint, communicationStepSize));
}

/* ---- steps are never pending: only the last successful time and `terminated` are available ---- */

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    if (c && (s != fmi2LastSuccessfulTime || !value)) return fmi2Discard;
    CALL(ANY_STATE, (*value = ((instance *)c)->f.time, FMU_OK));
}

/* Whether the last step was discarded, since the FMU cannot go on. */
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    if (c && (s != fmi2Terminated || !value)) return fmi2Discard;
    CALL(ANY_STATE, (*value = ((instance *)c)->ended, FMU_OK));
}

#define DISCARDED(name, c_type) \
    fmi2Status name(fmi2Component c, const fmi2StatusKind s, c_type *value) \
    {                                                                       \
        (void)c, (void)s, (void)value;                                      \
        return fmi2Discard;                                                 \
    }
DISCARDED(fmi2GetStatus, fmi2Status)
DISCARDED(fmi2GetIntegerStatus, fmi2Integer)
DISCARDED(fmi2GetStringStatus, fmi2String)

/* ---- unsupported: each logs that and returns an error ---- */

#define UNSUPPORTED(name, why, ...) \
    fmi2Status name(__VA_ARGS__) { CALL(ANY_STATE, fmu_error(c, "%s", why)); }
UNSUPPORTED(fmi2CancelStep, "steps are not asynchronous", fmi2Component c)
UNSUPPORTED(fmi2GetDirectionalDerivative, "providesDirectionalDerivative is false", REFERENCES,
            const fmi2ValueReference known[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
UNSUPPORTED(fmi2SetRealInputDerivatives, "canInterpolateInputs is false", REFERENCES, const fmi2Integer order[],
            const fmi2Real value[])
UNSUPPORTED(fmi2GetRealOutputDerivatives, "maxOutputDerivativeOrder is 0", REFERENCES,
            const fmi2Integer order[], fmi2Real value[])

/* For importers that require all functions of the standard. */
#define NO_MODEL_EXCHANGE(name, ...) \
    UNSUPPORTED(name, "this FMU is for co-simulation, not for model exchange", __VA_ARGS__)
NO_MODEL_EXCHANGE(fmi2EnterEventMode, fmi2Component c)
NO_MODEL_EXCHANGE(fmi2NewDiscreteStates, fmi2Component c, fmi2EventInfo *eventInfo)
NO_MODEL_EXCHANGE(fmi2EnterContinuousTimeMode, fmi2Component c)
NO_MODEL_EXCHANGE(fmi2CompletedIntegratorStep, fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                  fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
NO_MODEL_EXCHANGE(fmi2SetTime, fmi2Component c, fmi2Real time)
NO_MODEL_EXCHANGE(fmi2SetContinuousStates, fmi2Component c, const fmi2Real x[], size_t nx)
NO_MODEL_EXCHANGE(fmi2GetDerivatives, fmi2Component c, fmi2Real derivatives[], size_t nx)
NO_MODEL_EXCHANGE(fmi2GetEventIndicators, fmi2Component c, fmi2Real eventIndicators[], size_t ni)
NO_MODEL_EXCHANGE(fmi2GetContinuousStates, fmi2Component c, fmi2Real x[], size_t nx)
NO_MODEL_EXCHANGE(fmi2GetNominalsOfContinuousStates, fmi2Component c, fmi2Real nominals[], size_t nx)
