/* A host that makes it hard, in many ways; each must give the bits of the first, undisturbed run.
 *
 *   stress VERSION LIBRARY TOKEN RESOURCES INPUTS OUTPUTS WAY [NUMBER]
 *
 * INPUTS and OUTPUTS are variables of type Real as `reference:size,...`. The ways are in the table at the end.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

enum { STEPS = 20, MOST = 1024, THREADS = 8, REFUSED = 10, SILENT = 11, DIFFERENT = 12, FAILED = 13 };
enum { TRAPS = FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW };

typedef struct {
    unsigned references[MOST], sizes[MOST], count, size; /* variables and elements */
} variables;
typedef double results[STEPS][MOST];

static char **words;
static int version;
static variables inputs, outputs;
static results expected;
static atomic_long messages, allocations_left = -1;
static atomic_bool all_fail;

/* ---- an allocator that fails when it is told to ---- */

extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);

/* The loader aborts where it gets no memory for thread-local data; no library can help that. */
static int is_loader(const void *caller)
{
    Dl_info place;
    return dladdr(caller, &place) && place.dli_fname && strstr(place.dli_fname, "/ld-linux") != NULL;
}

static int fails(const void *caller)
{
    if (atomic_load(&allocations_left) < 0 || is_loader(caller)) return 0;
    if (atomic_fetch_sub(&allocations_left, 1) > 0) return 0;
    if (all_fail) atomic_store(&allocations_left, 0);
    return 1;
}

#define FAILS fails(__builtin_return_address(0))
void *malloc(size_t size) { return FAILS ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return FAILS ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return FAILS ? NULL : __libc_realloc(old, size); }

/* ---- an FMU ---- */

typedef struct {
    void *library;
} fmu;

#define CALL(f, name) (*(name##TYPE *)dlsym((f)->library, #name))

static void log2_(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                  fmi2String message, ...)
{
    (void)e, (void)name, (void)status, (void)category;
    messages += message != NULL;
    if (getenv("SAY")) fprintf(stderr, "%s\n", message);
}

static void log3_(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message)
{
    log2_(e, "", (fmi2Status)status, category, message);
}

static const fmi2CallbackFunctions callbacks = {log2_, calloc, free, NULL, NULL};

static fmu open_fmu(void) { return (fmu){dlopen(words[2], RTLD_NOW | RTLD_LOCAL)}; }

static void *make(const fmu *f)
{
    if (version == 2) return CALL(f, fmi2Instantiate)("it", fmi2CoSimulation, words[3], words[4], &callbacks, 0, 1);
    return CALL(f, fmi3InstantiateCoSimulation)("it", words[3], words[4], false, true, false, false, NULL, 0, NULL,
                                                log3_, NULL);
}

static void release(const fmu *f, void *c)
{
    if (version == 2) CALL(f, fmi2FreeInstance)(c);
    else CALL(f, fmi3FreeInstance)(c);
}

static unsigned elements(const variables *v, unsigned *all)
{
    unsigned n = 0;
    for (unsigned i = 0; i < v->count; i++)
        for (unsigned k = 0; k < v->sizes[i]; k++) all[n++] = v->references[i] + k;
    return n;
}

static int set(const fmu *f, void *c)
{
    double values[MOST];
    unsigned all[MOST];
    for (unsigned i = 0; i < inputs.size; i++) values[i] = 0.125 + i % 7 * 0.0625; /* exact in any rounding mode */
    if (version == 3) return (int)CALL(f, fmi3SetFloat64)(c, inputs.references, inputs.count, values, inputs.size);
    return (int)CALL(f, fmi2SetReal)(c, all, elements(&inputs, all), values);
}

static int get(const fmu *f, void *c, double *values)
{
    unsigned all[MOST];
    if (version == 3) return (int)CALL(f, fmi3GetFloat64)(c, outputs.references, outputs.count, values, outputs.size);
    return (int)CALL(f, fmi2GetReal)(c, all, elements(&outputs, all), values);
}

