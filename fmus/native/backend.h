/* The interface between the FMI layer and a backend, which computes an FMU's values.
 *
 * The FMI layer (fmi2.c, fmi3.c, instance.c, state.c) knows phases, references and types; a backend
 * knows a model. Each FMU's library holds one backend, `fmu_backend`.
 *
 * All values are one array of doubles, `values`, in the order of resources/variables.txt. A value
 * reference is an index into it, in FMI 2.0 and FMI 3.0 alike; Booleans are 0 or 1, enumerations and
 * integers whole numbers. The text of a String variable is `texts[reference]`.
 */
#ifndef FMU_BACKEND_H
#define FMU_BACKEND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "table.h"

/* The first five values of fmi2Status and fmi3Status, which are the same. */
typedef enum { FMU_OK, FMU_WARNING, FMU_DISCARD, FMU_ERROR, FMU_FATAL } fmu_status;

/* An instance, as its backend sees it. */
typedef struct {
    const char *resources;   /* folder of the resources, UTF-8, absolute, no separator at the end */
    const fmu_table *table;  /* variables and options of resources/variables.txt */
    double *values;          /* by value reference; outputs are written here, all others read */
    char **texts;            /* text of String variables, by value reference; change by fmu_set_text */
    double start_time;       /* [s] */
    int64_t steps;           /* internal steps done since start_time */
    double time, size;       /* communication point and step size during a step [s] */
    void *model;             /* owned by the backend */
} fmu;

/* Functions return FMU_OK, or FMU_ERROR after fmu_error() with the reason. All may be NULL except those
 * marked *. They are called with the default floating-point environment, and never by two threads at
 * once for one instance. After an error in `start`, the importer may try other start values; after any
 * other error, only `start` and `destroy` are called.
 */
typedef struct {
    /* Called once, at instantiation: read resources, and keep data in f->model. `destroy` is also
     * called after a failure, with f->model as `create` left it. */
    fmu_status (*create)(fmu *f);
    void (*destroy)(fmu *f);

    /* * Rebuild the model from the parameters in f->values, at f->start_time, and write the outputs of
     * the start. Called when initialization ends, or before if outputs are read; again after a
     * parameter has changed, after fmi2Reset, and before `set_state` if the state has other
     * parameters. Must not change inputs or parameters. */
    fmu_status (*start)(fmu *f);

    /* Initialization has ended: the first step may follow. */
    fmu_status (*initialized)(fmu *f);

    /* Tunable parameters have changed in f->values since the last start, tune or step. */
    fmu_status (*tune)(fmu *f);

    /* * Take `count` >= 1 internal steps with the inputs held; without an internal step size, one step
     * of f->size. Outputs may be written later, in `outputs`. FMU_DISCARD, after fmu_log() with the
     * reason: the simulation is to end where this step begins. */
    fmu_status (*step)(fmu *f, int64_t count);

    /* Write the outputs to f->values, at least those of variables with `was_read`; called before they are
     * read after a step or for the first time, and in initialization after inputs have been set. */
    fmu_status (*outputs)(fmu *f);

    /* The state besides values and texts, as bytes: all that the next step and the outputs depend on.
     * `state_size` is called before each `get_state`; 0 if there is none. `set_state` is called after
     * the values have been restored, with bytes of an instance with the same table and a correct
     * checksum; a backend may still have to check their content. */
    size_t (*state_size)(fmu *f); /* SIZE_MAX after fmu_error() */
    fmu_status (*get_state)(fmu *f, void *bytes);
    fmu_status (*set_state)(fmu *f, const void *bytes, size_t size);

    fmu_status (*terminate)(fmu *f); /* no step follows, unless `start` is called again */
} fmu_backend_functions;

extern const fmu_backend_functions fmu_backend;

/* What a backend may call. Messages are UTF-8, without a line break at the end. */
#if defined(__GNUC__)
#define FMU_FORMAT(place) __attribute__((format(printf, place, place + 1)))
#else
#define FMU_FORMAT(place)
#endif
fmu_status fmu_error(fmu *f, const char *format, ...) FMU_FORMAT(2);  /* logs; returns FMU_ERROR */
void fmu_warn(fmu *f, const char *format, ...) FMU_FORMAT(2);         /* logs each text once */
void fmu_log(fmu *f, fmu_status status, const char *text);
fmu_status fmu_set_text(fmu *f, unsigned reference, const char *text);

/* Reads a file of the resources and appends '\0'. The caller frees it; NULL after fmu_error(). */
char *fmu_read_resource(fmu *f, const char *name, size_t *size);

#endif
