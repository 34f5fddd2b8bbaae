/* MuJoCo's library: opened from the FMU's folder, and called in a way that no error ends the host. */
#ifndef FMU_MUJOCO_LIBRARY_H
#define FMU_MUJOCO_LIBRARY_H

#include <mujoco/mujoco.h>

#include "backend.h"

#define MUJOCO_FUNCTIONS(X)                                                                          \
    X(mj_version) X(mj_loadModelBuffer) X(mj_copyModel) X(mj_deleteModel) X(mj_makeData)             \
    X(mj_deleteData) X(mj_resetData) X(mj_resetDataKeyframe) X(mj_forward) X(mj_kinematics)          \
    X(mj_setConst) X(mj_step) X(mj_step1) X(mj_step2) X(mj_jacBody) X(mj_jacBodyCom) X(mj_jacGeom)   \
    X(mj_jacSite) X(mj_fullM) X(mj_contactForce) X(mj_stateSize) X(mj_getState) X(mj_setState) X(mj_copyData)       \
    X(mju_dot) X(mju_rayGeom) X(mj_rayMesh) X(mj_rayHfield)                                          \
    X(mj_comPos) X(mj_makeM) X(mj_mulM) X(mj_comVel) X(mj_rne) X(mj_factorM) X(mj_solveM) X(mju_boxQP) X(mju_cholFactor) X(mju_cholSolve)              \
    X(mju_mulMatMatT) X(mju_mulMatTMat) X(mju_mulMatTVec) X(mju_mulMatVec) X(mju_norm) X(mju_norm3)  \
    X(mju_normalize) X(mju_rotVecQuat) X(mju_subQuat)

/* The functions, by their names: `mj.mj_step(m, d)`. */
typedef struct {
#define X(name) __typeof__(&name) name;
    MUJOCO_FUNCTIONS(X)
#undef X
    __typeof__(&mju_setLogHandler) set_log_handler; /* of the calling thread */
} mujoco_functions;

extern mujoco_functions mj;

/* Opens the library, once per process. */
fmu_status mujoco_open(fmu *f);

/* Calls a function that calls MuJoCo. MuJoCo's warnings are logged. A fatal error, on which MuJoCo would
 * end the process, is logged and makes this return FMU_ERROR; it leaves the function by longjmp, so
 * the function must not own memory. */
fmu_status mujoco_guarded(fmu *f, fmu_status (*function)(fmu *f, void *argument), void *argument);

/* Loads a model (MJB) of the resources, which the caller deletes; NULL after fmu_error(). */
mjModel *mujoco_load(fmu *f, const char *name);

#endif
