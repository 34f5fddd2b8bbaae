/* Fields of mjModel and mjData by their names. */
#ifndef FMU_MUJOCO_FIELDS_H
#define FMU_MUJOCO_FIELDS_H

#include <stdbool.h>

#include <mujoco/mujoco.h>

/* Returns a field of type mjtNum and its number of elements; NULL if there is none of that name. */
mjtNum *model_field(mjModel *m, const char *name, size_t *size);
mjtNum *data_field(const mjModel *m, mjData *d, const char *name, size_t *size);

/* All of a model's data as bytes. `data_read` makes data of them for mj_copyData, whose pointers lead into the
 * bytes; false if they are not of data like this. */
size_t data_size(const mjData *d);
void data_write(const mjData *d, void *bytes);
bool data_read(const void *bytes, size_t size, const mjData *like, mjData *written);

#endif
