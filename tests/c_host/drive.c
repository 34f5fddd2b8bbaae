/* Calls the functions of an FMU in random order, legal and not, with random arguments.
 *
 *   drive VERSION SEED CALLS VALUES TOKEN RESOURCES
 *
 * It is linked with the FMU's sources, so that sanitizers see all of it. What must hold: no crash, no status
 * that the standards do not know, an error is told before it is returned, and values that were got are
 * initialized. Pointers are sound where the standards say that they are; everything else is not.
 */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { SLOTS = 5, MOST = 64, BYTES = 1 << 20 };

static uint64_t seed;
static int version;
static unsigned value_count;
static const char *token, *resources;
static void *instances[SLOTS], *states[SLOTS];
static double times[SLOTS];
static unsigned char *bytes;
static size_t byte_count;
static long messages, steps, calls[3];

#define EITHER(two, three) (version == 2 ? (int)(two) : (int)(three))

static uint64_t next(void) /* splitmix64 */
{
    uint64_t z = seed += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

static unsigned below(unsigned n) { return (unsigned)(next() % n); }

static double any_double(void)
{
    static const double ODD[] = {0.0, -0.0, 1.0, -1.0, 1e-310, 1e308, 0.001, 255.0, 3.14159};
    switch (below(12)) {
    case 0: return NAN;
    case 1: return below(2) ? HUGE_VAL : -HUGE_VAL;
    case 2: case 3: case 4: return ODD[below(9)];
    default: return ((double)below(2000001) - 1e6) / 1e6;
    }
}

static const char *any_text(void)
{
    static const char *const TEXTS[] = {"", "%s%n%d", "/nowhere/table.csv", "\xff\xfe", "text", "\xc3\x84", "a\tb\nc"};
    return TEXTS[below(7)];
}

static void log2_(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                  fmi2String message, ...)
{
    static char text[1 << 16];
    va_list more;
    va_start(more, message);
    vsnprintf(text, sizeof text, message, more); /* as a format: what importers do */
    va_end(more);
    if (!e && name && category && status <= fmi2Fatal) messages++;
}

static void log3_(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message)
{
    if (!e && category && message && status <= fmi3Fatal) messages++;
}

static const fmi2CallbackFunctions callbacks = {log2_, calloc, free, NULL, NULL};

static void *create(void)
{
    const char *which = below(8) ? token : any_text(), *where = below(8) ? resources : any_text();
    const int wrong = below(20) == 0;
    if (version == 2)
        return fmi2Instantiate(below(9) ? "it" : NULL, wrong ? fmi2ModelExchange : fmi2CoSimulation,
                               below(30) ? which : NULL, below(30) ? where : NULL, below(30) ? &callbacks : NULL, 0, below(2));
    return fmi3InstantiateCoSimulation(below(9) ? "it" : NULL, below(30) ? which : NULL, below(30) ? where : NULL, 0,
                                       below(2), wrong, below(2), NULL, 0, NULL, below(30) ? log3_ : NULL, NULL);
}

static unsigned references[MOST];
static double reals[MOST * 64], sum;
static int integers[MOST * 64];
static int32_t integers32[MOST * 64];
static int64_t integers64[MOST * 64];
static bool booleans[MOST * 64];
static const char *texts[MOST * 64];

static size_t any_references(void)
{
    const size_t n = below(4) ? below(6) : below(MOST);
    const unsigned first = below(value_count + 2);
    for (size_t i = 0; i < n; i++)
        references[i] = below(40) == 0 ? (unsigned)next() : below(2) ? first + (unsigned)i : below(value_count + 2);
    return n;
}

static void fill(void)
{
    const int sane = below(3) > 0;
    for (int i = 0; i < MOST * 64; i++) {
        reals[i] = sane ? below(1000001) / 1e6 : any_double();
        integers[i] = integers32[i] = (int)(below(10) - 3);
        integers64[i] = below(20) ? integers[i] : INT64_MIN;
        booleans[i] = below(2);
        texts[i] = below(20) ? any_text() : NULL;
    }
}

static int set(void *c)
{
    const size_t n = any_references(), m = below(5) ? n : below(MOST * 64);
    fill();
    switch (below(5)) {
    case 0: return EITHER(fmi2SetInteger(c, references, n, integers),
                          below(2) ? fmi3SetInt32(c, references, n, integers32, m)
                                   : fmi3SetInt64(c, references, n, integers64, m));
    case 1: return EITHER(fmi2SetBoolean(c, references, n, integers), fmi3SetBoolean(c, references, n, booleans, m));
    case 2: return EITHER(fmi2SetString(c, references, n, texts), fmi3SetString(c, references, n, texts, m));
    default: return EITHER(fmi2SetReal(c, references, n, reals), fmi3SetFloat64(c, references, n, reals, m));
    }
}

static int get(void *c)
{
    const size_t n = any_references(), m = below(2) ? n : below(MOST * 64);
    int status;
    switch (below(5)) {
    case 0: return EITHER(fmi2GetInteger(c, references, n, integers),
                          below(2) ? fmi3GetInt32(c, references, n, integers32, m)
                                   : fmi3GetInt64(c, references, n, integers64, m));
    case 1: return EITHER(fmi2GetBoolean(c, references, n, integers), fmi3GetBoolean(c, references, n, booleans, m));
    case 2:
        status = EITHER(fmi2GetString(c, references, n, texts), fmi3GetString(c, references, n, texts, m));
        for (size_t i = 0; status == 0 && i < n; i++) sum += (double)strlen(texts[i]);
        return status;
    default:
        status = EITHER(fmi2GetReal(c, references, n, reals), fmi3GetFloat64(c, references, n, reals, m));
        for (size_t i = 0; status == 0 && i < n; i++) sum += isfinite(reals[i]);
        return status;
    }
}

static int step(void *c, int slot)
{
    const double time = below(10) ? times[slot] : any_double();
    const double size = below(10) ? 0.001 * (1 + below(3)) : below(2) ? 0.0044 : any_double();
    fmi3Boolean event = true, terminate = true, early = true;
    fmi3Float64 last = NAN;
    if (size > 0.05) return 0; /* takes as long as it takes */
    const int status = EITHER(fmi2DoStep(c, time, size, below(2)),
                              fmi3DoStep(c, time, size, below(2), &event, &terminate, &early, &last));
    if (status == 0) times[slot] = time + size, steps += size > 0.0;
    if (version == 3 && c && (event || terminate || early)) abort();
    return status;
}

static int initialize(void *c, int slot)
{
    const double start = below(6) ? 0.0 : any_double();
    const int has_stop = below(4) == 0;
    times[slot] = start;
    if (version == 3) return (int)fmi3EnterInitializationMode(c, 0, 0.0, start, has_stop, any_double() + 1.0);
    if (below(9)) fmi2SetupExperiment(c, 0, 0.0, start, has_stop, any_double() + 1.0);
    return (int)fmi2EnterInitializationMode(c);
}

static int serialize(void *c, int slot)
{
    size_t size = 0;
    int status = EITHER(fmi2SerializedFMUstateSize(c, states[slot], &size),
                        fmi3SerializedFMUStateSize(c, states[slot], &size));
    if (status != 0) return status;
    if (size > BYTES) abort();
    byte_count = below(9) ? size : below((unsigned)size + 1);
    return EITHER(fmi2SerializeFMUstate(c, states[slot], (fmi2Byte *)bytes, byte_count),
                  fmi3SerializeFMUState(c, states[slot], bytes, byte_count));
}

static int deserialize(void *c, int slot)
{
    void *state = NULL;
    size_t size = below(5) ? byte_count : below((unsigned)byte_count + 1);
    unsigned char *copy = malloc(size ? size : 1); /* exact, so that a read behind it is seen */
    memcpy(copy, bytes, size);
    const int damaged = size > 0 && below(2);
    if (damaged) copy[below((unsigned)size)] ^= (unsigned char)(1u << below(8));
    const int status = EITHER(fmi2DeSerializeFMUstate(c, (fmi2Byte *)copy, size, &state),
                              fmi3DeserializeFMUState(c, copy, size, &state));
    free(copy);
    if (status != 0) return status;
    if (damaged) abort(); /* accepted */
    if (version == 2) fmi2FreeFMUstate(c, &states[slot]);
    else fmi3FreeFMUState(c, &states[slot]);
    states[slot] = state;
    return status;
}

static int change_log(void *c)
{
    const char *names[] = {"logAll", "logStatusError", "logStatusWarning", any_text()};
    const char *const *chosen = names + below(4);
    return EITHER(fmi2SetDebugLogging(c, below(2), below(2), chosen), fmi3SetDebugLogging(c, below(2), below(2), chosen));
}

static int seldom(void *c)
{
    double number = 0.0;
    bool flag;
    size_t n;
    unsigned one = below(value_count);
    if (version == 2) {
        int kind = (int)below(5);
        fmi2Boolean value;
        switch (below(4)) {
        case 0: return (int)fmi2GetRealStatus(c, (fmi2StatusKind)(kind % 4), &number);
        case 1: return (int)fmi2GetBooleanStatus(c, (fmi2StatusKind)(kind % 4), &value);
        case 2: return (int)fmi2CancelStep(c);
        default: return (int)fmi2GetDirectionalDerivative(c, &one, 1, &one, 1, &number, &number);
        }
    }
    switch (below(5)) {
    case 0: return (int)fmi3EnterEventMode(c);
    case 1: return (int)fmi3GetNumberOfContinuousStates(c, &n);
    case 2: return (int)fmi3CompletedIntegratorStep(c, 0, &flag, &flag);
    case 3: return (int)fmi3GetFloat32(c, &one, below(2), NULL, below(2));
    default: return (int)fmi3GetNumberOfVariableDependencies(c, one, &n);
    }
}

static int lifecycle(void *c, int slot)
{
    switch (below(8)) {
    case 0: return EITHER(fmi2Terminate(c), fmi3Terminate(c));
    case 1: return EITHER(fmi2Reset(c), fmi3Reset(c));
    case 2: case 3: case 4: return initialize(c, slot);
    default: return EITHER(fmi2ExitInitializationMode(c), fmi3ExitInitializationMode(c));
    }
}

/* From any state to the first step, as importers go there. */
static int begin_properly(void *c, int slot)
{
    times[slot] = 0.0;
    if (version == 3) {
        fmi3Reset(c);
        fmi3EnterInitializationMode(c, false, 0.0, 0.0, false, 0.0);
        return (int)fmi3ExitInitializationMode(c);
    }
    fmi2Reset(c);
    fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0);
    fmi2EnterInitializationMode(c);
    return (int)fmi2ExitInitializationMode(c);
}

