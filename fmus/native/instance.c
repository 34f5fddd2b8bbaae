/* The life cycle of an instance. */
#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static fmu_status call(instance *c, fmu_status (*function)(fmu *f))
{
    fmu_status status;
    WITH_DEFAULT_FENV(status = function(&c->f));
    return status;
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
    c->untuned = c->outdated = c->has_stop_time = c->ended = false;
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
        log_refusal(r, "out of memory");
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
    if (has_stop_time && (isnan(stop_time) || stop_time < start_time)) /* comparing NaN would trap */
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
    c->complete = false;
    return FMU_OK;
}

fmu_status instance_outputs(instance *c)
{
    if (!c->outdated) return FMU_OK;
    if (fmu_backend.outputs && call(c, fmu_backend.outputs) != FMU_OK) return FMU_ERROR;
    c->outdated = false;
    return FMU_OK;
}

fmu_status instance_all_outputs(instance *c)
{
    if (c->complete) return instance_outputs(c);
    c->outdated = true;
    for (unsigned i = 0; i < c->table.count; i++) c->table.variables[i].was_read |= 2;
    const fmu_status status = instance_outputs(c);
    for (unsigned i = 0; i < c->table.count; i++) c->table.variables[i].was_read &= 1;
    c->complete = status == FMU_OK;
    return status;
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
    if (fmu_backend.initialized && call(c, fmu_backend.initialized) != FMU_OK) return FMU_ERROR;
    c->state = STEP_MODE;
    return FMU_OK;
}

fmu_status instance_terminate(instance *c)
{
    const bool was_running = c->state == STEP_MODE;
    c->state = TERMINATED;
    return was_running && fmu_backend.terminate ? call(c, fmu_backend.terminate) : FMU_OK;
}
