/* The robot's joint limits, as bounds of the joint velocities of one period. */
#include <math.h>

#include "controller_parts.h"

const controller_robot CONTROLLER_ROBOT = {
    .q_min = {-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973},
    .q_max = {2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973},
    .qd_max = {2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61},
    .qdd_max = {15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0},
    .opening_max = 0.08,
    .ctrl_open = 255.0,
};

static const double POSITION = 1.0, VELOCITY = 2.0, ACCELERATION = 3.0;
static const double MIN_WIDTH = 1e-9;
static const double RETURN_RATE = 20.0;
static const double END_MARGIN = 0.001; /* rad */

static double lowest(int joint) { return CONTROLLER_ROBOT.q_min[joint] + END_MARGIN; }
static double highest(int joint) { return CONTROLLER_ROBOT.q_max[joint] - END_MARGIN; }

void limits_of(const controller_gains *gains, double period, joint_limits *limits)
{
    const controller_robot *robot = &CONTROLLER_ROBOT;
    limits->lead = gains->reference_lead;
    for (int i = 0; i < JOINTS; i++) {
        const double speed = gains->limit_share * robot->qd_max[i];
        limits->speed[i] = speed;
        limits->change[i] = gains->limit_share * robot->qdd_max[i] * period;
        limits->twice_braking[i] = 2.0 * gains->limit_share * robot->qdd_max[i];
        limits->half_change[i] = 0.5 * limits->change[i];
        limits->stop[i] = speed * speed / limits->twice_braking[i] + speed * period;
    }
}

bool limits_inactive(const joint_limits *limits, const double *qd, const double *q_ref,
                     const double *qd_before, const double *lag)
{
    const controller_robot *robot = &CONTROLLER_ROBOT;
    for (int i = 0; i < JOINTS; i++) {
        const double middle = 0.5 * (robot->q_min[i] + robot->q_max[i]);
        const double room = 0.5 * (highest(i) - lowest(i)) - limits->stop[i];
        if (!(fabs(qd[i]) < limits->speed[i] && fabs(qd[i] - qd_before[i]) < limits->change[i] &&
              fabs(lag[i]) < limits->lead && fabs(q_ref[i] - middle) < room))
            return false;
    }
    return true;
}

/* Highest speed that can be braked within the room that is left: braking from v in steps takes
 * v^2 / (2 a) + v T / 2. */
static double stoppable(const joint_limits *limits, int joint, double room)
{
    const double half = limits->half_change[joint];
    const double speed = sqrt(limits->twice_braking[joint] * larger(room, 0.0) + half * half) - half;
    return smaller(speed, limits->speed[joint]);
}

void velocity_box(const joint_limits *limits, const double *q_ref, const double *qd_before, const double *lag,
                  double low[JOINTS], double high[JOINTS])
{
    for (int i = 0; i < JOINTS; i++) {
        double slowest = -stoppable(limits, i, q_ref[i] - lowest(i));
        double fastest = stoppable(limits, i, highest(i) - q_ref[i]);
        const double excess = fabs(lag[i]) - limits->lead, back = RETURN_RATE * excess;
        if (excess > 0.0 && lag[i] < 0.0) slowest = smaller(back, fastest);
        if (excess > 0.0 && lag[i] > 0.0) fastest = larger(-back, slowest);
        const double least = qd_before[i] - limits->change[i], most = qd_before[i] + limits->change[i];
        low[i] = clamp(slowest, least, most);
        high[i] = larger(clamp(fastest, least, most), low[i] + MIN_WIDTH);
    }
}

bool within(const double *qd, const double *low, const double *high)
{
    for (int i = 0; i < JOINTS; i++)
        if (!(low[i] <= qd[i] && qd[i] <= high[i])) return false;
    return true;
}

double binding_limit(const joint_limits *limits, int joint, double qd, double qd_before, double low,
                     double high)
{
    const double change = limits->change[joint];
    if (!(qd <= low || qd >= high)) return 0.0;
    if (qd <= qd_before - change || qd >= qd_before + change) return ACCELERATION;
    return fabs(qd) >= limits->speed[joint] ? VELOCITY : POSITION;
}
