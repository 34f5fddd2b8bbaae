/* An instance: its life, its values, its communication steps. */
#include "instance.h"

#include <fenv.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double MOST_STEPS = 1e9;       /* internal steps in one communication step */
static const double STEP_TOLERANCE = 1e-6;  /* of an internal step: rounding of communication points */
static const double TIME_TOLERANCE = 1e-3;  /* of an internal step */
static const double FREE_TOLERANCE = 1e-9;  /* [s], where there is no internal step */

enum { NAME_SIZE = 512 };

/* ---- arithmetic: a host may have changed the rounding mode, or made exceptions trap ---- */

static fmu_status call(instance *c, fmu_status (*function)(fmu *f))
{
    fenv_t of_host;
    fegetenv(&of_host);
    fesetenv(FE_DFL_ENV);
    const fmu_status status = function(&c->f);
    fesetenv(&of_host);
    return status;
}

fmu_status instance_set_model_state(instance *c, const void *bytes, size_t size)
{
    fenv_t of_host;
    fegetenv(&of_host);
    fesetenv(FE_DFL_ENV);
    const fmu_status status = fmu_backend.set_state(&c->f, bytes, size);
    fesetenv(&of_host);
    return status;
}

/* ---- life ---- */

static fmu_status set_start_values(instance *c)
{
    for (unsigned i = 0; i < c->table.count; i++) {
        const fmu_variable *v = &c->table.variables[i];
        memcpy(c->f.values + v->reference, v->start, v->size * sizeof *v->start);
        for (unsigned k = 0; v->type == FMU_STRING && k < v->size; k++)
            if (fmu_set_text(&c->f, v->reference + k, v->start_text) != FMU_OK) return FMU_ERROR;
    }
    return FMU_OK;
}

fmu_status instance_reset(instance *c)
{
    c->state = INSTANTIATED;
    c->stale = c->unchecked = true;
    c->untuned = c->outdated = c->has_stop_time = false;
    c->f.start_time = c->f.time = c->carry = 0.0;
    c->f.steps = 0;
    return set_start_values(c);
}

static instance *begin(const instance_request *r, const char *function)
{
    instance *c = calloc(1, sizeof *c);
    char *name = c ? copy_text(r->name ? r->name : "") : NULL;
    if (!name) {
        free(c);
        return NULL;
    }
    c->name = name;
    c->version = r->version;
    c->log2 = r->log2;
    c->log3 = r->log3;
    c->environment = r->environment;
    c->function = function;
    c->categories = LOG_WARNINGS | LOG_ERRORS | (r->logging ? LOG_REST : 0u);
    c->state = INSTANTIATED;
    return c;
}

static bool read_table(instance *c, const char *location)
{
    char why[1024] = "out of memory";
    size_t size;
    c->resources = find_resources(location, why, sizeof why);
    if (!c->resources) return fmu_error(&c->f, "%s", why), false;
    c->f.resources = c->resources;
    char *path = join_path(c->resources, "variables.txt");
    char *text = path ? read_file(path, &size, why, sizeof why) : NULL;
    free(path);
    if (!text)
        return fmu_error(&c->f, "%s; the resource location was '%.400s'", why, location), false;
    if (!fmu_table_read(&c->table, text, size, why, sizeof why))
        return fmu_error(&c->f, "%s/variables.txt, %s is wrong", c->resources, why), false;
    return true;
}

static bool prepare(instance *c, const instance_request *r)
{
    if (!read_table(c, r->resources)) return false;
    if (!r->token || strcmp(r->token, c->table.token) != 0)
        return fmu_error(&c->f, "the token '%s' is not that of this FMU, '%s': is modelDescription.xml that of "
                         "these resources (%s)?", r->token ? r->token : "", c->table.token,
                         c->resources), false;
    c->f.table = &c->table;
    c->f.values = calloc((size_t)c->table.size + 1, sizeof *c->f.values);
    c->f.texts = calloc((size_t)c->table.size + 1, sizeof *c->f.texts);
    if (!c->f.values || !c->f.texts || instance_reset(c) != FMU_OK)
        return fmu_error(&c->f, "out of memory"), false;
    c->created = true;
    return !fmu_backend.create || call(c, fmu_backend.create) == FMU_OK;
}

