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

/* ---- all data as bytes: the struct, its buffer, the used part of its arena ---- */

size_t data_size(const mjData *d) { return sizeof *d + (size_t)d->nbuffer + d->parena; }

void data_write(const mjData *d, void *bytes)
{
    char *to = bytes;
    memcpy(to, d, sizeof *d);
    memcpy(to + sizeof *d, d->buffer, (size_t)d->nbuffer);
    memcpy(to + sizeof *d + d->nbuffer, d->arena, d->parena);
}

mjData *data_read(void *bytes, size_t size, const mjData *like)
{
    mjData *written = bytes;
    char *buffer = (char *)bytes + sizeof *written;
    if (size < sizeof *written) return NULL;
    if (written->nbuffer != like->nbuffer || written->narena != like->narena || written->nplugin != like->nplugin ||
        written->parena > (size_t)like->narena || size != data_size(written)) return NULL;
    char *arena = buffer + written->nbuffer, *old = written->buffer; /* where its pointers point */
#define X(type, field, rows, columns) \
    if (written->field) written->field = (void *)(buffer + ((char *)written->field - old));
    MJDATA_POINTERS
#undef X
    old = written->arena;
#define X(type, field, rows, columns) \
    if (written->field) written->field = (void *)(arena + ((char *)written->field - old));
    MJDATA_ARENA_POINTERS
#undef X
    written->buffer = buffer;
    written->arena = arena;
    return written;
}
