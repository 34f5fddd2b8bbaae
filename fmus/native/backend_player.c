/* Plays a table: one row of outputs per internal step, from t = 0.
 *
 * At t_k the outputs are row k: after initialization the row of the start time, after a step the row
 * of its end. After the last row they are held. The table is the resource that the option `table` names;
 * without it, outputs keep their start values. A String parameter, with which the same FMU in Python reads a CSV
 * file, must be empty.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "backend.h"

typedef struct {
    double *rows;
    size_t count; /* of rows; 0: no table */
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
    return FMU_OK;
}

static void destroy(fmu *f)
{
    player *p = f->model;
    if (!p) return;
    free(p->rows);
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

static void show(fmu *f, int64_t steps)
{
    const player *p = f->model;
    unsigned first;
    const size_t width = find_outputs(f, &first);
    if (!p->count) return;
    const double row = round(f->start_time / f->table->step) + (double)steps;
    const double last = (double)(p->count - 1);
    memcpy(f->values + first, p->rows + (size_t)fmin(fmax(row, 0.0), last) * width, width * sizeof(double));
}

static fmu_status start(fmu *f)
{
    const char *path = given_path(f);
    if (*path)
        return fmu_error(f, "%s: a native FMU plays only the table that it was built with; one of kind python reads "
                         "CSV files", path);
    show(f, 0);
    return FMU_OK;
}

static fmu_status step(fmu *f, int64_t count)
{
    show(f, f->steps + count);
    return FMU_OK;
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .step = step};