instance *instance_create(const instance_request *request, const char *function)
{
    instance *c = begin(request, function);
    if (c && prepare(c, request)) return c;
    instance_free(c);
    return NULL;
}

instance *instance_refuse(const instance_request *request, const char *function, const char *why)
{
    instance *c = begin(request, function);
    if (c) fmu_error(&c->f, "%s", why);
    instance_free(c);
    return NULL;
}

void instance_free(instance *c)
{
    if (!c) return;
    c->function = c->version == 3 ? "fmi3FreeInstance" : "fmi2FreeInstance";
    if (c->created && fmu_backend.destroy) fmu_backend.destroy(&c->f);
    for (unsigned i = 0; c->f.texts && i < c->table.size; i++) free(c->f.texts[i]);
    free(c->f.texts);
    free(c->f.values);
    fmu_table_free(&c->table);
    free(c->resources);
    free(c->name);
    free(c);
}

static const char *state_name(instance_state state)
{
    switch (state) {
    case INSTANTIATED: return "instantiated, not initialized";
    case INITIALIZATION_MODE: return "in initialization mode";
    case STEP_MODE: return "initialized";
    case TERMINATED: return "terminated";
    default: return "in the error state after an earlier failure";
    }
}

bool instance_begin(instance *c, const char *function, unsigned states)
{
    if (!c) return false;
    c->function = function;
    if (c->state & states) return true;
    fmu_error(&c->f, "must not be called now: the instance is %s", state_name(c->state));
    return false;
}

fmu_status instance_setup(instance *c, double start_time, bool has_stop_time, double stop_time)
{
    if (!isfinite(start_time)) return fmu_error(&c->f, "the start time %g s is not finite", start_time);
    if (has_stop_time && !(stop_time >= start_time))
        return fmu_error(&c->f, "the stop time %g s is before the start time %g s", stop_time, start_time);
    c->f.start_time = c->f.time = start_time;
    c->stop_time = stop_time;
    c->has_stop_time = has_stop_time;
    c->stale = true;
    return FMU_OK;
}

fmu_status instance_start(instance *c)
{
    if (!c->stale) return FMU_OK;
    c->f.steps = 0;
    if (call(c, fmu_backend.start) != FMU_OK) return FMU_ERROR;
    c->stale = c->untuned = false;
    c->outdated = true; /* inputs may have been set */
    return FMU_OK;
}

fmu_status instance_outputs(instance *c)
{
    if (!c->outdated) return FMU_OK;
    if (fmu_backend.outputs && call(c, fmu_backend.outputs) != FMU_OK) return FMU_ERROR;
    c->outdated = false;
    return FMU_OK;
}

fmu_status instance_tune(instance *c)
{
    if (!c->untuned) return FMU_OK;
    if (fmu_backend.tune && call(c, fmu_backend.tune) != FMU_OK) return FMU_ERROR;
    c->untuned = false;
    return FMU_OK;
}

fmu_status instance_initialized(instance *c)
{
    if (instance_start(c) != FMU_OK) return FMU_ERROR;
    c->state = STEP_MODE;
    return FMU_OK;
}

fmu_status instance_terminate(instance *c)
{
    const bool was_running = c->state == STEP_MODE;
    c->state = TERMINATED;
    return was_running && fmu_backend.terminate ? call(c, fmu_backend.terminate) : FMU_OK;
}

/* ---- values ---- */

static double load(value_format format, const void *values, size_t i)
{
    switch (format) {
    case AS_INT: return ((const int *)values)[i];
    case AS_INT32: return ((const int32_t *)values)[i];
    case AS_INT64: return (double)((const int64_t *)values)[i];
    case AS_BOOL: return ((const bool *)values)[i];
    default: return ((const double *)values)[i];
    }
}

static void store(value_format format, void *values, size_t i, double value)
{
    switch (format) {
    case AS_INT: ((int *)values)[i] = (int)value; break;
    case AS_INT32: ((int32_t *)values)[i] = (int32_t)value; break;
    case AS_INT64: ((int64_t *)values)[i] = (int64_t)value; break;
    case AS_BOOL: ((bool *)values)[i] = value != 0.0; break;
    default: ((double *)values)[i] = value;
    }
}

