/* Fields of mjModel and mjData by their names. */
#ifndef FMU_MUJOCO_FIELDS_H
#define FMU_MUJOCO_FIELDS_H

#include <mujoco/mujoco.h>

/* Returns a field of type mjtNum and its number of elements; NULL if there is none of that name. */
mjtNum *model_field(mjModel *m, const char *name, size_t *size);
mjtNum *data_field(const mjModel *m, mjData *d, const char *name, size_t *size);

/* All of a model's data as bytes. `data_read` changes aligned bytes into data for mj_copyData, whose pointers
 * lead into them; NULL if they are not of data like this. */
size_t data_size(const mjData *d);
void data_write(const mjData *d, void *bytes);
mjData *data_read(void *bytes, size_t size, const mjData *like);

#endif
