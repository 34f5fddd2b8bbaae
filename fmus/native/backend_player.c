/* Plays a table: one row of outputs per internal step, from t = 0.
 *
 * At t_k the outputs are row k: after initialization the row of the start time, after a step the row
 * of its end. After the last row they are held. The table is the resource that the option `table` names;
 * without it, outputs keep their start values. A String parameter, with which the same FMU in Python reads a CSV
 * file, must be empty. With the options `guards` and `left`, rows end early: see player_guard.h.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "player_guard.h"

typedef struct {
    double *rows;
    size_t count; /* of rows; 0: no table */
    guarded guarded;
} player;

/* Reference of the first output, and the number of outputs; they are contiguous. */
static size_t find_outputs(const fmu *f, unsigned *first)
{
    size_t width = 0;
    *first = 0;
    for (unsigned i = f->table->count; i-- > 0;)
        if (f->table->variables[i].causality == FMU_OUTPUT) {
            width += f->table->variables[i].size;
            *first = f->table->variables[i].reference;
        }
    return width;
}

static fmu_status create(fmu *f)
{
    unsigned first;
    size_t size;
    const char *name = fmu_get_option(f->table, "table", 0);
    const size_t row_size = find_outputs(f, &first) * sizeof(double);
    player *p = f->model = calloc(1, sizeof *p);
    if (!p) return fmu_error(f, "out of memory");
    if (!name) return FMU_OK;
    p->rows = (double *)(void *)fmu_read_resource(f, name, &size);
    if (!p->rows) return FMU_ERROR;
    if (!row_size || size % row_size || !size)
        return fmu_error(f, "%s has %zu bytes, not whole rows of %zu", name, size, row_size);
    p->count = size / row_size;
    p->guarded = (guarded){.rows = p->rows, .row_count = p->count, .width = row_size / sizeof(double), .first = first};
    return guarded_create(f, &p->guarded);
}

static void destroy(fmu *f)
{
    player *p = f->model;
    if (!p) return;
    free(p->rows);
    guarded_free(&p->guarded);
    free(p);
}

/* Path in the String parameter; "" if there is none. */
static const char *given_path(const fmu *f)
{
    for (unsigned i = 0; i < f->table->count; i++) {
        const fmu_variable *v = &f->table->variables[i];
        if (v->type == FMU_STRING && v->causality == FMU_PARAMETER) return f->texts[v->reference];
    }
    return "";
}

/* Tick of the table after a number of steps. */
static int64_t tick_at(const fmu *f, int64_t steps)
{
    return llround(f->start_time / f->table->step) + steps;
}

static void show(fmu *f, int64_t steps)
{
    const player *p = f->model;
    unsigned first;
    const size_t width = find_outputs(f, &first);
    if (!p->count) return;
    const double tick = (double)tick_at(f, steps), last = (double)(p->count - 1);
    memcpy(f->values + first, p->rows + (size_t)fmin(fmax(tick, 0.0), last) * width, width * sizeof(double));
    if (p->guarded.guards) guarded_show(f, &p->guarded, tick_at(f, steps));
}

static fmu_status start(fmu *f)
{
    const char *path = given_path(f);
    if (*path)
        return fmu_error(f, "%s: a native FMU plays only the table that it was built with; one of kind python reads "
                         "CSV files", path);
    memset(&((player *)f->model)->guarded.state, 0, sizeof(guard_state));
    show(f, 0);
    return FMU_OK;
}

static fmu_status step(fmu *f, int64_t count)
{
    player *p = f->model;
    for (int64_t i = 1; i <= count && p->guarded.guards; i++)
        guarded_look(f, &p->guarded, tick_at(f, f->steps + i));
    show(f, f->steps + count);
    return FMU_OK;
}

static size_t state_size(fmu *f)
{
    const player *p = f->model;
    return p->guarded.guards ? sizeof(guard_state) : 0;
}

static fmu_status get_state(fmu *f, void *bytes)
{
    memcpy(bytes, &((player *)f->model)->guarded.state, state_size(f));
    return FMU_OK;
}

static fmu_status set_state(fmu *f, const void *bytes, size_t size)
{
    if (size != state_size(f)) return fmu_error(f, "the state is one of another table");
    memcpy(&((player *)f->model)->guarded.state, bytes, size);
    return FMU_OK;
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .step = step,
    .state_size = state_size, .get_state = get_state, .set_state = set_state};
