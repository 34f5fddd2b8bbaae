/* A communication step: checked, then divided into whole internal steps. */
#include <float.h>
#include <math.h>

#include "instance.h"

static const double MOST_STEPS = 1e9;       /* internal steps in one communication step */
static const double STEP_TOLERANCE = 1e-6;  /* in internal steps: rounding of communication points */
static const double TIME_TOLERANCE = 1e-3;  /* in internal steps */
static const double FREE_TOLERANCE = 1e-9;  /* [s], without an internal step */

/* Whether all values are finite and in their ranges; without branches, as this is nearly always so. */
static bool are_sound(const fmu_variable *v, const double *values)
{
    bool sound = true;
    for (unsigned k = 0; k < v->size; k++)
        sound &= (v->minimum[k] <= values[k]) & (values[k] <= v->maximum[k]) & (fabs(values[k]) <= DBL_MAX);
    return sound;
}

/* Refuses inputs that are not finite, and clamps those that are out of range. */
static fmu_status check_input(instance *c, const fmu_variable *v, unsigned k)
{
    char name[NAME_SIZE];
    double *value = c->f.values + v->reference + k;
    if (v->minimum[k] <= *value && *value <= v->maximum[k] && isfinite(*value)) return FMU_OK;
    fmu_name(&c->table, v->reference + k, name, sizeof name);
    if (!isfinite(*value)) return fmu_error(&c->f, "input %s = %g is not finite", name, *value);
    fmu_warn(&c->f, "input %s was out of its range [%g, %g] and is clamped (logged once)", name,
             v->minimum[k], v->maximum[k]);
    *value = fmin(fmax(*value, v->minimum[k]), v->maximum[k]);
    return FMU_OK;
}

static fmu_status check_inputs(instance *c)
{
    for (unsigned i = 0; c->unchecked && i < c->table.count; i++) {
        const fmu_variable *v = &c->table.variables[i];
        if (v->causality != FMU_INPUT || v->type != FMU_REAL || are_sound(v, c->f.values + v->reference)) continue;
        for (unsigned k = 0; k < v->size; k++)
            if (check_input(c, v, k) != FMU_OK) return FMU_ERROR;
    }
    c->unchecked = false;
    return FMU_OK;
}

/* Permitted rounding of communication points, in internal steps. */
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

/* Whole internal steps of a communication step plus the carry, and the new carry. */
static int64_t count_steps(const instance *c, double time, double size, double *carry)
{
    if (!(c->table.step > 0.0)) {
        *carry = 0.0;
        return 1;
    }
    const double tolerance = rounding(c, time + size);
    const double whole = floor(c->carry + size / c->table.step + tolerance);
    *carry = c->carry + size / c->table.step - whole;
    if (fabs(*carry) <= tolerance) *carry = 0.0; /* rounding error */
    return (int64_t)whole;
}

static fmu_status take_steps(instance *c, double time, double size)
{
    double carry;
    const int64_t count = count_steps(c, time, size, &carry);
    c->f.size = size;
    fmu_status status = instance_tune(c);
    if (status == FMU_OK && count > 0) status = fmu_backend.step(&c->f, count);
    c->ended = status == FMU_DISCARD;
    if (c->ended) return FMU_DISCARD;
    if (status != FMU_OK) {
        c->state = FAILED;
        return FMU_ERROR;
    }
    c->outdated = c->outdated || count > 0;
    c->complete = c->complete && count == 0;
    c->f.steps += count;
    c->carry = carry;
    c->f.time = time + size;
    return FMU_OK;
}

static fmu_status step(instance *c, double time, double size)
{
    if (check_span(c, time, size) != FMU_OK) return FMU_ERROR;
    if (size == 0.0) return FMU_OK;
    return check_inputs(c) == FMU_OK ? take_steps(c, time, size) : FMU_ERROR;
}

fmu_status instance_step(instance *c, double time, double size)
{
    fmu_status status;
    WITH_DEFAULT_FENV(status = step(c, time, size));
    return status;
}