/* FMI 2.0 has no enumerations among its functions: theirs is that of integers. */
static bool type_fits(const instance *c, fmu_type type, const fmu_variable *v)
{
    return v->type == type || (c->version == 2 && type == FMU_INTEGER && v->type == FMU_ENUMERATION);
}

/* The variable that a reference means, and how many elements; NULL after telling why not. */
static const fmu_variable *look_up(instance *c, fmu_type type, unsigned reference, unsigned *size)
{
    static const char *const NAMES[] = {"Real", "Integer", "Boolean", "Enumeration", "String"};
    if (reference >= c->table.size) {
        fmu_error(&c->f, "no variable has the value reference %u", reference);
        return NULL;
    }
    const fmu_variable *v = &c->table.variables[c->table.variable_at[reference]];
    if (!type_fits(c, type, v)) {
        fmu_error(&c->f, "%s (value reference %u) is of type %s", v->name, reference, NAMES[v->type]);
        return NULL;
    }
    if (c->version == 3 && reference != v->reference) {
        fmu_error(&c->f, "the value reference %u is not that of a variable, but inside %s", reference, v->name);
        return NULL;
    }
    *size = c->version == 3 ? v->size : 1;
    return v;
}

static bool arguments_are_there(instance *c, const void *references, size_t count, const void *values,
                                size_t value_count)
{
    if ((references || count == 0) && (values || value_count == 0)) return true;
    fmu_error(&c->f, "an array is missing");
    return false;
}

static bool sizes_fit(instance *c, size_t needed, size_t given)
{
    if (needed == given) return true;
    fmu_error(&c->f, "%zu values for variables with %zu elements", given, needed);
    return false;
}

static bool is_computed(const fmu_variable *v)
{
    return v->causality == FMU_OUTPUT || v->causality == FMU_LOCAL;
}

/* Brings computed values up to date, where they are asked for. */
static fmu_status refresh(instance *c, const fmu_variable *v)
{
    if (!is_computed(v) || c->state == FAILED) return FMU_OK; /* in the error state: the last ones */
    if (c->state == INSTANTIATED)
        return fmu_error(&c->f, "%s is not known before initialization", v->name);
    return instance_start(c) == FMU_OK && instance_outputs(c) == FMU_OK ? FMU_OK : FMU_ERROR;
}

fmu_status instance_get(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, void *values, size_t value_count)
{
    size_t at = 0;
    if (!arguments_are_there(c, references, count, values, value_count)) return FMU_ERROR;
    for (size_t i = 0; i < count; i++) {
        unsigned size;
        const fmu_variable *v = look_up(c, type, references[i], &size);
        if (!v || refresh(c, v) != FMU_OK) return FMU_ERROR;
        if (size > value_count - at) return sizes_fit(c, at + size, value_count), FMU_ERROR;
        if (v->causality == FMU_INDEPENDENT) c->f.values[v->reference] = c->f.time;
        for (unsigned k = 0; k < size; k++) store(format, values, at++, c->f.values[references[i] + k]);
    }
    return sizes_fit(c, at, value_count) ? FMU_OK : FMU_ERROR;
}

/* Whether this variable may be set in the state of now. */
static bool is_settable(instance *c, const fmu_variable *v)
{
    const char *why = NULL;
    if (is_computed(v) || v->causality == FMU_INDEPENDENT)
        why = "it is computed by the FMU";
    else if (v->variability == FMU_CONSTANT)
        why = "it is constant";
    else if (c->state == STEP_MODE && v->causality == FMU_PARAMETER && v->variability != FMU_TUNABLE)
        why = "it is a fixed parameter, and initialization is over";
    if (why) fmu_error(&c->f, "%s cannot be set: %s", v->name, why);
    return !why;
}

