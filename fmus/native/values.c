/* Access by value reference. */
#include <math.h>
#include <string.h>

#include "instance.h"

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

/* Whether a computed number can be represented in this format. */
static bool can_store(value_format format, double value)
{
    switch (format) {
    case AS_INT:
    case AS_INT32: return isfinite(value) && value >= INT32_MIN && value <= INT32_MAX;
    case AS_INT64: return isfinite(value) && fabs(value) < 0x1p63;
    default: return true;
    }
}

/* FMI 2.0 has no functions for enumerations; those for integers are used. */
static bool type_fits(const instance *c, fmu_type type, const fmu_variable *v)
{
    return v->type == type || (c->version == 2 && type == FMU_INTEGER && v->type == FMU_ENUMERATION);
}

/* Contiguous elements of one variable, as named by references. */
typedef struct {
    const fmu_variable *variable;
    unsigned reference, size;
} span;

/* The variable of a reference; NULL after logging the reason. */
static const fmu_variable *look_up(instance *c, fmu_type type, unsigned reference)
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
    if (c->version == 3 && !c->table.array_at[reference]) {
        fmu_error(&c->f, "the value reference %u is not that of a variable, but inside %s", reference, v->name);
        return NULL;
    }
    return v;
}

static size_t smaller_of(size_t a, size_t b) { return a < b ? a : b; }

/* Takes the next references: in FMI 3.0 one, for a whole array; in FMI 2.0 as many as are consecutive in
 * one variable. */
static bool next_span(instance *c, fmu_type type, const unsigned *references, size_t count, size_t *at, span *s)
{
    s->reference = references[*at];
    s->variable = look_up(c, type, s->reference);
    if (!s->variable) return false;
    const unsigned rest = s->variable->reference + s->variable->size - s->reference;
    const size_t most = c->version == 3 ? 1 : smaller_of(rest, count - *at);
    size_t taken = 1;
    while (taken < most && references[*at + taken] == s->reference + taken) taken++;
    s->size = c->version == 3 ? c->table.array_at[s->reference] : (unsigned)taken;
    *at += taken;
    return true;
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

/* Updates computed values before they are read; a backend may leave out those that never were. */
static fmu_status refresh(instance *c, const fmu_variable *v)
{
    if (is_computed(v) && !v->was_read) {
        c->table.variables[v - c->table.variables].was_read = 1;
        c->outdated = c->outdated || !c->complete;
    }
    if (!is_computed(v) || c->state == FAILED) return FMU_OK; /* the error state keeps the last values */
    if (c->state == INSTANTIATED)
        return fmu_error(&c->f, "%s is not known before initialization", v->name);
    return instance_start(c) == FMU_OK && instance_outputs(c) == FMU_OK ? FMU_OK : FMU_ERROR;
}

fmu_status instance_get(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, void *values, size_t value_count)
{
    span s;
    size_t at = 0;
    if (!arguments_are_there(c, references, count, values, value_count)) return FMU_ERROR;
    for (size_t i = 0; i < count;) {
        if (!next_span(c, type, references, count, &i, &s) || refresh(c, s.variable) != FMU_OK) return FMU_ERROR;
        if (s.size > value_count - at) return sizes_fit(c, at + s.size, value_count), FMU_ERROR;
        if (s.variable->causality == FMU_INDEPENDENT) c->f.values[s.reference] = c->f.time;
        if (format == AS_DOUBLE) {
            memcpy((double *)values + at, c->f.values + s.reference, s.size * sizeof(double));
            at += s.size;
            continue;
        }
        for (unsigned k = 0; k < s.size; k++) {
            const double value = c->f.values[s.reference + k];
            if (format == AS_TEXT) {
                ((const char **)values)[at++] = c->f.texts[s.reference + k];
                continue;
            }
            if (!can_store(format, value))
                return fmu_error(&c->f, "%s = %g does not fit an integer", s.variable->name, value);
            store(format, values, at++, value);
        }
    }
    return sizes_fit(c, at, value_count) ? FMU_OK : FMU_ERROR;
}

/* Whether this variable may be set in the current state. */
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
    if (isfinite(value) && v->minimum[k] <= value && value <= v->maximum[k]) return true;
    fmu_error(&c->f, "%s = %g is out of range [%g, %g]", fmu_name(&c->table, reference, name, sizeof name),
              value, v->minimum[k], v->maximum[k]);
    return false;
}

static bool can_be(instance *c, value_format format, const span *s, unsigned k, const void *values, size_t at)
{
    if (format != AS_TEXT) return is_sound(c, s->variable, s->reference + k, load(format, values, at));
    if (((const char *const *)values)[at]) return true;
    return fmu_error(&c->f, "%s: no text was given", s->variable->name), false;
}

static bool can_set(instance *c, fmu_type type, value_format format, const unsigned *references,
                    size_t count, const void *values, size_t value_count)
{
    span s;
    size_t at = 0;
    if (!arguments_are_there(c, references, count, values, value_count)) return false;
    for (size_t i = 0; i < count; at += s.size) {
        if (!next_span(c, type, references, count, &i, &s) || !is_settable(c, s.variable)) return false;
        if (s.size > value_count - at) return sizes_fit(c, at + s.size, value_count);
        if (s.variable->causality == FMU_INPUT && s.variable->type == FMU_REAL) continue;
        for (unsigned k = 0; k < s.size; k++)
            if (!can_be(c, format, &s, k, values, at + k)) return false;
    }
    return sizes_fit(c, at, value_count);
}

/* Marks what a new value makes necessary. */
static void note_change(instance *c, const fmu_variable *v)
{
    if (v->causality == FMU_INPUT) {
        c->unchecked = true;
        if (c->state != STEP_MODE) c->outdated = true, c->complete = false;
    } else if (c->state == STEP_MODE) {
        c->untuned = true;
    } else {
        c->stale = true;
    }
}

static fmu_status put(instance *c, value_format format, unsigned reference, const void *values, size_t at)
{
    if (format == AS_TEXT) return fmu_set_text(&c->f, reference, ((const char *const *)values)[at]);
    const double value = load(format, values, at);
    const bool is_switch = c->table.variables[c->table.variable_at[reference]].type == FMU_BOOLEAN;
    c->f.values[reference] = is_switch ? value != 0.0 : value;
    return FMU_OK;
}

fmu_status instance_set(instance *c, fmu_type type, value_format format, const unsigned *references,
                        size_t count, const void *values, size_t value_count)
{
    span s;
    size_t at = 0;
    if (!can_set(c, type, format, references, count, values, value_count)) return FMU_ERROR;
    for (size_t i = 0; i < count && next_span(c, type, references, count, &i, &s); at += s.size) {
        if (format == AS_DOUBLE)
            memcpy(c->f.values + s.reference, (const double *)values + at, s.size * sizeof(double));
        for (unsigned k = 0; k < s.size && format != AS_DOUBLE; k++)
            if (put(c, format, s.reference + k, values, at + k) != FMU_OK) return FMU_ERROR;
        note_change(c, s.variable);
    }
    return FMU_OK;
}
