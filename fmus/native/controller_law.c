/* Two control laws, and what all share. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

static const double PULL_DAMPING = 0.05; /* see controller/ik.py */

/* ---- late readings: controller/signals.py ---- */

void reset_late(double rows[KEPT][JOINTS], const double now[JOINTS])
{
    for (int i = 0; i < KEPT; i++) memcpy(rows[i], now, sizeof rows[i]);
}

/* Keeps this update's vector, and gives that of the time when the readings were taken. */
static void recall(const controller *c, double rows[KEPT][JOINTS], const double now[JOINTS], double due[JOINTS])
{
    const int age = (int)nearbyint(c->gains.reading_delay / c->period); /* updates */
    memcpy(due, age ? rows[age - 1] : now, sizeof *rows);
    if (age == 0) return;
    memmove(rows[1], rows[0], (KEPT - 1) * sizeof *rows);
    memcpy(rows[0], now, sizeof *rows);
}

void get_pose_cmd(const controller_inputs *in, double pose[POSE])
{
    memcpy(pose, in->pos_cmd, sizeof in->pos_cmd);
    memcpy(pose + 3, in->quat_cmd, sizeof in->quat_cmd);
}

/* Pose error (TWIST), by the command of the readings' time. */
void late_pose_error(controller *c, const controller_functions *mj, double poses[KEPT][POSE],
                     double error[TWIST])
{
    double now[POSE], due[POSE];
    get_pose_cmd(&c->inputs, now);
    recall(c, poses, now, due);
    pose_error(mj, due, &c->inputs, error);
}

/* ---- the reference law: controller/reference_law.py ---- */

void get_twist_cmd(const controller_inputs *in, double twist[TWIST])
{
    memcpy(twist, in->vel_cmd, sizeof in->vel_cmd);
    memcpy(twist + 3, in->omega_cmd, sizeof in->omega_cmd);
}

void start_reference_law(controller *c, const controller_mujoco *mujoco)
{
    const controller_functions *mj = &mujoco->call;
    memcpy(c->state.reference.q_ref, c->inputs.qpos, sizeof c->inputs.qpos);
    memcpy(c->state.reference.qd_before, c->inputs.qvel, sizeof c->inputs.qvel);
    memset(c->state.reference.qdd_before, 0, sizeof c->state.reference.qdd_before);
    get_twist_cmd(&c->inputs, c->state.reference.twist_before);
    double pose[POSE];
    get_pose_cmd(&c->inputs, pose);
    pose_error(mj, pose, &c->inputs, c->state.reference.error);
    find_weak_direction(mj, c->inputs.jac, c->state.reference.weak_direction);
    pid_reset(&c->state.reference.pid);
    reset_late(c->state.reference.poses, pose);
    reset_late(c->state.reference.q_refs, c->inputs.qpos);
}

/* In place: the low-pass of the pose error, with backward Euler. */
static void smooth(controller *c, double error[TWIST])
{
    const double time = c->gains.error_filter, share = c->period / (time + c->period);
    double *before = c->state.reference.error;
    for (int i = 0; i < TWIST && time > 0.0; i++) error[i] = before[i] + share * (error[i] - before[i]);
    memcpy(before, error, sizeof c->state.reference.error);
}

/* Inertia force M(q) qdd of the arm, with the fingers at rest. */
void inertia_force(const controller_mujoco *mj, const double *q, const double *qdd, double force[JOINTS])
{
    double acceleration[ARM_DOFS] = {0}, all[ARM_DOFS];
    memcpy(mj->data->qpos, q, JOINTS * sizeof *q);
    mj->call.mj_kinematics(mj->arm, mj->data);
    mj->call.mj_comPos(mj->arm, mj->data);
    mj->call.mj_makeM(mj->arm, mj->data);
    memcpy(acceleration, qdd, JOINTS * sizeof *qdd);
    mj->call.mj_mulM(mj->arm, mj->data, all, acceleration);
    memcpy(force, all, JOINTS * sizeof *force);
}

/* Solves the damped least squares for qd (without limits), and returns the damping. If that is
 * above 0, the drift is projected out of the task, unless it follows a posture, which moves the hand
 * as the task does. */
static double solve(controller *c, const controller_functions *mj, const double *twist,
                    double drift[JOINTS], double qd[JOINTS])
{
    double factor[TWIST * TWIST];
    damped_factor(mj, c->inputs.jac, 0.0, factor);
    const double smallest = smallest_singular_value(mj, factor, c->state.reference.weak_direction);
    const double damping = singular_damping(smallest, &c->gains);
    c->outputs.manipulability = manipulability(factor);
    c->outputs.singular = smallest < c->gains.singular_value;
    if (damping > 0.0) {
        damped_factor(mj, c->inputs.jac, damping, factor);
        if (c->gains.follow_posture == 0.0)
            keep_null_space_part(mj, c->inputs.jac, PULL_DAMPING * damping, drift);
    }
    damped_least_squares(mj, c->inputs.jac, factor, twist, drift, qd);
    return damping;
}

