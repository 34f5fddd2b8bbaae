/* Plays a table: one row of outputs per internal step, from t = 0.
 *
 * At t_k the outputs are row k: after initialization the row of the start time, after a step the row
 * of its end. After the last row they are held. The table is the resource that the option `table` names, or
 * the CSV file that a String parameter names; with neither, outputs keep their start values.
 */
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend.h"
#include "resources.h"

static const double TIME_TOLERANCE = 1e-6; /* of an internal step */

typedef struct {
    double *rows;
    size_t count; /* of rows; 0: no table */
} rows_of;

typedef struct {
    rows_of built_in, given;
    char *path; /* of `given`; NULL: none read yet */
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
    p->built_in.rows = (double *)(void *)fmu_read_resource(f, name, &size);
    if (!p->built_in.rows) return FMU_ERROR;
    if (!row_size || size % row_size || !size)
        return fmu_error(f, "%s has %zu bytes, not whole rows of %zu", name, size, row_size);
    p->built_in.count = size / row_size;
    return FMU_OK;
}

static void forget(player *p)
{
    free(p->given.rows);
    free(p->path);
    p->given = (rows_of){0};
    p->path = NULL;
}

static void destroy(fmu *f)
{
    player *p = f->model;
    if (!p) return;
    forget(p);
    free(p->built_in.rows);
    free(p);
}

/* Parses a decimal number independently of the host's locale; sets `end` after it. */
static double read_decimal(const char *text, const char **end)
{
    char digits[64], *stop;
    size_t length = strcspn(text, ",\r\n");
    *end = text;
    if (length >= sizeof digits) return NAN;
    memcpy(digits, text, length);
    digits[length] = '\0';
    char *point = strchr(digits, '.');
    if (point && *localeconv()->decimal_point) *point = *localeconv()->decimal_point;
    const double number = strtod(digits, &stop);
    stop += strspn(stop, " \t");
    if (stop != digits && !*stop) *end = text + length;
    return number;
}

/* Whether the first line is `time` and the outputs' names, with or without quotation marks. */
static bool header_fits(const fmu *f, const char *line, unsigned first, size_t width)
{
    char name[512];
    for (size_t i = 0; i <= width; i++) {
        const char *wanted = i == 0 ? "time" : fmu_name(f->table, first + (unsigned)i - 1, name, sizeof name);
        line += strspn(line, " \"");
        if (strncmp(line, wanted, strlen(wanted)) != 0) return false;
        line += strlen(wanted);
        line += strspn(line, " \"\r");
        if (*line++ != (i == width ? '\n' : ',')) return false;
    }
    return true;
}

/* Parses one line of numbers, the time first; returns the text after it, or NULL. */
static const char *read_row(const char *text, double *time, double *row, size_t width)
{
    for (size_t i = 0; i <= width; i++) {
        const char *end;
        double *to = i == 0 ? time : &row[i - 1];
        *to = read_decimal(text, &end);
        if (end == text || !isfinite(*to)) return NULL;
        text = end;
        if (i < width && *text++ != ',') return NULL;
    }
    text += strspn(text, "\r");
    if (*text && *text != '\n') return NULL;
    return *text ? text + 1 : text;
}

static fmu_status parse(fmu *f, const char *path, const char *text, rows_of *rows)
{
    unsigned first;
    const size_t width = find_outputs(f, &first);
    size_t lines = 0;
    for (const char *c = text; *c; c++) lines += *c == '\n';
    if (!header_fits(f, text, first, width))
        return fmu_error(f, "%s: line 1: the columns must be time and the names of the outputs", path);
    rows->rows = calloc((lines + 1) * width, sizeof(double));
    if (!rows->rows) return fmu_error(f, "out of memory");
    text = strchr(text, '\n') + 1;
    for (; *text; rows->count++) {
        double time;
        text = read_row(text, &time, rows->rows + rows->count * width, width);
        if (!text) return fmu_error(f, "%s: line %zu: %zu finite numbers are needed", path, rows->count + 2, width + 1);
        const double wanted = (double)rows->count * f->table->step;
        if (fabs(time - wanted) > TIME_TOLERANCE * f->table->step)
            return fmu_error(f, "%s: line %zu: time %.9g s; must be %.9g s, a row each %g s from 0 on", path,
                             rows->count + 2, time, wanted, f->table->step);
    }
    return rows->count ? FMU_OK : fmu_error(f, "%s has no rows", path);
}

static fmu_status read_given(fmu *f, player *p, const char *path)
{
    char why[1024];
    size_t size;
    if (p->path && !strcmp(p->path, path)) return FMU_OK;
    forget(p);
    char *text = read_file(path, &size, why, sizeof why);
    if (!text) return fmu_error(f, "%s", why);
    const fmu_status status = parse(f, path, text, &p->given);
    free(text);
    if (status == FMU_OK) p->path = copy_text(path);
    return status;
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
    const rows_of *rows = *given_path(f) ? &p->given : &p->built_in;
    unsigned first;
    const size_t width = find_outputs(f, &first);
    if (!rows->count) return;
    const double row = round(f->start_time / f->table->step) + (double)steps;
    const double last = (double)(rows->count - 1);
    memcpy(f->values + first, rows->rows + (size_t)fmin(fmax(row, 0.0), last) * width, width * sizeof(double));
}

static fmu_status start(fmu *f)
{
    const char *path = given_path(f);
    if (*path && read_given(f, f->model, path) != FMU_OK) return FMU_ERROR;
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
