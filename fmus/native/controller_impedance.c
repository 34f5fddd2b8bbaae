/* Cartesian impedance: controller/impedance.py. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

static const double COMPLIANCE = 1e-3, MIN_PIVOT = 1e-20;
static const double MEAN_RATIO = 1000.0;
enum { MEAN_STEPS = 8, SQUARE = TWIST * TWIST };
static const double TORQUE = 5.0, TORQUE_RATE = 6.0; /* values of `limit` */

/* Torques of gravity, velocities and joint damping of the own model at the measured joints. */
static void bias_force(const controller_mujoco *mj, const controller *c, double bias[JOINTS])
{
    const controller_inputs *x = &c->inputs;
    const double damping = robot_of(&c->gains)->joint_damping;
    double all[ARM_DOFS];
    memcpy(mj->data->qpos, x->qpos, sizeof x->qpos);
    memcpy(mj->data->qvel, x->qvel, sizeof x->qvel);
    mj->call.mj_kinematics(mj->arm, mj->data);
    mj->call.mj_comPos(mj->arm, mj->data);
    mj->call.mj_comVel(mj->arm, mj->data);
    mj->call.mj_rne(mj->arm, mj->data, 0, all);
    for (int i = 0; i < JOINTS; i++) bias[i] = all[i] + damping * x->qvel[i];
}

/* J M^-1 (TWIST x JOINTS) where `bias_force` was last called. */
static void moved_by(const controller_mujoco *mj, const double *jac, double *moved)
{
    double rows[TWIST * ARM_DOFS] = {0}, solved[TWIST * ARM_DOFS];
    for (int i = 0; i < TWIST; i++) memcpy(rows + ARM_DOFS * i, jac + JOINTS * i, JOINTS * sizeof *jac);
    mj->call.mj_makeM(mj->arm, mj->data);
    mj->call.mj_factorM(mj->arm, mj->data);
    mj->call.mj_solveM(mj->arm, mj->data, solved, rows, TWIST);
    for (int i = 0; i < TWIST; i++) memcpy(moved + JOINTS * i, solved + ARM_DOFS * i, JOINTS * sizeof *jac);
}

/* Inverse of a symmetric positive definite matrix (TWIST x TWIST). */
static void invert(const controller_functions *mj, const double *matrix, double *inverse)
{
    double factor[SQUARE];
    memcpy(factor, matrix, sizeof factor);
    mj->mju_cholFactor(factor, TWIST, MIN_PIVOT);
    for (int i = 0; i < TWIST; i++) {
        double column[TWIST] = {0};
        column[i] = 1.0;
        mj->mju_cholSolve(inverse + TWIST * i, factor, column, TWIST);
    }
}

/* Geometric mean of a matrix and a diagonal one: controller/linalg.py. */
static void geometric_mean(const controller_functions *mj, const double *matrix, const double *diagonal,
                           double *mean)
{
    double other[SQUARE], inverse_mean[SQUARE], inverse_other[SQUARE];
    invert(mj, matrix, other);
    for (int i = 0; i < SQUARE; i++) {
        mean[i] = i % (TWIST + 1) ? 0.0 : diagonal[i / TWIST];
        other[i] = other[i] / MEAN_RATIO;
    }
    for (int step = 0; step < MEAN_STEPS; step++) {
        invert(mj, mean, inverse_mean);
        invert(mj, other, inverse_other);
        for (int i = 0; i < SQUARE; i++) {
            mean[i] = 0.5 * (mean[i] + inverse_other[i]);
            other[i] = 0.5 * (other[i] + inverse_mean[i]);
        }
    }
    for (int i = 0; i < SQUARE; i++) mean[i] = mean[i] / sqrt(MEAN_RATIO);
}

void start_impedance_law(controller *c, const controller_mujoco *mj)
{
    controller_outputs *y = &c->outputs;
    bias_force(mj, c, c->state.impedance.torque_before);
    get_twist_cmd(&c->inputs, c->state.impedance.twist_before);
    memcpy(c->state.impedance.jac_before, c->inputs.jac, sizeof c->inputs.jac);
    memset(c->state.impedance.offset, 0, sizeof c->state.impedance.offset);
    memset(y->dq, 0, sizeof y->dq);
    memset(y->qvel_ref, 0, sizeof y->qvel_ref);
    y->singular = 0.0;
    double pose[POSE];
    get_pose_cmd(&c->inputs, pose);
    reset_late(c->state.impedance.poses, pose);
}

/* In place. */
static void shorten(const controller_functions *mj, double vector[3], double most)
{
    const double length = mj->mju_norm3(vector), share = most / length;
    for (int i = 0; i < 3 && length > most; i++) vector[i] *= share;
}

