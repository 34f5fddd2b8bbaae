/* Fields of mjModel and mjData by their names. */
#ifndef FMU_MUJOCO_FIELDS_H
#define FMU_MUJOCO_FIELDS_H

#include <mujoco/mujoco.h>

/* Returns a field of type mjtNum and its number of elements; NULL if there is none of that name. */
mjtNum *model_field(mjModel *m, const char *name, size_t *size);
mjtNum *data_field(const mjModel *m, mjData *d, const char *name, size_t *size);

#endif
