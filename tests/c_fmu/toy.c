/* A small FMU in FMI 2.0 and 3.0 that shows how a master treats it.
 *
 * y[i,j] = k * u[i,j] + t, negated by `flip`, doubled by mode 2. In FMI 2.0, every variable of a
 * reference from 100 on is the one 100 below, numbers with the count of steps on top. What `act`, or
 * the environment variable ACT, says happens at the step that begins at 2 ms; "complain" logs an
 * error as it is set, and nothing fails; "terminate" discards the third step of FMI 2.0, half of it taken; "early" returns from each step of FMI 3.0 in its middle; "print" prints in each
 * step; "explain" says in each what it does, and why it fails; "ignore" has SIGINT and SIGTERM ignored. Terminating and freeing are logged, as a warning each.
 */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#define N 6 /* elements of u and of y */
#define COUNT 200 /* value references */
enum { U, Y = N, K = 2 * N };

typedef struct {
    double values[COUNT], time, size;
    int integers[COUNT], booleans[COUNT], steps, is_half, is_final, is_ended; /* the first are the mode and `flip` */
    char act[32], name[64];
    fmi2CallbackFunctions callbacks;
    fmi3LogMessageCallback log3;
    void *environment;
} toy;

static void say(toy *c, int status, const char *text)
{
    if (c->log3) c->log3(c->environment, (fmi3Status)status, "toy", text);
    else c->callbacks.logger(c->environment, c->name, (fmi2Status)status, "toy", "%s", text);
}

static void compute(toy *c)
{
    for (int i = 0; i < N; i++) {
        double y = c->values[K] * c->values[U + i] + c->time;
        c->values[Y + i] = (c->booleans[0] ? -y : y) * (c->integers[0] == 2 ? 2 : 1);
    }
    for (int i = 0; i < COUNT / 2; i++) {
        c->values[i + COUNT / 2] = c->values[i] + c->steps;
        c->integers[i + COUNT / 2] = c->integers[i] + c->steps;
        c->booleans[i + COUNT / 2] = c->booleans[i];
    }
}

static toy *create(const char *name)
{
    toy *c = calloc(1, sizeof *c);
    if (!strcmp(name, "refused")) return free(c), NULL;
    snprintf(c->name, sizeof c->name, "%s", name);
    snprintf(c->act, sizeof c->act, "%s", getenv("ACT") ? getenv("ACT") : "");
    c->values[K] = 1;
    return c;
}

static void set_act(toy *c, const char *act)
{
    snprintf(c->act, sizeof c->act, "%s", act);
    if (!strcmp(act, "ignore")) signal(SIGINT, SIG_IGN), signal(SIGTERM, SIG_IGN);
    if (!strcmp(act, "complain")) say(c, fmi3Error, "100 % as it was told");
}

static int step(toy *c, double time, double size)
{
    static const char *acts[] = {"", "warn", "discard", "error", "fatal"};
    int status = 0, now = c->steps++ == 2;
    for (int i = 1; i < 5; i++)
        if (time > 0.0015 && !strcmp(c->act, acts[i])) status = i;
    if (time > 0.0015 && now && !strcmp(c->act, "terminate")) status = fmi3Discard, c->is_ended = 1;
    if (status) say(c, fmi3Warning, "100 % as it was told");
    for (int i = 0; now && i < 100000 && !strcmp(c->act, "chatter"); i++) {
        char text[40];
        snprintf(text, sizeof text, "this is warning %d", i);
        say(c, fmi3Warning, text);
    }
    if (!strcmp(c->act, "print")) printf("%d steps\n", c->steps), fflush(stdout);
    if (!strcmp(c->act, "explain")) {
        char text[40];
        snprintf(text, sizeof text, "step %d is small", c->steps);
        say(c, 0, "factorizes");
        say(c, fmi3Warning, text);
        if (now) say(c, fmi3Error, "singular matrix"), say(c, fmi3Error, "see the manual");
        status = now ? fmi3Error : 0;
    }
    if (now && !strcmp(c->act, "chdir") && chdir("/")) status = fmi3Error;
    if (now && !strcmp(c->act, "negative")) status = -1;
    c->time = time + size, c->size = size;
    compute(c);
    return status;
}

/* FMI 2.0 */

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String folder,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)type, (void)guid, (void)folder, (void)visible, (void)logging;
    toy *c = create(name);
    if (c) c->callbacks = *callbacks, c->environment = callbacks->componentEnvironment;
    return c;
}
void fmi2FreeInstance(fmi2Component c) { say(c, fmi3Warning, "freed"), free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real start,
                               fmi2Boolean d, fmi2Real e)
{
    (void)a, (void)b, (void)d, (void)e;
    toy *it = c;
    it->time = it->values[COUNT / 2 - 1] = start;
    return strcmp(it->act, "negative-setup") ? fmi2OK : (fmi2Status)-1;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return compute(c), fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return say(c, fmi3Warning, "terminated"), fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return (void)c, fmi2OK; }
