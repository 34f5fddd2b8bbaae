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
    double time, size;       /* communication point and communication step, while a step is taken [s] */
    void *model;             /* the backend's own */
} fmu;

/* Functions return FMU_OK, or FMU_ERROR after fmu_error() with the reason. All may be NULL except those
 * marked *. They are called with the default floating-point environment, never by two threads at
 * once for one instance. After an error of start, other start values may be tried; after any
 * other, only `start`, `outputs` are not called before that, and `destroy`.
 */
typedef struct {
    /* Once, at instantiation: read resources, keep what is needed in f->model. `destroy` is called
     * also after it has failed, with f->model as it was left. */
    fmu_status (*create)(fmu *f);
    void (*destroy)(fmu *f);

    /* * Make the model anew from the parameters in f->values, at f->start_time, and leave the outputs
     * of the start. Called when initialization ends, before that if outputs are asked for, again
     * after a parameter has changed, after fmi2Reset, and before `set_state` where the parameters of
     * the state differ. It leaves inputs and parameters alone. */
    fmu_status (*start)(fmu *f);

    /* Tunable parameters have changed in f->values since the last start, tune or step. */
    fmu_status (*tune)(fmu *f);

    /* * Take `count` >= 1 internal steps with the inputs held; without an internal step, 1 of f->size.
     * Outputs may be left to `outputs`. */
    fmu_status (*step)(fmu *f, int64_t count);

    /* Write the outputs to f->values; called before they are read, if there has been a step since. In
     * initialization also after inputs have been set. */
    fmu_status (*outputs)(fmu *f);

    /* All that the next step and the outputs depend on, but values and texts, as bytes. `state_size`
     * is called before each `get_state`; 0 if there is nothing. `set_state` takes the bytes after the
     * values have been restored. They come from an instance with the same table; their checksum
     * is right, their meaning may still have to be checked. */
    size_t (*state_size)(fmu *f); /* SIZE_MAX after fmu_error() */
    fmu_status (*get_state)(fmu *f, void *bytes);
    fmu_status (*set_state)(fmu *f, const void *bytes, size_t size);

    fmu_status (*terminate)(fmu *f); /* no step will follow, unless it is started anew */
} fmu_backend_functions;

extern const fmu_backend_functions fmu_backend;

/* What a backend may call. Messages are UTF-8, without a line break at the end. */
#if defined(__GNUC__)
#define FMU_FORMAT(place) __attribute__((format(printf, place, place + 1)))
#else
#define FMU_FORMAT(place)
#endif
fmu_status fmu_error(fmu *f, const char *format, ...) FMU_FORMAT(2);  /* tells; returns FMU_ERROR */
void fmu_warn(fmu *f, const char *format, ...) FMU_FORMAT(2);         /* tells each text once */
void fmu_log(fmu *f, fmu_status status, const char *text);
fmu_status fmu_set_text(fmu *f, unsigned reference, const char *text);

/* A file of the resources with a '\0' behind it, to be freed; NULL after fmu_error(). */
char *fmu_read_resource(fmu *f, const char *name, size_t *size);

#endif