static int begin(const fmu *f, void *c)
{
    if (version == 3) {
        if (CALL(f, fmi3EnterInitializationMode)(c, false, 0.0, 0.0, true, NAN) == fmi3OK) return 1; /* refused, without a trap */
        return CALL(f, fmi3EnterInitializationMode)(c, false, 0.0, 0.0, false, 0.0) || CALL(f, fmi3ExitInitializationMode)(c) || set(f, c);
    }
    if (CALL(f, fmi2SetupExperiment)(c, 0, 0.0, 0.0, 1, NAN) == fmi2OK) return 1;
    return CALL(f, fmi2SetupExperiment)(c, 0, 0.0, 0.0, 0, 0.0) || CALL(f, fmi2EnterInitializationMode)(c) || CALL(f, fmi2ExitInitializationMode)(c) || set(f, c);
}

static int step(const fmu *f, void *c, int i)
{
    bool event, terminate, early;
    double last;
    if (version == 2) return (int)CALL(f, fmi2DoStep)(c, i * 0.001, 0.001, 1);
    return (int)CALL(f, fmi3DoStep)(c, i * 0.001, 0.001, true, &event, &terminate, &early, &last);
}

/* Saves the state, takes a step, and is then back at the state. */
static int step_and_return(const fmu *f, void *c, int i)
{
    void *state = NULL;
    int status = version == 2 ? (int)CALL(f, fmi2GetFMUstate)(c, &state) : (int)CALL(f, fmi3GetFMUState)(c, &state);
    if (status == 0) status = step(f, c, i);
    if (status == 0) status = version == 2 ? (int)CALL(f, fmi2SetFMUstate)(c, state) : (int)CALL(f, fmi3SetFMUState)(c, state);
    if (version == 2) CALL(f, fmi2FreeFMUstate)(c, &state);
    else CALL(f, fmi3FreeFMUState)(c, &state);
    return status;
}

static int run_steps(const fmu *f, void *c, results r)
{
    for (int i = 0; i < STEPS; i++) {
        if (i == STEPS / 2 && step_and_return(f, c, i) != 0) return FAILED;
        if (step(f, c, i) != 0 || get(f, c, r[i]) != 0) return FAILED;
    }
    return 0;
}

static int differs(results r)
{
    for (int i = 0; i < STEPS; i++)
        if (memcmp(r[i], expected[i], outputs.size * sizeof(double)) != 0) return DIFFERENT;
    return 0;
}

/* A whole life. A failure must have been told. */
static int live(results r)
{
    const long before = messages;
    const fmu f = open_fmu();
    if (!f.library) return REFUSED; /* dlerror() tells */
    void *c = make(&f);
    if (!c) {
        dlclose(f.library);
        return messages > before ? REFUSED : SILENT;
    }
    const long told = messages;
    const int status = begin(&f, c) ? FAILED : run_steps(&f, c, r);
    const int silent = status != 0 && messages <= told + 1; /* one is the stop time's */
    release(&f, c);
    dlclose(f.library);
    return silent ? SILENT : status;
}

static int live_and_compare(void)
{
    results *r = __libc_malloc(sizeof *r); /* a small stack has no room for it */
    const int status = live(*r);
    const int wrong = status != 0 ? status : differs(*r);
    free(r);
    return wrong;
}

/* ---- ways to make it hard ---- */

static int arithmetic(long unused)
{
    static const int MODES[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO, FE_TONEAREST};
    (void)unused;
    for (int i = 0; i < 4; i++) {
        fesetround(MODES[i]);
        feenableexcept(TRAPS);
        const int wrong = live_and_compare();
        if (fegetround() != MODES[i] || fegetexcept() != TRAPS) return 20; /* the host's, as before */
        fedisableexcept(TRAPS);
        if (wrong) return wrong;
    }
    return 0;
}

static int decimal_comma(long unused)
{
    (void)unused;
    if (!setlocale(LC_NUMERIC, "comma") || *localeconv()->decimal_point != ',') return 21;
    return live_and_compare();
}

static void *as_thread(void *rounds)
{
    for (long i = 0; i < (long)rounds; i++) {
        const int wrong = live_and_compare();
        if (wrong) return (void *)(intptr_t)wrong;
    }
    return NULL;
}