#define ACCESS2(name, constant, type, to, from)                                                    \
    fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, constant type v[])    \
    {                                                                                              \
        for (size_t i = 0; i < n; i++) to = from;                                                  \
        return fmi2OK;                                                                             \
    }
ACCESS2(fmi2GetReal, , fmi2Real, v[i], ((toy *)c)->values[r[i]])
ACCESS2(fmi2SetReal, const, fmi2Real, ((toy *)c)->values[r[i]], v[i])
ACCESS2(fmi2GetInteger, , fmi2Integer, v[i], ((toy *)c)->integers[r[i]])
ACCESS2(fmi2SetInteger, const, fmi2Integer, ((toy *)c)->integers[r[i]], v[i])
ACCESS2(fmi2GetBoolean, , fmi2Boolean, v[i], ((toy *)c)->booleans[r[i]])
ACCESS2(fmi2SetBoolean, const, fmi2Boolean, ((toy *)c)->booleans[r[i]], v[i])
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{
    for (size_t i = 0; i < n; i++) v[i] = ((toy *)c)->act;
    return (void)r, fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n,
                         const fmi2String v[])
{
    return (void)r, (void)n, set_act(c, v[0]), fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    return *value = kind == fmi2Terminated && ((toy *)c)->is_ended, fmi2OK;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    return (void)kind, *value = ((toy *)c)->time - ((toy *)c)->size / 2, fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep)
{
    return (void)keep, (fmi2Status)step(c, time, size);
}

/* FMI 3.0 */

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String folder,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference r[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)token, (void)visible, (void)logging, (void)r, (void)n, (void)update;
    (void)early;
    if (events || folder[strlen(folder) - 1] != '/') return NULL;
    toy *c = create(name);
    if (c) c->log3 = log, c->environment = environment;
    return c;
}
void fmi3FreeInstance(fmi3Instance c) { say(c, fmi3Warning, "freed"), free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b,
                                       fmi3Float64 start, fmi3Boolean d, fmi3Float64 e)
{
    (void)a, (void)b, (void)d, (void)e;
    ((toy *)c)->time = start;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return compute(c), fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return say(c, fmi3Warning, "terminated"), fmi3OK; }
/* A reference is that of the first element. */
#define ACCESS3(name, constant, to, from)                                                          \
    fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n,                        \
                    constant fmi3Float64 v[], size_t nv)                                           \
    {                                                                                              \
        size_t at = 0;                                                                             \
        for (size_t i = 0; i < n; i++) {                                                           \
            size_t count = r[i] == K ? 1 : N;                                                      \
            if (at + count > nv) return fmi3Error;                                                 \
            memcpy(to, from, count * sizeof *v);                                                   \
            at += count;                                                                           \
        }                                                                                          \
        return at == nv ? fmi3OK : fmi3Error;                                                      \
    }
ACCESS3(fmi3GetFloat64, , v + at, ((toy *)c)->values + r[i])
ACCESS3(fmi3SetFloat64, const, ((toy *)c)->values + r[i], v + at)
#define SET3(name, type, effect)                                                                   \
    fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n, const type v[],        \
                    size_t nv)                                                                     \
    {                                                                                              \
        return (void)r, (void)n, (void)nv, effect, fmi3OK;                                         \
    }
SET3(fmi3SetBoolean, fmi3Boolean, ((toy *)c)->booleans[0] = v[0])
SET3(fmi3SetInt64, fmi3Int64, ((toy *)c)->integers[0] = (int)v[0])
SET3(fmi3SetString, fmi3String, set_act(c, v[0]))
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep,
                      fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    toy *it = c;
    it->is_final = keep;
    *early = !strcmp(it->act, "early") && !it->is_half; /* half a step, then the rest */
    it->is_half = *early;
    *event = fmi3False, *last = time + (*early ? size / 2 : size);
    int status = step(c, time, *last - time);
    *end = time > 0.0015 && !strcmp(it->act, "end");
    return (fmi3Status)status;
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    return *state = memcpy(malloc(sizeof(toy)), c, sizeof(toy)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    if (((toy *)c)->is_final) return fmi3Error; /* it was told that nobody goes back */
    return memcpy(c, state, sizeof(toy)), fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    return (void)c, free(*state), *state = NULL, fmi3OK;
}
