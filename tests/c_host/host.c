/* Couples FMUs as a plan says, in FMI 2.0 or FMI 3.0, and writes all that they exchange.
 *
 *   host PLAN RECORDING
 *
 * The recording is rows of doubles, a row for each instant from t = 0 on. What is read has columns in the
 * order of the plan. A line of the plan is one of these, in this order; I counts instances from 0 on:
 *
 *   fmi 2|3
 *   instance leads|follows LIBRARY TOKEN RESOURCES      in the order of stepping
 *   start I TYPE COUNT VALUE... N REFERENCE...          TYPE: Real, Integer, Enumeration, Boolean
 *   read I COUNT N REFERENCE...                         outputs, of type Real
 *   feed I COUNT COLUMN... N REFERENCE...               inputs, of type Real
 *   run STEPS SIZE
 *   try LIBRARY TOKEN RESOURCES                         says whether it is made or refused, and frees it
 *   at-once COUNT (LIBRARY TOKEN RESOURCES)...          the same, in threads that begin at one moment
 *
 * An instance that leads steps first; what it gives belongs to the instant at which its step began, and acts
 * on the followers at once. Numbers are as strtod reads them, hexadecimal too.
 */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) (void *)LoadLibraryA(path)
#define FIND(library, name) (void *)(uintptr_t)GetProcAddress((HMODULE)library, name)
static double seconds(void) { return 0.001 * (double)GetTickCount64(); }
#else
#include <dlfcn.h>
#include <pthread.h>
#include <stdatomic.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}
#endif

enum { MOST = 512, INSTANCES = 4, TEXT = 1024 };

typedef struct {
    size_t values, references;
    unsigned reference[MOST];
    size_t column[MOST]; /* of a row, for each value */
} exchange;

typedef struct {
    void *library, *c;
    bool leads;
    exchange read, feed;
} instance;

static int fmi;
static instance instances[INSTANCES];
static int instance_count;
static size_t width;
static double row[2 * MOST], buffer[MOST];
static fmi2CallbackFunctions callbacks;

#define CALL(instance_, name) (*(name##TYPE *)find((instance_)->library, #name))

static void fail(const char *what)
{
    fprintf(stderr, "%s\n", what);
    exit(3);
}

static void *find(void *library, const char *name)
{
    void *found = FIND(library, name);
    if (!found) fail(name);
    return found;
}

static void need(int status, const char *what)
{
    if (status != 0) fail(what);
}

static void tell2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                  fmi2String message, ...)
{
    va_list more;
    (void)e;
    fprintf(stderr, "%s: %d %s ", name, (int)status, category);
    va_start(more, message);
    vfprintf(stderr, message, more);
    va_end(more);
    fputc('\n', stderr);
}

static void tell3(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)e;
    fprintf(stderr, "%d %s %s\n", (int)status, category, message);
}

/* ---- the plan ---- */

static void read_word(FILE *plan, char *word)
{
    if (fscanf(plan, "%1023s", word) != 1) fail("the plan is too short");
}

static double read_number(FILE *plan)
{
    char word[TEXT];
    read_word(plan, word);
    return strtod(word, NULL);
}

static size_t read_count(FILE *plan)
{
    const double count = read_number(plan);
    if (!(count >= 0.0 && count <= MOST)) fail("too many for this host");
    return (size_t)count;
}

static void read_references(FILE *plan, exchange *x)
{
    x->references = read_count(plan);
    for (size_t i = 0; i < x->references; i++) x->reference[i] = (unsigned)read_number(plan);
}

typedef struct {
    char library[TEXT], token[TEXT], resources[TEXT];
} source;

static source read_source(FILE *plan)
{
    source s;
    read_word(plan, s.library);
    read_word(plan, s.token);
    read_word(plan, s.resources);
    return s;
}

static instance make(const source *s)
{
    instance it = {.library = OPEN(s->library)};
    if (!it.library) fail(s->library);
    if (fmi == 2)
        it.c = CALL(&it, fmi2Instantiate)("it", fmi2CoSimulation, s->token, s->resources, &callbacks, 0, 0);
    else
        it.c = CALL(&it, fmi3InstantiateCoSimulation)("it", s->token, s->resources, 0, 0, 0, 0, NULL, 0, NULL, tell3,
                                                      NULL);
    return it;
}

