/* The master's step, fmus/master/step.py, in C: a list of calls, gone through once a tick.
 *
 * This is a library of its own, for our master; no FMU contains it. fmus/master/kernel.py makes the list from
 * what `Step` would call in Python, so that both do the same and give the same bits. Values are in the rows of
 * the recording, which FMUs read and write in place; those that an FMU wants in another order go through
 * `values`. Python's lock is released meanwhile, as in each single call.
 */
#define _GNU_SOURCE
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#include <windows.h>
#define EXPORT __declspec(dllexport)
#else
#include <time.h>
#define EXPORT __attribute__((visibility("default")))
#endif
#if defined(__linux__)
#include <errno.h>
#include <linux/futex.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

typedef enum { SET_INPUTS, STEP, GET_OUTPUTS, COMPLETE, FEED_BACK } action;

/* Statuses beyond those of FMI. */
enum { WARNING = 1, ENDED = 100, EARLY, NOT_FINITE, EVENT, LATE, GONE, TOLD };

/* What is said to an FMU's process, and its answers, in memory that both share. */
enum { DONE, HEARD, ENDED_AT_END, FAILED, TAKE_STEP, LISTEN };

static const double ROUNDING = 1e-9; /* of a step: an FMU's clock may sum */

/* Getters and setters differ in `const` only. */
typedef unsigned access2(void *instance, const uint32_t *references, size_t count, double *values);
typedef unsigned access3(void *instance, const uint32_t *references, size_t count, double *values, size_t size);
typedef unsigned step2(void *instance, double time, double size, int no_going_back);
typedef unsigned step3(void *instance, double time, double size, bool no_going_back, bool *event, bool *ended,
                       bool *early, double *reached);

typedef struct {
    int32_t action;
    int32_t fmi;    /* major version; 0: in a process of its own */
    int64_t later;  /* 0: values of this tick's row, 1: of the next row; of a step: whether it is returned to */
    union {
        access2 *access2;
        access3 *access3;
        step2 *step2;
        step3 *step3;
    } function; /* of the FMU's library */
    void *instance;
    const uint32_t *references;
    size_t count;  /* of references */
    size_t column; /* of the first value, if the FMU accesses the row itself */
    double *values; /* else the values in the FMU's order */
    size_t size;    /* of `values`, or of those in the row */
    const uint32_t *columns, *places; /* columns of the row, and where they are in `values` */
    size_t moved;                     /* how many: those of `columns` */
    const double *linear;             /* factor and offset of each, if they are converted */
    double seconds;                   /* that it took so far, if it is timed */
} call;

/* The begin of that memory. */
typedef struct {
    double time, size; /* [s] of the step to take */
    uint32_t said;     /* last: an order, or its answer */
} order;

/* An FMU in a process of its own: the `instance` of its calls. */
typedef struct {
    int32_t socket;
    int32_t heard;             /* set if it has logged messages, which wait there */
    int32_t asked;             /* set from asking for a step to its answer */
    order *order;
    void (*interrupted)(void); /* called if a signal comes while it is waited for */
    double limit;              /* of this wait [s] */
} remote;

typedef struct {
    call *calls;
    int64_t call_count;
    double *rows;
    size_t width;               /* of a row */
    double start, step_size;    /* [s] */
    const volatile int32_t *stop; /* set by another thread: return after this tick */
    int64_t filled;             /* complete rows */
    int64_t failed;             /* index of the call that failed, */
    uint32_t status;            /* its status, */
    double reached;             /* and where it ended a step early [s] */
    int64_t ended;              /* number of the call that ended the simulation at its step's end, from 1 on; or 0 */
    int64_t timed;              /* whether calls are timed */
} course;

static double now(void) /* [s] */
{
#if defined(_WIN32)
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (double)count.QuadPart / (double)frequency.QuadPart;
#else
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#endif
}

static bool are_finite(const double *row, const uint32_t *columns, size_t count, size_t width)
{
    double sum = 0.0; /* of zeros; NaN as soon as one of the values is not finite */
    if (count == width)
        for (size_t i = 0; i < width; i++) sum += row[i] * 0.0;
    else
        for (size_t i = 0; i < count; i++) sum += row[columns[i]] * 0.0;
    return sum == 0.0;
}

static double converted(const call *c, size_t i, double value)
{
    return c->linear ? c->linear[2 * i] * value + c->linear[2 * i + 1] : value;
}

static unsigned exchange(const call *c, double *row)
{
    double *values = c->values ? c->values : row + c->column;
    if (c->action == SET_INPUTS)
        for (size_t i = 0; i < c->moved; i++) values[c->places[i]] = converted(c, i, row[c->columns[i]]);
    const unsigned status =
        c->fmi == 0   ? 0 /* the values are in its process already */
        : c->fmi == 3 ? c->function.access3(c->instance, c->references, c->count, values, c->size)
                      : c->function.access2(c->instance, c->references, c->count, values);
    if (c->action == GET_OUTPUTS && status <= WARNING)
        for (size_t i = 0; i < c->moved; i++) row[c->columns[i]] = values[c->places[i]];
    return status;
}

#if defined(__linux__)
static const double GLANCE = 0.05; /* [s] after which it is seen whether a process that does not answer is there */

EXPORT void panda_say(order *o, uint32_t word)
{
    __atomic_store_n(&o->said, word, __ATOMIC_RELEASE);
    syscall(SYS_futex, &o->said, FUTEX_WAKE, 1, NULL, NULL, 0);
}

static uint32_t said(const order *o) { return __atomic_load_n(&o->said, __ATOMIC_ACQUIRE); }

