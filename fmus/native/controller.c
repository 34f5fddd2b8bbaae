/* The controller: chooses a law, and moves the gripper. See controller/controller.py. */
#include <string.h>

#include "controller_parts.h"

enum { REFERENCE_LAW = 1, TUTORIAL_LAW, IMPEDANCE_LAW }; /* as in controller_state.law */

static const struct {
    void (*start)(controller *c, const controller_mujoco *mj);
    void (*update)(controller *c, const controller_mujoco *mj);
} LAWS[] = {
    [REFERENCE_LAW] = {start_reference_law, update_reference_law},
    [TUTORIAL_LAW] = {start_tutorial_law, update_tutorial_law},
    [IMPEDANCE_LAW] = {start_impedance_law, update_impedance_law},
};

/* Target opening: the commanded one, or the one that gives the grip force. */
static double grip_cmd(const controller *c)
{
    const controller_gains *gains = &c->gains;
    double wanted = c->inputs.grip_cmd;
    if (gains->grip_force > 0.0 && wanted < gains->grip_width)
        wanted = gains->grip_width - 2.0 * gains->grip_force / gains->grip_stiffness;
    return smaller(larger(wanted, 0.0), CONTROLLER_COMMON.opening_max);
}

/* Moves the gripper's target towards its command at the fingers' speed. */
static void move_gripper(controller *c)
{
    double wanted = grip_cmd(c);
    if (c->gains.finger_speed > 0.0) {
        const double step = 2.0 * c->gains.finger_speed * c->period; /* both fingers move */
        wanted = smaller(larger(wanted, c->state.opening - step), c->state.opening + step);
    }
    c->state.opening = wanted;
    c->outputs.ctrl[JOINTS] = CONTROLLER_COMMON.ctrl_open * (wanted / CONTROLLER_COMMON.opening_max);
}

/* Starts the chosen law, and the gripper if nothing ran before. */
static void start(controller *c, const controller_mujoco *mj, double law)
{
    if (c->state.law == 0.0) c->state.opening = grip_cmd(c);
    c->state.law = law;
    c->state.touch.reacts = 0.0;
    LAWS[(int)law].start(c, mj);
}

void controller_reset(controller *c)
{
    memset(&c->inputs, 0, sizeof c->inputs);
    memset(&c->outputs, 0, sizeof c->outputs);
    memset(&c->state, 0, sizeof c->state);
    memcpy(c->outputs.ctrl, c->gains.base_ctrl, sizeof c->gains.base_ctrl);
    c->outputs.ctrl[JOINTS] = CONTROLLER_COMMON.ctrl_open;
}

static double law_of(const controller_gains *gains)
{
    if (gains->impedance != 0.0) return IMPEDANCE_LAW;
    return gains->use_reference != 0.0 ? REFERENCE_LAW : TUTORIAL_LAW;
}

void controller_update(controller *c, const controller_mujoco *mj)
{
    const double law = law_of(&c->gains);
    if (touch_takes_over(c, mj)) return;
    if (c->state.law != law || c->state.touch.reacts != 0.0) start(c, mj, law);
    move_gripper(c);
    LAWS[(int)law].update(c, mj);
}
