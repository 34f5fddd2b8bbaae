/* The control law of PandaController in C: the same formulas, in the same order, as in controller/ (Python),
 * which explain them. Matrix products go through MuJoCo's functions there and here, so that both give the
 * same bits. Nothing in here depends on FMI.
 *
 * All poses are those of the hand body's origin in the world frame, quaternions (w, x, y, z), twists linear
 * part first. Units: m, rad, s, N.m.
 */
#ifndef CONTROLLER_LAW_H
#define CONTROLLER_LAW_H

#include <mujoco/mujoco.h>

enum { JOINTS = 7, TWIST = 6, POSE = 7, ARM_DOFS = 9 }; /* ARM_DOFS: joints and fingers */
enum { KEPT = 20 };                                    /* updates, see controller/signals.py */

/* controller/signals.py: INPUTS */
typedef struct {
    double pos_cmd[3], quat_cmd[4], vel_cmd[3], omega_cmd[3], grip_cmd;
    double posture_cmd[JOINTS], posture_vel_cmd[JOINTS];
    double hand_xpos[3], hand_xquat[4], jac[TWIST * JOINTS];
    double qpos[JOINTS], qvel[JOINTS], qfrc_bias[JOINTS];
    double actuator_force[JOINTS + 1], force_cmd[3];
} controller_inputs;

/* controller/signals.py: OUTPUTS */
typedef struct {
    double ctrl[JOINTS + 1], dq[JOINTS], qpos_ref[JOINTS], qvel_ref[JOINTS];
    double manipulability, singular, limit[JOINTS];
    double external_torque[JOINTS], external_force[TWIST], joint_contact[JOINTS];
    double motor_torque[JOINTS];
} controller_outputs;

/* controller/gains.py: Gains, in its order; use_reference and observer are 0 or 1, reaction counts from 1. */
typedef struct {
    double use_reference;
    double kp[JOINTS], ki[JOINTS], kd[JOINTS], derivative_filter, integral_limit[JOINTS], base_ctrl[JOINTS];
    double ik_gain, error_filter, ik_damping, singular_damping, singular_value;
    double linear_correction, linear_braking, angular_correction, angular_braking;
    double posture[JOINTS], posture_gain[JOINTS], servo_lag[JOINTS], servo_stiffness[JOINTS];
    double gravity_feedforward[JOINTS], inertia_feedforward[JOINTS];
    double limit_share, reference_lead, finger_speed;
    double grip_force, grip_width, grip_stiffness;
    double reading_delay, follow_posture, posture_follow_gain; /* follow_posture is 0 or 1 */
    double observer, observer_gain, lower_torque_threshold[JOINTS], upper_torque_threshold[JOINTS], reaction;
    double robot; /* counts from 1 */
    double impedance, stiffness[TWIST], spring_force, spring_torque, damping_ratio; /* impedance is 0 or 1 */
    double offset_rate, offset_limit[TWIST], posture_stiffness, posture_damping;
} controller_gains;

typedef struct {
    double integral[JOINTS], derivative[JOINTS], error_before[JOINTS];
} controller_pid_state;

/* State of the controller: all that the next update depends on besides inputs and gains. Same order as
 * STATE in controller/controller.py; copied as bytes. */
typedef struct {
    double law;     /* 1: reference law, 2: tutorial law, 3: impedance law, 0: none started */
    double opening; /* commanded opening between the fingertips */
    struct {
        double q_ref[JOINTS], qd_before[JOINTS], qdd_before[JOINTS];
        double twist_before[TWIST], weak_direction[TWIST], error[TWIST];
        controller_pid_state pid;
        double poses[KEPT][POSE], q_refs[KEPT][JOINTS];
    } reference;
    struct {
        controller_pid_state pid;
        double poses[KEPT][POSE];
    } tutorial;
    struct {
        double torque_before[JOINTS], twist_before[TWIST], jac_before[TWIST * JOINTS], offset[TWIST];
        double poses[KEPT][POSE];
    } impedance;
    struct {
        double observes, reacts, qd_before[JOINTS], q_stop[JOINTS];
    } touch;
} controller_state;

typedef struct {
    controller_inputs inputs;
    controller_outputs outputs;
    controller_gains gains;
    double period; /* time between two updates */
    controller_state state;
} controller;

/* The functions of libmujoco that the law calls; the caller has opened the library. */
#define CONTROLLER_FUNCTIONS(X)                                                                          \
    X(mju_subQuat) X(mju_rotVecQuat) X(mju_norm3) X(mju_normalize) X(mju_mulMatVec) X(mju_mulMatTVec)    \
    X(mju_mulMatMatT) X(mju_mulMatTMat) X(mju_cholFactor) X(mju_cholSolve) X(mju_boxQP)                  \
    X(mj_kinematics) X(mj_comPos) X(mj_makeM) X(mj_mulM) X(mj_comVel) X(mj_rne) X(mj_factorM) X(mj_solveM)

typedef struct {
#define X(name) __typeof__(&name) name;
    CONTROLLER_FUNCTIONS(X)
#undef X
} controller_functions;

/* MuJoCo, and the robot's arm without load (ARM_DOFS degrees of freedom) for its inertia. */
typedef struct {
    controller_functions call;
    const mjModel *arm;
    mjData *data;
} controller_mujoco;

/* A robot's limits; assets/franka.py has the sources. */
typedef struct {
    double q_min[JOINTS], q_max[JOINTS], qd_max[JOINTS], qdd_max[JOINTS], qddd_max[JOINTS];
    double slow_low[JOINTS], slow_high[JOINTS], slow_braking[JOINTS], slow_offset[JOINTS];
    double joint_damping;
} controller_robot;

enum { ROBOTS = 2 };
extern const controller_robot CONTROLLER_ROBOTS[ROBOTS];

/* What all robots share: the hand and the servos. */
typedef struct {
    double opening_max, ctrl_open, servo_damping[JOINTS], speed_left, torque_max[JOINTS], torque_rate_max;
} controller_common;

extern const controller_common CONTROLLER_COMMON;

/* Sets all but gains and period to 0, the arm's targets to base_ctrl, and opens the gripper. */
void controller_reset(controller *c);

/* Computes the outputs of one period from the inputs. */
void controller_update(controller *c, const controller_mujoco *mj);

#endif
