/* An FMI 2.0 FMU for the tests: outputs follow what is set, and the environment variable ODD says
 * what goes wrong in which step: `negative@3`, `chdir@3`, `chatter@3`. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define COUNT 200 /* value references; output k + 100 is variable k, and the steps for a Real */
typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Log log;
    void *alloc, *release, *finished, *environment;
} Callbacks;
typedef struct {
    Log log;
    void *environment;
    double real[COUNT];
    int integer[COUNT], boolean[COUNT], steps;
} Odd;

static void follow(Odd *me) {
    for (int k = 0; k < 100; k++) {
        me->real[k + 100] = me->real[k] + me->steps;
        me->integer[k + 100] = me->integer[k] + me->steps;
        me->boolean[k + 100] = me->boolean[k];
    }
}

static int is_due(Odd *me, const char *fault) {
    const char *told = getenv("ODD");
    size_t length = strlen(fault);
    return told && !strncmp(told, fault, length) && told[length] == '@' &&
           atoi(told + length + 1) == me->steps;
}

static void chatter(Odd *me) {
    for (int k = 0; k < 100000; k++)
        me->log(me->environment, "odd", 1, "warning", "this is warning %d", k);
}

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where,
                      const Callbacks *callbacks, int visible, int logging) {
    Odd *me = calloc(1, sizeof(Odd));
    (void)name, (void)type, (void)guid, (void)where, (void)visible, (void)logging;
    me->log = callbacks->log;
    me->environment = callbacks->environment;
    return me;
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int has, double tolerance, double start, int stops, double stop) {
    Odd *me = c;
    (void)has, (void)tolerance, (void)stops, (void)stop;
    me->real[99] = start;
    return is_due(me, "negative-setup") ? -1 : 0;
}
int fmi2EnterInitializationMode(void *c) { return (void)c, 0; }
int fmi2ExitInitializationMode(void *c) { return follow(c), 0; }
int fmi2DoStep(void *c, double time, double step, int forward) {
    Odd *me = c;
    (void)time, (void)step, (void)forward;
    me->steps++;
    follow(me);
    if (is_due(me, "chatter")) chatter(me);
    if (is_due(me, "chdir") && chdir("/")) return 3;
    return is_due(me, "negative") ? -1 : 0;
}
#define ACCESS(Name, type, field)                                                    \
    int fmi2Get##Name(void *c, const unsigned *vr, size_t n, type *values) {         \
        for (size_t k = 0; k < n; k++) values[k] = ((Odd *)c)->field[vr[k]];         \
        return 0;                                                                    \
    }                                                                                \
    int fmi2Set##Name(void *c, const unsigned *vr, size_t n, const type *values) {   \
        for (size_t k = 0; k < n; k++) ((Odd *)c)->field[vr[k]] = values[k];         \
        return 0;                                                                    \
    }
ACCESS(Real, double, real)
ACCESS(Integer, int, integer)
ACCESS(Boolean, int, boolean)
int fmi2GetString(void *c, const unsigned *vr, size_t n, const char **values) {
    (void)c, (void)vr;
    for (size_t k = 0; k < n; k++) values[k] = "text";
    return 0;
}
int fmi2SetString(void *c, const unsigned *vr, size_t n, const char **values) {
    return (void)c, (void)vr, (void)n, (void)values, 0;
}
int fmi2SetDebugLogging(void) { return 0; }
int fmi2Terminate(void *c) { return (void)c, 0; }
int fmi2Reset(void *c) { return (void)c, 0; }
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
