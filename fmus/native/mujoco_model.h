/* A MuJoCo model with its data, and the variables that refer to them. */
#ifndef FMU_MUJOCO_MODEL_H
#define FMU_MUJOCO_MODEL_H

#include "mujoco_library.h"

/* The first word of a variable's source; ../README.md describes them. */
typedef enum {
    SOURCE_DATA, SOURCE_HELD, SOURCE_JACOBIAN, SOURCE_MASS_MATRIX, SOURCE_CONTACT_SENSORS,
    SOURCE_CONTACT_BODIES, SOURCE_UNWANTED_CONTACTS, SOURCE_SUPPORT_CONTACTS, SOURCE_WARNINGS, SOURCE_MOTORS, SOURCE_EQ_ACTIVE, SOURCE_MODEL,
    SOURCE_SCENE, SOURCE_KEYFRAME, SOURCE_BODY_MASS, SOURCE_QPOS, SOURCE_QVEL, SOURCE_FREE_XY, SOURCE_FREE_YAW, SOURCE_ADDED,
    SOURCE_SCALED_MASS, SOURCE_SCALED_SERVO, SOURCE_SCALED_FORCE
} source_kind;

enum { FIELD_SIZE = 40 };

typedef struct {
    const fmu_variable *variable;
    source_kind kind;
    char field[FIELD_SIZE]; /* field of the data or the model; of a Jacobian: kind of object */
    int first;              /* id, or index of the first element */
    int *numbers;           /* ids: degrees of freedom, sensors, bodies, geoms to stand on, scaled objects */
    int number_count;
    bool stand, clear;      /* of a free body */
    double *place;          /* of its elements in the current data or model */
    double *followed;       /* an input's values of the keyframe that was chosen last; else NULL */
    double *weights;        /* of sensordata, for the sum of normal forces */
    int *ranks;             /* of geoms, which say whose contacts count */
} source;

typedef struct {
    mjModel **scenes; /* as compiled */
    int scene_count;
    int own_key;      /* keyframe that the table's start values are of; -1: qpos0 */
    int key;          /* keyframe to start from */
    mjModel *m;       /* a copy, with the parameters */
    mjData *d;
    source *sources;
    int source_count;
    double *scratch; /* for a Jacobian or a mass matrix */
    int warned[mjNWARNING]; /* numbers of `d->warning` that are counted already */
} mujoco_model;

/* mujoco_sources.c */
fmu_status sources_read(fmu *f, mujoco_model *model);
void sources_free(mujoco_model *model);
fmu_status sources_bind(fmu *f, mujoco_model *model); /* finds the elements in a new model */
bool sources_put_inputs(fmu *f, mujoco_model *model); /* whether the step that has begun must begin again */
void sources_follow_keyframe(fmu *f, mujoco_model *model); /* inputs that were not set take its values */
void sources_get_outputs(fmu *f, mujoco_model *model);
void sources_get_contacts(fmu *f, mujoco_model *model); /* those known only at the end of a step */
void sources_count_warnings(fmu *f, mujoco_model *model); /* those since the last call */
void sources_clear_held(fmu *f, mujoco_model *model);

/* mujoco_start.c */
fmu_status start_from_parameters(fmu *f, mujoco_model *model);
void start_put_tunable(fmu *f, mujoco_model *model);

#endif
