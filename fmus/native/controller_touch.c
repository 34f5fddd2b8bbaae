/* External torques, thresholds on them, and the reaction: controller/touch.py. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

static const double FREE = 0.0, CONTACT = 1.0, COLLISION = 2.0; /* states of a joint */
static const double NONE = 1.0, YIELD = 3.0;                    /* reactions */
static const double PHYSICS_STEP = 0.001;                       /* [s] */

static void begin(controller *c)
{
    controller_outputs *y = &c->outputs;
    c->state.touch.observes = 1.0;
    memcpy(c->state.touch.qd_before, c->inputs.qvel, sizeof c->inputs.qvel);
    memset(y->external_torque, 0, sizeof y->external_torque);
    memset(y->external_force, 0, sizeof y->external_force);
    memset(y->joint_contact, 0, sizeof y->joint_contact);
}

/* State of a joint; a collision stays. */
static double contact_of(const controller *c, int joint)
{
    const double size = fabs(c->outputs.external_torque[joint]);
    if (c->outputs.joint_contact[joint] == COLLISION || size > c->gains.upper_torque_threshold[joint])
        return COLLISION;
    return size > c->gains.lower_torque_threshold[joint] ? CONTACT : FREE;
}

static void observe(controller *c, const controller_mujoco *mujoco)
{
    const controller_functions *mj = &mujoco->call;
    const controller_inputs *x = &c->inputs;
    controller_outputs *y = &c->outputs;
    const controller_robot *robot = robot_of(&c->gains);
    double *qd_before = c->state.touch.qd_before;
    double qdd[JOINTS], inertia[JOINTS], factor[TWIST * TWIST], force[TWIST];
    const double gain = c->gains.observer_gain * c->period, share = gain / (1.0 + gain);
    for (int i = 0; i < JOINTS; i++) {
        qdd[i] = (x->qvel[i] - qd_before[i]) / c->period;
        qd_before[i] = x->qvel[i];
    }
    inertia_force(mujoco, x->qpos, qdd, inertia);
    for (int i = 0; i < JOINTS; i++) {
        const double damping = c->gains.impedance != 0.0 ? 0.0 : CONTROLLER_COMMON.servo_damping[i];
        const double rotor = damping * PHYSICS_STEP;
        const double torque =
            x->actuator_force[i] - rotor * qdd[i] - robot->joint_damping * x->qvel[i];
        y->external_torque[i] += share * (inertia[i] + x->qfrc_bias[i] - torque - y->external_torque[i]);
        y->joint_contact[i] = contact_of(c, i);
    }
    damped_factor(mj, x->jac, 0.0, factor);
    mj->mju_mulMatVec(force, x->jac, y->external_torque, TWIST, JOINTS);
    mj->mju_cholSolve(y->external_force, factor, force, TWIST);
}

/* Holds the joints, or lets them give way; the servos' damping brakes them. */
static void react(controller *c)
{
    const controller_inputs *x = &c->inputs;
    controller_outputs *y = &c->outputs;
    double *q_stop = c->state.touch.q_stop;
    if (c->state.touch.reacts == 0.0 || c->gains.reaction == YIELD) memcpy(q_stop, x->qpos, sizeof x->qpos);
    c->state.touch.reacts = 1.0;
    for (int i = 0; i < JOINTS; i++) {
        const double ctrl = q_stop[i] + x->qfrc_bias[i] / c->gains.servo_stiffness[i];
        y->qpos_ref[i] = q_stop[i];
        y->dq[i] = q_stop[i] - x->qpos[i];
        y->qvel_ref[i] = y->limit[i] = 0.0;
        y->ctrl[i] = clamp(ctrl, robot_of(&c->gains)->q_min[i], robot_of(&c->gains)->q_max[i]);
    }
}

bool touch_takes_over(controller *c, const controller_mujoco *mujoco)
{
    const bool reacts = c->gains.reaction != NONE && c->gains.impedance == 0.0; /* they move servos */
    bool collided = false;
    if (!reacts && c->gains.observer == 0.0) {
        c->state.touch.observes = 0.0;
        return false;
    }
    if (c->state.touch.observes == 0.0) begin(c);
    else observe(c, mujoco);
    for (int i = 0; i < JOINTS; i++) collided |= c->outputs.joint_contact[i] == COLLISION;
    if (reacts && collided) react(c);
    return reacts && collided;
}