static int one_call(int slot)
{
    void *c = below(200) ? instances[slot] : NULL;
    const int k = (int)below(SLOTS); /* any instance's state */
    switch (below(24)) {
    case 0:
        if (below(8) == 0 || !instances[slot]) {
            if (version == 2) fmi2FreeInstance(instances[slot]);
            else fmi3FreeInstance(instances[slot]);
            instances[slot] = create();
            times[slot] = 0.0;
            return 0;
        }
        return change_log(c);
    case 1: return lifecycle(c, slot);
    case 2: return begin_properly(c, slot);
    case 3: return EITHER(fmi2GetFMUstate(c, &states[k]), fmi3GetFMUState(c, &states[k]));
    case 4: return EITHER(fmi2SetFMUstate(c, states[k]), fmi3SetFMUState(c, states[k]));
    case 5: return below(4) ? 0 : EITHER(fmi2FreeFMUstate(c, &states[k]), fmi3FreeFMUState(c, &states[k]));
    case 6: return serialize(c, k);
    case 7: return deserialize(c, k);
    case 8: return seldom(c);
    case 9: case 10: case 11: case 12: case 13: return set(c);
    case 14: case 15: case 16: case 17: return get(c);
    default: return step(c, slot);
    }
}

int main(int count, char **words)
{
    if (count != 7) return 2;
    version = atoi(words[1]);
    seed = strtoull(words[2], NULL, 10);
    value_count = (unsigned)atoi(words[4]);
    token = words[5];
    resources = words[6];
    bytes = calloc(BYTES, 1);
    for (long i = strtol(words[3], NULL, 10); i > 0; i--) {
        const int slot = (int)below(SLOTS);
        const int status = one_call(slot);
        if (status < 0 || status > 3) abort();
        calls[status == 0 ? 0 : status == 3 ? 2 : 1]++;
    }
    for (int i = 0; i < SLOTS; i++) { /* states outlive their instances, until one frees them */
        void *c = instances[i];
        for (int k = 0; c && k < SLOTS; k++)
            if (version == 2) fmi2FreeFMUstate(c, &states[k]);
            else fmi3FreeFMUState(c, &states[k]);
        if (version == 2) fmi2FreeInstance(c);
        else fmi3FreeInstance(c);
    }
    for (int k = 0; k < SLOTS; k++) free(states[k]);
    free(bytes);
    printf("%ld OK, %ld other, %ld errors, %ld messages, %ld steps\n", calls[0], calls[1], calls[2], messages, steps);
    return sum < 0.0;
}