static int in_threads(int count, size_t stack, long rounds)
{
    pthread_t threads[THREADS];
    pthread_attr_t attributes;
    int wrong = 0;
    pthread_attr_init(&attributes);
    if (stack && pthread_attr_setstacksize(&attributes, stack) != 0) return 24;
    for (int i = 0; i < count; i++) pthread_create(&threads[i], &attributes, as_thread, (void *)rounds);
    for (int i = 0; i < count; i++) {
        void *result;
        pthread_join(threads[i], &result);
        if (result) wrong = (int)(intptr_t)result;
    }
    return wrong;
}

static int eight_threads(long rounds) { return in_threads(THREADS, 0, rounds); }

static int small_stack(long kilobytes) { return in_threads(1, (size_t)kilobytes * 1024, 2); }

typedef struct {
    const fmu *f;
    void *c;
    results r;
    int status;
} stepped;

static void *step_it(void *argument)
{
    stepped *s = argument;
    s->status = run_steps(s->f, s->c, s->r);
    return NULL;
}

/* Two instances of one thread, stepped in two others. */
static int two_stepped(long unused)
{
    static stepped both[2];
    pthread_t threads[2];
    const fmu f = open_fmu();
    int wrong = 0;
    (void)unused;
    for (int i = 0; i < 2; i++) {
        both[i].f = &f;
        both[i].c = make(&f);
        if (begin(&f, both[i].c)) return FAILED;
    }
    for (int i = 0; i < 2; i++) pthread_create(&threads[i], NULL, step_it, &both[i]);
    for (int i = 0; i < 2; i++) {
        pthread_join(threads[i], NULL);
        wrong |= both[i].status != 0 ? both[i].status : differs(both[i].r);
        release(&f, both[i].c);
    }
    return wrong;
}

static long resident_kilobytes(void)
{
    long pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    if (!file || fscanf(file, "%*d %ld", &pages) != 1) exit(2);
    fclose(file);
    return pages * sysconf(_SC_PAGESIZE) / 1024;
}

/* One after the other; says what memory has grown by in the second half of them. */
static int one_after_the_other(long count)
{
    const fmu f = open_fmu();
    long early = 0;
    for (long i = 0; i < count; i++) {
        void *c = make(&f);
        if (!c || begin(&f, c) || step(&f, c, 0)) return FAILED;
        release(&f, c);
        if (i == count / 2) early = resident_kilobytes();
    }
    printf("%ld KB at half, grown by %ld KB\n", early, resident_kilobytes() - early);
    return 0;
}

/* The allocation of each number fails, alone or with all that follow; afterwards all is well again. */
static int starved(long every)
{
    long number = 0, refused = 0;
    for (int together = 0; together < 2; together++)
        for (number = 0;; number += every) {
            results *r = __libc_malloc(sizeof *r);
            all_fail = together;
            atomic_store(&allocations_left, number);
            const int status = live(*r);
            const int reached = atomic_load(&allocations_left) < 1;
            atomic_store(&allocations_left, -1);
            free(r);
            if (status == SILENT) fprintf(stderr, "allocation %ld: no reason was told\n", number);
            if (status == SILENT || live_and_compare() != 0) return 22;
            if (!reached) break;
            refused += status != 0;
        }
    printf("%ld allocations, %ld refused\n", number, refused);
    return 0;
}

static const struct {
    const char *name;
    int (*try)(long number);
} WAYS[] = {{"arithmetic", arithmetic}, {"comma", decimal_comma}, {"threads", eight_threads},
            {"stack", small_stack}, {"two", two_stepped}, {"churn", one_after_the_other},
            {"starved", starved}};

static void read_variables(char *text, variables *v)
{
    for (char *part = strtok(text, ","); part; part = strtok(NULL, ",")) {
        if (sscanf(part, "%u:%u", &v->references[v->count], &v->sizes[v->count]) != 2) exit(2);
        v->size += v->sizes[v->count++];
    }
    if (v->size > MOST) exit(2);
}

int main(int count, char **given)
{
    if (count < 8) return 2;
    words = given;
    version = atoi(words[1]);
    read_variables(words[5], &inputs);
    read_variables(words[6], &outputs);
    const char *way = words[7];
    const long number = count > 8 ? atol(words[8]) : 0;
    if (live(expected) != 0) return 3;
    for (size_t i = 0; i < sizeof WAYS / sizeof *WAYS; i++)
        if (!strcmp(way, WAYS[i].name)) return WAYS[i].try(number);
    return 2;
}