static void release(instance *it)
{
    if (fmi == 2) CALL(it, fmi2FreeInstance)(it->c);
    else CALL(it, fmi3FreeInstance)(it->c);
}

static void try_source(const source *s)
{
    instance it = make(s);
    puts(it.c ? "made" : "refused");
    if (it.c) release(&it);
}

static void read_instance(FILE *plan, instance *it)
{
    char word[TEXT];
    const double begin = seconds();
    read_word(plan, word);
    const source s = read_source(plan);
    *it = make(&s);
    it->leads = !strcmp(word, "leads");
    if (!it->c) fail("not instantiated");
    printf("loaded %.6f s\n", seconds() - begin);
}

#ifndef _WIN32
static atomic_int to_come;

static void *in_a_thread(void *s)
{
    OPEN(((source *)s)->library); /* which takes its time */
    atomic_fetch_sub(&to_come, 1);
    while (atomic_load(&to_come) > 0) continue;
    try_source(s);
    return NULL;
}

static void at_once(FILE *plan, int count)
{
    static source sources[INSTANCES];
    pthread_t threads[INSTANCES];
    if (count > INSTANCES) fail("too many instances");
    to_come = count;
    for (int i = 0; i < count; i++) sources[i] = read_source(plan);
    for (int i = 0; i < count; i++) pthread_create(&threads[i], NULL, in_a_thread, &sources[i]);
    for (int i = 0; i < count; i++) pthread_join(threads[i], NULL);
}
#endif

static void read_start(FILE *plan, instance *it)
{
    static fmi2Integer integers[MOST];
    static fmi3Int32 int32s[MOST];
    static fmi3Int64 int64s[MOST];
    static bool booleans[MOST];
    static exchange x;
    char type[TEXT];
    read_word(plan, type);
    x.values = read_count(plan);
    for (size_t i = 0; i < x.values; i++) {
        buffer[i] = read_number(plan);
        integers[i] = int32s[i] = (int)buffer[i];
        int64s[i] = integers[i];
        booleans[i] = integers[i] != 0;
    }
    read_references(plan, &x);
    const unsigned *r = x.reference;
    const size_t n = x.references, count = x.values;
    if (!strcmp(type, "Real")) {
        need(fmi == 2 ? (int)CALL(it, fmi2SetReal)(it->c, r, n, buffer)
                      : (int)CALL(it, fmi3SetFloat64)(it->c, r, n, buffer, count), "start Real");
    } else if (!strcmp(type, "Boolean")) {
        need(fmi == 2 ? (int)CALL(it, fmi2SetBoolean)(it->c, r, n, integers)
                      : (int)CALL(it, fmi3SetBoolean)(it->c, r, n, booleans, count), "start Boolean");
    } else if (fmi == 2) {
        need(CALL(it, fmi2SetInteger)(it->c, r, n, integers), "start Integer");
    } else if (!strcmp(type, "Enumeration")) {
        need(CALL(it, fmi3SetInt64)(it->c, r, n, int64s, count), "start Enumeration");
    } else {
        need(CALL(it, fmi3SetInt32)(it->c, r, n, int32s, count), "start Integer");
    }
}

static void read_exchange(FILE *plan, exchange *x, bool is_read)
{
    x->values = read_count(plan);
    if (is_read && width + x->values > 2 * MOST) fail("too many columns");
    for (size_t i = 0; i < x->values; i++) x->column[i] = is_read ? width++ : (size_t)read_number(plan);
    read_references(plan, x);
}

/* ---- the run ---- */

static void initialize(instance *it)
{
    const double begin = seconds();
    if (fmi == 2) {
        need(CALL(it, fmi2SetupExperiment)(it->c, 0, 0.0, 0.0, 0, 0.0), "fmi2SetupExperiment");
        need(CALL(it, fmi2EnterInitializationMode)(it->c), "fmi2EnterInitializationMode");
        need(CALL(it, fmi2ExitInitializationMode)(it->c), "fmi2ExitInitializationMode");
    } else {
        need(CALL(it, fmi3EnterInitializationMode)(it->c, 0, 0.0, 0.0, 0, 0.0), "fmi3EnterInitializationMode");
        need(CALL(it, fmi3ExitInitializationMode)(it->c), "fmi3ExitInitializationMode");
    }
    printf("initialized %.6f s\n", seconds() - begin);
}