/* Parameters are checked when they are set; inputs when a step is taken, see check_inputs. */
static bool is_sound(instance *c, const fmu_variable *v, unsigned reference, double value)
{
    char name[NAME_SIZE];
    const unsigned k = reference - v->reference;
    if (v->causality == FMU_INPUT && v->type == FMU_REAL) return true;
    if (isfinite(value) && v->minimum[k] <= value && value <= v->maximum[k]) return true;
    fmu_error(&c->f, "%s = %g is out of range [%g, %g]", fmu_name(&c->table, reference, name, sizeof name),
              value, v->minimum[k], v->maximum[k]);
    return false;
}

static bool can_set(instance *c, fmu_type type, value_format format, const unsigned *references,
                    size_t count, const void *values, size_t value_count)
{
    size_t at = 0;
    if (!arguments_are_there(c, references, count, values, value_count)) return false;
    for (size_t i = 0; i < count; i++) {
        unsigned size;
        const fmu_variable *v = look_up(c, type, references[i], &size);
        if (!v || !is_settable(c, v)) return false;
        if (size > value_count - at) return sizes_fit(c, at + size, value_count);
        for (unsigned k = 0; k < size; k++, at++)
            if (!is_sound(c, v, references[i] + k, load(format, values, at))) return false;
    }
    return sizes_fit(c, at, value_count);
}

/* Notes what has to follow from a new value. */
static void note_change(instance *c, const fmu_variable *v)
{
    if (v->causality == FMU_INPUT) {
        c->unchecked = true;
        if (c->state != STEP_MODE) c->outdated = true;
    } else if (c->state == STEP_MODE) {
        c->untuned = true;
    } else {
        c->stale = true;
    }
}

fmu_status instance_set(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, const void *values, size_t value_count)
{
    size_t at = 0;
    if (!can_set(c, type, format, references, count, values, value_count)) return FMU_ERROR;
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *v = &c->table.variables[c->table.variable_at[references[i]]];
        const unsigned size = c->version == 3 ? v->size : 1;
        for (unsigned k = 0; k < size; k++, at++) {
            const double value = load(format, values, at);
            c->f.values[references[i] + k] = v->type == FMU_BOOLEAN ? value != 0.0 : value;
        }
        note_change(c, v);
    }
    return FMU_OK;
}

fmu_status fmu_set_text(fmu *f, unsigned reference, const char *text)
{
    if (f->texts[reference] && !strcmp(f->texts[reference], text)) return FMU_OK;
    char *copy = copy_text(text);
    if (!copy) return fmu_error(f, "out of memory");
    free(f->texts[reference]);
    f->texts[reference] = copy;
    return FMU_OK;
}

fmu_status instance_get_texts(instance *c, const unsigned *references, size_t count, const char **texts,
                              size_t text_count)
{
    size_t at = 0;
    if (!arguments_are_there(c, references, count, texts, text_count)) return FMU_ERROR;
    for (size_t i = 0; i < count; i++) {
        unsigned size;
        const fmu_variable *v = look_up(c, FMU_STRING, references[i], &size);
        if (!v || refresh(c, v) != FMU_OK) return FMU_ERROR;
        if (size > text_count - at) return sizes_fit(c, at + size, text_count), FMU_ERROR;
        for (unsigned k = 0; k < size; k++) texts[at++] = c->f.texts[references[i] + k];
    }
    return sizes_fit(c, at, text_count) ? FMU_OK : FMU_ERROR;
}

fmu_status instance_set_texts(instance *c, const unsigned *references, size_t count,
                              const char *const *texts, size_t text_count)
{
    size_t at = 0;
    if (!arguments_are_there(c, references, count, texts, text_count)) return FMU_ERROR;
    for (size_t i = 0; i < count; i++) {
        unsigned size;
        const fmu_variable *v = look_up(c, FMU_STRING, references[i], &size);
        if (!v || !is_settable(c, v)) return FMU_ERROR;
        for (unsigned k = 0; k < size; k++, at++)
            if (at >= text_count || !texts[at]) return fmu_error(&c->f, "%s: no text was given", v->name);
    }
    if (!sizes_fit(c, at, text_count)) return FMU_ERROR;
    at = 0;
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *v = &c->table.variables[c->table.variable_at[references[i]]];
        const unsigned size = c->version == 3 ? v->size : 1;
        for (unsigned k = 0; k < size; k++)
            if (fmu_set_text(&c->f, references[i] + k, texts[at++]) != FMU_OK) return FMU_ERROR;
        note_change(c, v);
    }
    return FMU_OK;
}

