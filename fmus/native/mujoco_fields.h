/* Fields of mjModel and mjData by their names. */
#ifndef FMU_MUJOCO_FIELDS_H
#define FMU_MUJOCO_FIELDS_H

#include <mujoco/mujoco.h>

/* The field, and how many numbers it has; NULL if there is none of that name and of type mjtNum. */
mjtNum *model_field(mjModel *m, const char *name, size_t *size);
mjtNum *data_field(const mjModel *m, mjData *d, const char *name, size_t *size);

#endif
