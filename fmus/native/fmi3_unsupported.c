/* Unsupported functions of FMI 3.0: each logs that and returns an error. */
#include "fmi3Functions.h"

#include "instance.h"

static fmi3Status refuse(instance *c, const char *function, const char *why)
{
    if (!instance_begin(c, function, ANY_STATE)) return fmi3Error;
    return (fmi3Status)fmu_error(&c->f, "%s", why);
}

#define REFERENCES const fmi3ValueReference valueReferences[], size_t nValueReferences

/* Types that no variable has: only empty lists are accepted. */
#define NO_VARIABLES(name, ...)                                                                     \
    fmi3Status name(fmi3Instance c, REFERENCES, __VA_ARGS__)                                        \
    {                                                                                               \
        return c && nValueReferences == 0 ? fmi3OK                                                  \
                                          : refuse(c, __func__, "no variable is of this type");     \
    }
#define NO_NUMBERS(type)                                                     \
    NO_VARIABLES(fmi3Get##type, fmi3##type values[], size_t nValues)         \
    NO_VARIABLES(fmi3Set##type, const fmi3##type values[], size_t nValues)
NO_NUMBERS(Float32)
NO_NUMBERS(Int8)
NO_NUMBERS(UInt8)
NO_NUMBERS(Int16)
NO_NUMBERS(UInt16)
NO_NUMBERS(UInt32)
NO_NUMBERS(UInt64)
NO_VARIABLES(fmi3GetBinary, size_t valueSizes[], fmi3Binary values[], size_t nValues)
NO_VARIABLES(fmi3SetBinary, const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
NO_VARIABLES(fmi3GetClock, fmi3Clock values[])
NO_VARIABLES(fmi3SetClock, const fmi3Clock values[])
NO_VARIABLES(fmi3GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(fmi3GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
             fmi3IntervalQualifier qualifiers[])
NO_VARIABLES(fmi3GetShiftDecimal, fmi3Float64 shifts[])
NO_VARIABLES(fmi3GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NO_VARIABLES(fmi3SetIntervalDecimal, const fmi3Float64 intervals[])
NO_VARIABLES(fmi3SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_VARIABLES(fmi3SetShiftDecimal, const fmi3Float64 shifts[])
NO_VARIABLES(fmi3SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

#define UNSUPPORTED(name, why, ...) \
    fmi3Status name(__VA_ARGS__) { return refuse(c, __func__, why); }

#define DERIVATIVES                                                                                   \
    fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns,                            \
        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,    \
        fmi3Float64 sensitivity[], size_t nSensitivity
UNSUPPORTED(fmi3GetDirectionalDerivative, "providesDirectionalDerivatives is false", DERIVATIVES)
UNSUPPORTED(fmi3GetAdjointDerivative, "providesAdjointDerivatives is false", DERIVATIVES)
UNSUPPORTED(fmi3GetOutputDerivatives, "maxOutputDerivativeOrder is 0", fmi3Instance c, REFERENCES,
            const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues)

static const char NO_DEPENDENCIES[] = "providesPerElementDependencies is false";
UNSUPPORTED(fmi3GetNumberOfVariableDependencies, NO_DEPENDENCIES, fmi3Instance c,
            fmi3ValueReference valueReference, size_t *nDependencies)
UNSUPPORTED(fmi3GetVariableDependencies, NO_DEPENDENCIES, fmi3Instance c, fmi3ValueReference dependent,
            size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
            size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
            size_t nDependencies)

static const char NO_STRUCTURE[] = "there are no structural parameters";
UNSUPPORTED(fmi3EnterConfigurationMode, NO_STRUCTURE, fmi3Instance c)
UNSUPPORTED(fmi3ExitConfigurationMode, NO_STRUCTURE, fmi3Instance c)

static const char NO_EVENT_MODE[] = "hasEventMode is false";
UNSUPPORTED(fmi3EnterEventMode, NO_EVENT_MODE, fmi3Instance c)
UNSUPPORTED(fmi3EnterStepMode, NO_EVENT_MODE, fmi3Instance c)
UNSUPPORTED(fmi3EvaluateDiscreteStates, NO_EVENT_MODE, fmi3Instance c)
UNSUPPORTED(fmi3UpdateDiscreteStates, NO_EVENT_MODE, fmi3Instance c, fmi3Boolean *discreteStatesNeedUpdate,
            fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
            fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
            fmi3Float64 *nextEventTime)

/* For importers that require all functions of the standard. */
static const char NO_MODEL_EXCHANGE[] = "this FMU is for co-simulation, not for model exchange";
UNSUPPORTED(fmi3EnterContinuousTimeMode, NO_MODEL_EXCHANGE, fmi3Instance c)
UNSUPPORTED(fmi3CompletedIntegratorStep, NO_MODEL_EXCHANGE, fmi3Instance c,
            fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *enterEventMode,
            fmi3Boolean *terminateSimulation)
UNSUPPORTED(fmi3SetTime, NO_MODEL_EXCHANGE, fmi3Instance c, fmi3Float64 time)
UNSUPPORTED(fmi3SetContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance c,
            const fmi3Float64 continuousStates[], size_t nContinuousStates)
UNSUPPORTED(fmi3GetContinuousStateDerivatives, NO_MODEL_EXCHANGE, fmi3Instance c,
            fmi3Float64 derivatives[], size_t nContinuousStates)
UNSUPPORTED(fmi3GetEventIndicators, NO_MODEL_EXCHANGE, fmi3Instance c, fmi3Float64 eventIndicators[],
            size_t nEventIndicators)
UNSUPPORTED(fmi3GetContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance c, fmi3Float64 continuousStates[],
            size_t nContinuousStates)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance c, fmi3Float64 nominals[],
            size_t nContinuousStates)
UNSUPPORTED(fmi3GetNumberOfEventIndicators, NO_MODEL_EXCHANGE, fmi3Instance c, size_t *nEventIndicators)
UNSUPPORTED(fmi3GetNumberOfContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance c, size_t *nContinuousStates)
UNSUPPORTED(fmi3ActivateModelPartition, "this FMU is for co-simulation, not for scheduled execution",
            fmi3Instance c, fmi3ValueReference clockReference, fmi3Float64 activationTime)