static void read_outputs(instance *it)
{
    const exchange *x = &it->read;
    need(fmi == 2 ? (int)CALL(it, fmi2GetReal)(it->c, x->reference, x->references, buffer)
                  : (int)CALL(it, fmi3GetFloat64)(it->c, x->reference, x->references, buffer, x->values), "get");
    for (size_t i = 0; i < x->values; i++) row[x->column[i]] = buffer[i];
}

static void feed_inputs(instance *it)
{
    const exchange *x = &it->feed;
    if (!x->references) return;
    for (size_t i = 0; i < x->values; i++) buffer[i] = row[x->column[i]];
    need(fmi == 2 ? (int)CALL(it, fmi2SetReal)(it->c, x->reference, x->references, buffer)
                  : (int)CALL(it, fmi3SetFloat64)(it->c, x->reference, x->references, buffer, x->values), "set");
}

static void step(instance *it, double time, double size)
{
    bool event, terminate, early;
    double last;
    feed_inputs(it);
    need(fmi == 2 ? (int)CALL(it, fmi2DoStep)(it->c, time, size, 1)
                  : (int)CALL(it, fmi3DoStep)(it->c, time, size, 1, &event, &terminate, &early, &last), "step");
}

static void write_row(FILE *recording)
{
    if (fwrite(row, sizeof *row, width, recording) != width) fail("the recording cannot be written");
}

static void lead(double time, double size)
{
    for (int i = 0; i < instance_count; i++) {
        if (!instances[i].leads) continue;
        step(&instances[i], time, size);
        read_outputs(&instances[i]);
    }
}

static void run(FILE *recording, long steps, double size)
{
    for (int i = 0; i < instance_count; i++) initialize(&instances[i]);
    for (int i = 0; i < instance_count; i++) read_outputs(&instances[i]);
    for (long k = 0; k < steps; k++) {
        lead((double)k * size, size);
        write_row(recording);
        for (int i = 0; i < instance_count; i++)
            if (!instances[i].leads) step(&instances[i], (double)k * size, size);
        for (int i = 0; i < instance_count; i++)
            if (!instances[i].leads) read_outputs(&instances[i]);
    }
    lead((double)steps * size, size);
    write_row(recording);
}

static void finish(instance *it)
{
    need(fmi == 2 ? (int)CALL(it, fmi2Terminate)(it->c) : (int)CALL(it, fmi3Terminate)(it->c), "terminate");
    release(it);
}

int main(int count, char **words)
{
    const fmi2CallbackFunctions functions = {tell2, calloc, free, NULL, NULL};
    FILE *plan = count == 3 ? fopen(words[1], "r") : NULL, *recording = plan ? fopen(words[2], "wb") : NULL;
    char verb[TEXT];
    if (!recording) fail("host PLAN RECORDING");
    memcpy(&callbacks, &functions, sizeof functions);
    while (fscanf(plan, "%1023s", verb) == 1) {
        if (!strcmp(verb, "fmi")) {
            fmi = (int)read_number(plan);
        } else if (!strcmp(verb, "instance")) {
            if (instance_count == INSTANCES) fail("too many instances");
            read_instance(plan, &instances[instance_count++]);
        } else if (!strcmp(verb, "try")) {
            const source s = read_source(plan);
            try_source(&s);
#ifndef _WIN32
        } else if (!strcmp(verb, "at-once")) {
            at_once(plan, (int)read_count(plan));
#endif
        } else if (!strcmp(verb, "run")) {
            const long steps = (long)read_number(plan);
            run(recording, steps, read_number(plan));
        } else {
            const int i = (int)read_number(plan);
            if (i < 0 || i >= instance_count) fail("no such instance");
            if (!strcmp(verb, "start")) read_start(plan, &instances[i]);
            else if (!strcmp(verb, "read")) read_exchange(plan, &instances[i].read, true);
            else if (!strcmp(verb, "feed")) read_exchange(plan, &instances[i].feed, false);
            else fail(verb);
        }
    }
    for (int i = 0; i < instance_count; i++) finish(&instances[i]);
    if (fclose(recording) != 0) fail("the recording cannot be written");
    return 0;
}