/* ---- a communication step ---- */

/* Refuses an input that is not finite, and clamps one that is out of its bounds. */
static fmu_status check_input(instance *c, const fmu_variable *v, unsigned k)
{
    char name[NAME_SIZE];
    double *value = c->f.values + v->reference + k;
    if (v->minimum[k] <= *value && *value <= v->maximum[k] && isfinite(*value)) return FMU_OK;
    fmu_name(&c->table, v->reference + k, name, sizeof name);
    if (!isfinite(*value)) return fmu_error(&c->f, "input %s = %g is not finite", name, *value);
    fmu_warn(&c->f, "input %s was out of its range [%g, %g] and is clamped (said once)", name,
             v->minimum[k], v->maximum[k]);
    *value = fmin(fmax(*value, v->minimum[k]), v->maximum[k]);
    return FMU_OK;
}

static fmu_status check_inputs(instance *c)
{
    for (unsigned i = 0; c->unchecked && i < c->table.count; i++) {
        const fmu_variable *v = &c->table.variables[i];
        if (v->causality != FMU_INPUT || v->type != FMU_REAL) continue;
        for (unsigned k = 0; k < v->size; k++)
            if (check_input(c, v, k) != FMU_OK) return FMU_ERROR;
    }
    c->unchecked = false;
    return FMU_OK;
}

/* Rounding that communication points may have, in internal steps. */
static double rounding(const instance *c, double time)
{
    return fmin(STEP_TOLERANCE + 4.0 * DBL_EPSILON * fabs(time) / c->table.step, 0.5);
}

static fmu_status check_span(instance *c, double time, double size)
{
    const double step = c->table.step;
    const double tolerance = step > 0.0 ? (TIME_TOLERANCE + rounding(c, time)) * step
                                        : fmax(FREE_TOLERANCE, 4.0 * DBL_EPSILON * fabs(time));
    if (!isfinite(time) || fabs(time - c->f.time) > tolerance)
        return fmu_error(&c->f, "the communication point %.9g s is not where the last step has ended, %.9g s",
                         time, c->f.time);
    if (!(size >= 0.0) || !isfinite(size) || size > (step > 0.0 ? MOST_STEPS * step : size))
        return fmu_error(&c->f, "a communication step of %g s; it must be from 0 to %g internal steps", size,
                         MOST_STEPS);
    if (c->has_stop_time && time + size > c->stop_time + tolerance)
        return fmu_error(&c->f, "the step would end at %.9g s, after the stop time of %.9g s", time + size,
                         c->stop_time);
    return FMU_OK;
}

/* Whole internal steps of a communication step and of what was carried; the new carry. */
static int64_t count_steps(const instance *c, double time, double size, double *carry)
{
    if (!(c->table.step > 0.0)) {
        *carry = 0.0;
        return 1;
    }
    const double tolerance = rounding(c, time + size);
    const double whole = floor(c->carry + size / c->table.step + tolerance);
    *carry = c->carry + size / c->table.step - whole;
    if (fabs(*carry) <= tolerance) *carry = 0.0; /* rounding, not a part of a step */
    return (int64_t)whole;
}

static fmu_status take_steps(instance *c, double time, double size)
{
    double carry;
    const int64_t count = count_steps(c, time, size, &carry);
    c->f.size = size;
    if (instance_tune(c) != FMU_OK || (count > 0 && fmu_backend.step(&c->f, count) != FMU_OK)) {
        c->state = FAILED;
        return FMU_ERROR;
    }
    c->outdated = c->outdated || count > 0;
    c->f.steps += count;
    c->carry = carry;
    c->f.time = time + size;
    return FMU_OK;
}

fmu_status instance_step(instance *c, double time, double size)
{
    fenv_t of_host;
    fegetenv(&of_host);
    fesetenv(FE_DFL_ENV);
    fmu_status status = check_span(c, time, size);
    if (status == FMU_OK && size > 0.0) status = check_inputs(c);
    if (status == FMU_OK && size > 0.0) status = take_steps(c, time, size);
    fesetenv(&of_host);
    return status;
}
