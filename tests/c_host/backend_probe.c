/* A backend for tests of the FMI layer: integrates an input, and fails when it is told to.
 *
 * Variables by their order in the table of tests/native_probe.py: see the enumeration.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "backend.h"

enum { U, FAIL, X, COUNT, MATRIX, GAIN = MATRIX + 6, OFFSET, FLAG, CHOICE, WHOLE, TEXT, ECHO, BIG };

static double *x_of(fmu *f) { return f->model; }

static fmu_status create(fmu *f)
{
    f->model = calloc(1, sizeof(double));
    if (fmu_get_option(f->table, "refuse", 0)) return fmu_error(f, "refused: 100%% of %s", "it");
    return f->model ? FMU_OK : fmu_error(f, "out of memory");
}

static void destroy(fmu *f) { free(f->model); }

static fmu_status start(fmu *f)
{
    if (f->values[OFFSET] > 99.0) return fmu_error(f, "an offset of %g", f->values[OFFSET]);
    *x_of(f) = f->values[OFFSET];
    return FMU_OK;
}

static fmu_status step(fmu *f, int64_t count)
{
    if (f->values[FAIL] > 0.5) return fmu_error(f, "told to fail at %g%% of it", 100.0 * f->values[FAIL]);
    for (int64_t i = 0; i < count && i < 1000000; i++) *x_of(f) += f->values[GAIN] * f->values[U] * f->table->step;
    return FMU_OK;
}

static fmu_status outputs(fmu *f)
{
    f->values[X] = *x_of(f);
    f->values[COUNT] = (double)f->steps;
    for (int i = 0; i < 6; i++) f->values[MATRIX + i] = 10.0 * (i / 3 + 1) + i % 3 + 1;
    f->values[BIG] = 1e9 * f->values[U];
    return fmu_set_text(f, ECHO, f->texts[TEXT]);
}

static size_t state_size(fmu *f)
{
    (void)f;
    return sizeof(double);
}

static fmu_status get_state(fmu *f, void *bytes)
{
    memcpy(bytes, f->model, sizeof(double));
    return FMU_OK;
}

static fmu_status set_state(fmu *f, const void *bytes, size_t size)
{
    if (size != sizeof(double)) return fmu_error(f, "a state of %zu bytes", size);
    memcpy(f->model, bytes, sizeof(double));
    return FMU_OK;
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .step = step, .outputs = outputs,
    .state_size = state_size, .get_state = get_state, .set_state = set_state};
