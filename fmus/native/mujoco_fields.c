#include "mujoco_fields.h"

#include <string.h>

#include <mujoco/mjxmacro.h>

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wconversion" /* MuJoCo's macros shorten sizes to int */
#pragma GCC diagnostic ignored "-Wunused-variable" /* and declare all sizes of their version */
#endif

mjtNum *model_field(mjModel *m, const char *name, size_t *size)
{
    MJMODEL_POINTERS_PREAMBLE(m)
#define X(type, field, rows, columns)                            \
    if (!strcmp(#type, "mjtNum") && !strcmp(name, #field)) {     \
        *size = (size_t)m->rows * (size_t)(columns);             \
        return (mjtNum *)(void *)m->field;                       \
    }
    MJMODEL_POINTERS
#undef X
#define X(field, count)                  \
    if (!strcmp(name, #field)) {         \
        *size = count;                   \
        return (mjtNum *)&m->opt.field;  \
    }
    X(gravity, 3) X(wind, 3) X(magnetic, 3) X(density, 1) X(viscosity, 1)
#undef X
    return NULL;
}

mjtNum *data_field(const mjModel *m, mjData *d, const char *name, size_t *size)
{
    MJMODEL_POINTERS_PREAMBLE(m)
#define X(type, field, rows, columns)                            \
    if (!strcmp(#type, "mjtNum") && !strcmp(name, #field)) {     \
        *size = (size_t)m->rows * (size_t)(columns);             \
        return (mjtNum *)(void *)d->field;                       \
    }
    MJDATA_POINTERS
#undef X
    if (!strcmp(name, "energy")) return *size = 2, d->energy;
    return NULL;
}
