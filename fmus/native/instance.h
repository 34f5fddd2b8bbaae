/* An instance of the FMU, and its functions for fmi2.c and fmi3.c. */
#ifndef FMU_INSTANCE_H
#define FMU_INSTANCE_H

#include <fenv.h>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#include "backend.h"
#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"
#include "resources.h"

/* States of the standards' state machines, as bits: a call names all states in which it is allowed. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION_MODE = 2,
    STEP_MODE = 4, /* FMI 2.0: slaveInitialized */
    TERMINATED = 8,
    FAILED = 16, /* FMI 2.0: error */
    ANY_STATE = 31
} instance_state;

enum { LOG_WARNINGS = 1, LOG_ERRORS = 2, LOG_REST = 4 }; /* enabled log categories */
enum { MOST_TOLD = 64 };                   /* number of warnings remembered as logged */

typedef struct {
    fmu f; /* first: a backend's `fmu *` is an `instance *` */
    fmu_table table;
    char *name, *resources;
    fmi2CallbackLogger log2; /* of the FMI version in use; the other is NULL */
    fmi3LogMessageCallback log3;
    void *environment;
    unsigned categories;
    uint64_t told[MOST_TOLD]; /* hashes of warnings */
    unsigned told_count;
    const char *function; /* the standard's function being called */
    int version;          /* of FMI */
    instance_state state;
    bool created;  /* the backend's `create` has been called */
    bool stale;    /* `start` is needed: a parameter has changed */
    bool untuned;  /* `tune` is needed */
    bool outdated; /* `outputs` is needed */
    bool complete; /* all outputs are up to date, also those that were never read */
    bool unchecked; /* an input has been set since the last step */
    bool ended;     /* the backend has asked to end the simulation */
    bool has_stop_time;
    double stop_time;
    double carry; /* part of an internal step carried over, in [0, 1) */
} instance;

typedef struct {
    int version;
    const char *name, *token, *resources;
    fmi2CallbackLogger log2;
    fmi3LogMessageCallback log3;
    void *environment;
    bool logging; /* loggingOn */
} instance_request;

/* Hosts may have changed the rounding mode or unmasked exceptions. On x86-64, numbers are SSE's, and its
 * register is switched 20 times as fast as the whole environment. */
#if defined(__SSE2__)
#define WITH_DEFAULT_FENV(statement)             \
    do {                                         \
        const unsigned of_host = _mm_getcsr();   \
        _mm_setcsr(_MM_MASK_MASK);               \
        statement;                               \
        _mm_setcsr(of_host);                     \
    } while (0)
#else
#define WITH_DEFAULT_FENV(statement) \
    do {                             \
        fenv_t of_host;              \
        fegetenv(&of_host);          \
        fesetenv(FE_DFL_ENV);        \
        statement;                   \
        fesetenv(&of_host);          \
    } while (0)
#endif

enum { NAME_SIZE = 512 }; /* longest variable name in a message; longer ones are truncated */

/* How a function of the standards passes values. */
typedef enum { AS_DOUBLE, AS_INT, AS_INT32, AS_INT64, AS_BOOL, AS_TEXT } value_format;

instance *instance_create(const instance_request *request, const char *function);
instance *instance_refuse(const instance_request *request, const char *function, const char *why);
void instance_free(instance *c);

/* Begins a call; false, after logging the reason, if it is not allowed now. */
bool instance_begin(instance *c, const char *function, unsigned states);

fmu_status instance_setup(instance *c, double start_time, bool has_stop_time, double stop_time);
fmu_status instance_initialized(instance *c);
fmu_status instance_reset(instance *c);
fmu_status instance_terminate(instance *c);

/* step.c */
fmu_status instance_step(instance *c, double time, double size);

/* values.c. In FMI 2.0 a reference means an element, in FMI 3.0 a whole array. */
fmu_status instance_get(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, void *values, size_t value_count);
fmu_status instance_set(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, const void *values, size_t value_count);

fmu_status instance_start(instance *c);   /* if needed */
fmu_status instance_outputs(instance *c); /* likewise */
fmu_status instance_all_outputs(instance *c); /* likewise, also those that were never read */
fmu_status instance_tune(instance *c);    /* likewise */

/* state.c */
fmu_status state_get(instance *c, void **state);
fmu_status state_set(instance *c, const void *state);
fmu_status state_size(instance *c, const void *state, size_t *size);
fmu_status state_serialize(instance *c, const void *state, unsigned char *bytes, size_t size);
fmu_status state_deserialize(instance *c, const unsigned char *bytes, size_t size, void **state);
void state_free(void **state);

/* log.c */
bool log_categories(instance *c, bool on, size_t count, const char *const *names);
void log_message(instance *c, fmu_status status, const char *text);
void log_refusal(const instance_request *request, const char *text); /* without an instance */

#endif