/* Force and torque of the springs and dampers (TWIST), without inertia. */
static void wrench_of(controller *c, const controller_functions *mj, const double *inertia,
                      const double *twist_cmd, double wrench[TWIST])
{
    const controller_inputs *x = &c->inputs;
    const controller_gains *gains = &c->gains;
    const double *force = x->force_cmd;
    const bool commanded = force[0] != 0.0 || force[1] != 0.0 || force[2] != 0.0;
    double *offset = c->state.impedance.offset;
    double damping[SQUARE], error[TWIST], twist[TWIST], slip[TWIST], spring[TWIST];
    late_pose_error(c, mj, c->state.impedance.poses, error);
    for (int i = 0; i < TWIST; i++) spring[i] = gains->stiffness[i] * error[i];
    shorten(mj, spring, gains->spring_force);
    shorten(mj, spring + 3, gains->spring_torque);
    geometric_mean(mj, inertia, gains->stiffness, damping);
    for (int i = 0; i < SQUARE; i++) damping[i] = 2.0 * gains->damping_ratio * damping[i];
    mj->mju_mulMatVec(twist, x->jac, x->qvel, TWIST, JOINTS);
    for (int i = 0; i < TWIST; i++) slip[i] = twist_cmd[i] - twist[i];
    mj->mju_mulMatVec(wrench, damping, slip, TWIST, TWIST);
    for (int i = 0; i < TWIST; i++) {
        const double most = gains->offset_limit[i];
        const double grown = offset[i] + c->period * gains->offset_rate * spring[i];
        const bool rests = i < 3 ? force[i] != 0.0 : commanded;
        if (!rests) offset[i] = clamp(grown, -most, most);
        wrench[i] = spring[i] + wrench[i] + offset[i];
        if (i < 3) wrench[i] += force[i];
    }
}

/* In place: within the limits of torque and torque rate. */
static void limit_torque(controller *c, int joint, double *torque)
{
    const double share = c->gains.limit_share, most = share * CONTROLLER_COMMON.torque_max[joint];
    const double step = share * CONTROLLER_COMMON.torque_rate_max * c->period;
    const double before = c->state.impedance.torque_before[joint];
    const double unlimited = clamp(*torque, -most, most);
    *torque = clamp(unlimited, before - step, before + step);
    c->outputs.limit[joint] = *torque != unlimited ? TORQUE_RATE : fabs(unlimited) == most ? TORQUE : 0.0;
}

void update_impedance_law(controller *c, const controller_mujoco *mujoco)
{
    const controller_functions *mj = &mujoco->call;
    const controller_inputs *x = &c->inputs;
    const controller_gains *gains = &c->gains;
    const controller_robot *robot = robot_of(gains);
    controller_outputs *y = &c->outputs;
    double *twist_before = c->state.impedance.twist_before;

    /* The hand's inertia, by the own model. */
    double bias[JOINTS], moved[TWIST * JOINTS], inverse_inertia[SQUARE], inertia[SQUARE];
    bias_force(mujoco, c, bias);
    moved_by(mujoco, x->jac, moved);
    mj->mju_mulMatMatT(inverse_inertia, moved, x->jac, TWIST, JOINTS, TWIST);
    for (int i = 0; i < TWIST; i++) inverse_inertia[(TWIST + 1) * i] += COMPLIANCE;
    invert(mj, inverse_inertia, inertia);

    /* Springs, dampers; the posture in the null space; the inertia of what the command changes. */
    double twist_cmd[TWIST], wrench[TWIST], spare[JOINTS], drift[TWIST], change[TWIST], force[TWIST];
    double jac_change[TWIST * JOINTS], turning[TWIST];
    get_twist_cmd(x, twist_cmd);
    wrench_of(c, mj, inertia, twist_cmd, wrench);
    const double *posture = gains->follow_posture != 0.0 ? x->posture_cmd : gains->posture;
    for (int i = 0; i < JOINTS; i++)
        spare[i] = gains->posture_stiffness * (posture[i] - x->qpos[i]) - gains->posture_damping * x->qvel[i];
    mj->mju_mulMatVec(drift, moved, spare, TWIST, JOINTS);
    for (int i = 0; i < TWIST * JOINTS; i++) jac_change[i] = x->jac[i] - c->state.impedance.jac_before[i];
    memcpy(c->state.impedance.jac_before, x->jac, sizeof x->jac);
    mj->mju_mulMatVec(turning, jac_change, x->qvel, TWIST, JOINTS);
    for (int i = 0; i < TWIST; i++) {
        change[i] = (twist_cmd[i] - twist_before[i] - turning[i]) / c->period - drift[i];
        twist_before[i] = twist_cmd[i];
    }
    mj->mju_mulMatVec(force, inertia, change, TWIST, TWIST);
    for (int i = 0; i < TWIST; i++) wrench[i] += force[i];

    double torque[JOINTS], factor[SQUARE];
    mj->mju_mulMatTVec(torque, x->jac, wrench, TWIST, JOINTS);
    for (int i = 0; i < JOINTS; i++) {
        torque[i] = torque[i] + spare[i] + bias[i];
        limit_torque(c, i, &torque[i]);
        c->state.impedance.torque_before[i] = y->motor_torque[i] = torque[i];
        y->ctrl[i] = clamp(x->qpos[i], robot->q_min[i], robot->q_max[i]);
        y->qpos_ref[i] = x->qpos[i];
    }
    damped_factor(mj, x->jac, 0.0, factor);
    y->manipulability = manipulability(factor);
}
