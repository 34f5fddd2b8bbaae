/* The functions of FMI 2.0 for co-simulation. */
#include "fmi2Functions.h"

#include "instance.h"

/* Allowed in any state, except where noted at the function. */
#define BEGIN(states) \
    if (!instance_begin(c, __func__, states)) return fmi2Error

enum {
    SETTABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE,
    SAVABLE = INSTANTIATED | INITIALIZATION_MODE | STEP_MODE | TERMINATED
};

static fmi2Status status_of(fmu_status status) { return (fmi2Status)status; }

static fmi2Status unsupported(instance *c, const char *function, const char *why)
{
    if (!instance_begin(c, function, ANY_STATE)) return fmi2Error;
    return status_of(fmu_error(&c->f, "%s", why));
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    BEGIN(ANY_STATE);
    return log_categories(c, loggingOn, nCategories, categories) ? fmi2OK : fmi2Error;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    const instance_request request = {
        .version = 2, .name = instanceName, .token = fmuGUID, .resources = fmuResourceLocation,
        .log2 = functions ? functions->logger : NULL,
        .environment = functions ? functions->componentEnvironment : NULL, .logging = loggingOn};
    (void)visible;
    if (fmuType != fmi2CoSimulation)
        return instance_refuse(&request, __func__, "this FMU is for co-simulation, not for model exchange");
    return instance_create(&request, __func__);
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined, (void)tolerance;
    BEGIN(INSTANTIATED);
    return status_of(instance_setup(c, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    BEGIN(INSTANTIATED);
    ((instance *)c)->state = INITIALIZATION_MODE;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    BEGIN(INITIALIZATION_MODE);
    return status_of(instance_initialized(c));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    BEGIN(STEP_MODE | FAILED);
    return status_of(instance_terminate(c));
}

fmi2Status fmi2Reset(fmi2Component c)
{
    BEGIN(ANY_STATE);
    return status_of(instance_reset(c));
}

#define ACCESS(name, kind, format, c_type)                                                               \
    fmi2Status fmi2Get##name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, c_type value[]) \
    {                                                                                                    \
        BEGIN(ANY_STATE);                                                                                \
        return status_of(instance_get(c, kind, format, vr, nvr, value, nvr));                            \
    }                                                                                                    \
    fmi2Status fmi2Set##name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,                 \
                             const c_type value[])                                                       \
    {                                                                                                    \
        BEGIN(SETTABLE);                                                                                 \
        return status_of(instance_set(c, kind, format, vr, nvr, value, nvr));                            \
    }
ACCESS(Real, FMU_REAL, AS_DOUBLE, fmi2Real)
ACCESS(Integer, FMU_INTEGER, AS_INT, fmi2Integer)
ACCESS(Boolean, FMU_BOOLEAN, AS_INT, fmi2Boolean)

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    BEGIN(ANY_STATE);
    return status_of(instance_get_texts(c, vr, nvr, value, nvr));
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[])
{
    BEGIN(SETTABLE);
    return status_of(instance_set_texts(c, vr, nvr, value, nvr));
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    BEGIN(SAVABLE);
    return status_of(state_get(c, FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    BEGIN(ANY_STATE);
    return status_of(state_set(c, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    BEGIN(ANY_STATE);
    state_free(FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    BEGIN(ANY_STATE);
    return status_of(state_size(c, FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size)
{
    BEGIN(ANY_STATE);
    return status_of(state_serialize(c, FMUstate, (unsigned char *)serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    BEGIN(ANY_STATE);
    return status_of(state_deserialize(c, (const unsigned char *)serializedState, size, FMUstate));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    BEGIN(STEP_MODE);
    return status_of(instance_step(c, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return unsupported(c, __func__, "steps are not asynchronous");
}

/* Steps are never pending: only the last successful time and `terminated` are available. */
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    BEGIN(ANY_STATE);
    if (s != fmi2LastSuccessfulTime || !value) return fmi2Discard;
    *value = ((instance *)c)->f.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    BEGIN(ANY_STATE);
    if (s != fmi2Terminated || !value) return fmi2Discard;
    *value = fmi2False; /* the FMU never requests termination */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)c, (void)s, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return unsupported(c, __func__, "providesDirectionalDerivative is false");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return unsupported(c, __func__, "canInterpolateInputs is false");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return unsupported(c, __func__, "maxOutputDerivativeOrder is 0");
}