/* Waits for another word, or for some time [s]. */
static void await(order *o, uint32_t word, double seconds)
{
    const struct timespec limit = {(time_t)seconds, (long)(1e9 * (seconds - (double)(time_t)seconds))};
    if (syscall(SYS_futex, &o->said, FUTEX_WAIT, word, &limit, NULL, 0) == 0) errno = 0;
}

static void ask(remote *f, double time, double size)
{
    f->order->time = time, f->order->size = size;
    f->asked = 1;
    panda_say(f->order, TAKE_STEP);
}

static bool is_gone(const remote *f)
{
    char byte;
    const ssize_t count = recv(f->socket, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
    return count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR);
}

/* Waits a moment for an answer, which is taken later. */
static void glance(remote *f) { await(f->order, TAKE_STEP, f->limit < GLANCE ? f->limit : GLANCE); }

static unsigned answer(remote *f)
{
    f->asked = 0;
    for (const double until = now() + f->limit; said(f->order) == TAKE_STEP;) {
        const double rest = until - now();
        if (rest <= 0.0) return LATE;
        await(f->order, TAKE_STEP, rest < GLANCE ? rest : GLANCE);
        if (errno == EINTR) f->interrupted();
        else if (errno == ETIMEDOUT && is_gone(f) && said(f->order) == TAKE_STEP) return GONE;
    }
    f->heard |= said(f->order) == HEARD;
    return said(f->order) == FAILED ? TOLD : said(f->order) == ENDED_AT_END ? ENDED : 0;
}
#else
static void ask(remote *f, double time, double size) {}
static void glance(remote *f) {}
static unsigned answer(remote *f) { return GONE; }
#endif

static unsigned step(course *r, const call *c, double time)
{
    if (c->fmi == 0) {
        /* All that are stepped next are asked at once, and step beside each other. When the last one asked has
         * answered, most others have: to sleep once is cheaper than for each. */
        remote *last = NULL;
        for (const call *next = c; next < r->calls + r->call_count && next->action == STEP; next++)
            if (next->fmi == 0 && !((remote *)next->instance)->asked) {
                last = next->instance;
                ask(last, time, r->step_size);
            }
        if (last && last != c->instance) glance(last);
        const unsigned status = answer(c->instance);
        if (status == ENDED) r->ended = r->failed + 1;
        return status == ENDED ? 0 : status;
    }
    if (c->fmi != 3) return c->function.step2(c->instance, time, r->step_size, !c->later);
    bool event = false, ended = false, early = false;
    const double end = time + r->step_size;
    for (double size = r->step_size;; time = r->reached, size = end - time) {
        r->reached = end;
        const unsigned status =
            c->function.step3(c->instance, time, size, !c->later, &event, &ended, &early, &r->reached);
        if (status > WARNING) return status;
        if (ended && r->reached < end - ROUNDING * r->step_size) return ENDED;
        if (ended) r->ended = r->failed + 1;
        else if (event) return EVENT;
        if (ended || !early || r->reached >= end) return status;
        if (!(r->reached > time)) return EARLY; /* else the rest of the step follows */
    }
}

static unsigned carry_out(course *r, const call *c, int64_t k, double time)
{
    double *row = r->rows + (size_t)k * r->width;
    switch (c->action) {
    case STEP: return step(r, c, time);
    case COMPLETE:
        if (!are_finite(row, c->columns, c->moved, r->width)) return NOT_FINITE;
        r->filled = k + 1;
        return 0;
    case FEED_BACK:
        for (size_t i = 0; i < c->moved; i++) row[r->width + c->columns[i]] = row[c->columns[i]];
        return 0;
    default: return exchange(c, c->later ? row + r->width : row);
    }
}

/* Takes up to `count` steps from `tick` on, whose row is `k`; returns how many were taken. Fewer are if a call
 * fails, if it was asked to stop, or after `seconds` of wall time. */
EXPORT int64_t panda_take_steps(course *r, int64_t tick, int64_t k, int64_t count, double seconds)
{
    const double until = now() + seconds;
    for (int64_t taken = 0; taken < count; taken++) {
        const double time = r->start + (double)(tick + taken) * r->step_size;
        for (r->failed = 0; r->failed < r->call_count; r->failed++) {
            call *c = &r->calls[r->failed];
            const double began = r->timed ? now() : 0.0;
            r->status = carry_out(r, c, k + taken, time);
            if (r->timed) c->seconds += now() - began;
            if (r->status > WARNING) return taken;
        }
        if (*r->stop || r->ended || now() >= until) return taken + 1;
    }
    return count;
}

#if defined(__linux__)
/* Has an FMU's process listen to its socket, after a step that was asked for and not awaited, as another failed. */
EXPORT unsigned panda_listen(remote *f)
{
    const unsigned status = f->asked ? answer(f) : 0;
    panda_say(f->order, LISTEN);
    return status;
}

/* In an FMU's process: takes the steps that are asked for. Returns 0 when it is to listen, 1 after a step that
 * failed, and 2 after one that ended the simulation or logged messages; these are still to be answered. */
EXPORT int panda_serve_steps(course *r, order *o)
{
    for (uint32_t word; (word = said(o)) != LISTEN;) {
        if (word != TAKE_STEP) {
            await(o, word, 1e6);
            continue;
        }
        r->start = o->time, r->step_size = o->size;
        panda_take_steps(r, 0, 0, 1, 1.0);
        if (r->status > WARNING) return 1;
        if (r->ended || *r->stop) return 2;
        panda_say(o, DONE);
    }
    o->said = DONE;
    return 0;
}
#endif