/* Slows the hand down if a joint limit binds. */
static void limit(controller *c, const controller_functions *mj, const double *dq, double singular,
                  double qd[JOINTS])
{
    joint_limits limits;
    double low[JOINTS], high[JOINTS];
    const joint_course course = {c->state.reference.q_ref, c->state.reference.qd_before,
                                 c->state.reference.qdd_before, dq};
    memset(c->outputs.limit, 0, sizeof c->outputs.limit);
    limits_of(&c->gains, c->period, &limits);
    if (limits_inactive(&limits, qd, &course)) return;
    velocity_box(&limits, &course, low, high);
    if (within(qd, low, high)) return;
    scaled_least_squares(mj, c->inputs.jac, c->state.reference.error, c->gains.ik_damping, singular, low,
                         high, qd);
    for (int i = 0; i < JOINTS; i++)
        c->outputs.limit[i] = binding_limit(&limits, i, qd[i], &course, low[i], high[i]);
}

/* Joint velocity, of which the task leaves the null space's part. */
static double drift_of(const controller *c, int i)
{
    const controller_gains *gains = &c->gains;
    const double q_ref = c->state.reference.q_ref[i];
    if (gains->follow_posture != 0.0)
        return c->inputs.posture_vel_cmd[i] + gains->posture_follow_gain * (c->inputs.posture_cmd[i] - q_ref);
    return gains->posture_gain[i] * (gains->posture[i] - q_ref) + pull_from_ends(robot_of(gains), i, q_ref);
}

void update_reference_law(controller *c, const controller_mujoco *mujoco)
{
    const controller_functions *mj = &mujoco->call;
    const controller_inputs *x = &c->inputs;
    const controller_gains *gains = &c->gains;
    controller_outputs *y = &c->outputs;
    double *q_ref = c->state.reference.q_ref, *qd_before = c->state.reference.qd_before;
    double *twist_before = c->state.reference.twist_before;

    /* Twist: the command, extrapolated to the middle of the period, and the correction. */
    double error[TWIST], twist_cmd[TWIST], correction[TWIST], twist[TWIST];
    late_pose_error(c, mj, c->state.reference.poses, error);
    smooth(c, error);
    get_twist_cmd(x, twist_cmd);
    correcting_twist(mj, error, gains, correction);
    for (int i = 0; i < TWIST; i++)
        twist[i] = 1.5 * twist_cmd[i] - 0.5 * twist_before[i] + correction[i];

    /* Damped least squares; in the null space the drift; limits. */
    double drift[JOINTS], qd[JOINTS], dq[JOINTS], q_due[JOINTS];
    recall(c, c->state.reference.q_refs, q_ref, q_due);
    for (int i = 0; i < JOINTS; i++) {
        drift[i] = drift_of(c, i);
        dq[i] = q_due[i] - x->qpos[i];
    }
    const double damping = solve(c, mj, twist, drift, qd);
    limit(c, mj, dq, damping, qd);

    /* Feed-forward of servo lag, gravity and inertia; the PID. */
    double qdd[JOINTS], force[JOINTS], pid[JOINTS];
    for (int i = 0; i < JOINTS; i++) qdd[i] = (qd[i] - qd_before[i]) / c->period;
    inertia_force(mujoco, x->qpos, qdd, force);
    pid_update(&c->state.reference.pid, gains, c->period, dq, pid);

    /* Commit the outputs, with targets clipped to the joint ranges, and the state. */
    for (int i = 0; i < JOINTS; i++) {
        const double torque =
            gains->gravity_feedforward[i] * x->qfrc_bias[i] + gains->inertia_feedforward[i] * force[i];
        const double ctrl = q_ref[i] + gains->servo_lag[i] * qd[i] + torque / gains->servo_stiffness[i] + pid[i];
        y->ctrl[i] = clamp(ctrl, robot_of(gains)->q_min[i], robot_of(gains)->q_max[i]);
        y->dq[i] = dq[i];
        y->qpos_ref[i] = q_ref[i];
        y->qvel_ref[i] = qd[i];
        q_ref[i] += c->period * qd[i];
        qd_before[i] = qd[i];
        c->state.reference.qdd_before[i] = qdd[i];
    }
    memcpy(twist_before, twist_cmd, sizeof twist_cmd);
}

/* ---- the tutorial's law: controller/tutorial_law.py ---- */

void start_tutorial_law(controller *c, const controller_mujoco *mujoco)
{
    memset(c->outputs.qvel_ref, 0, sizeof c->outputs.qvel_ref);
    memset(c->outputs.limit, 0, sizeof c->outputs.limit);
    c->outputs.singular = 0.0;
    pid_reset(&c->state.tutorial.pid);
    double pose[POSE];
    get_pose_cmd(&c->inputs, pose);
    reset_late(c->state.tutorial.poses, pose);
}

void update_tutorial_law(controller *c, const controller_mujoco *mujoco)
{
    const controller_functions *mj = &mujoco->call;
    double error[TWIST], factor[TWIST * TWIST], solution[TWIST], dq[JOINTS], pid[JOINTS];
    late_pose_error(c, mj, c->state.tutorial.poses, error);
    damped_factor(mj, c->inputs.jac, 0.0, factor);
    mj->mju_cholSolve(solution, factor, error, TWIST);
    mj->mju_mulMatTVec(dq, c->inputs.jac, solution, TWIST, JOINTS); /* pinv(J) e */
    pid_update(&c->state.tutorial.pid, &c->gains, c->period, dq, pid);
    c->outputs.manipulability = manipulability(factor);
    for (int i = 0; i < JOINTS; i++) {
        c->outputs.dq[i] = dq[i];
        c->outputs.qpos_ref[i] = c->inputs.qpos[i] + dq[i];
        c->outputs.ctrl[i] = c->gains.base_ctrl[i] + pid[i];
    }
}
