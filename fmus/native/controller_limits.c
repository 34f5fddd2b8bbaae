/* The robot's joint limits, as bounds of the joint velocities of one period. */
#include <math.h>

#include "controller_parts.h"

const controller_robot CONTROLLER_ROBOTS[ROBOTS] = {
    {
        .q_min = {-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973},
        .q_max = {2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973},
        .qd_max = {2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61},
        .qdd_max = {15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0},
        .qddd_max = {7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0},
        .slow_low = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL},
        .slow_high = {HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL},
        .slow_braking = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0},
        .joint_damping = 1.0,
    },
    {
        .q_min = {-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508},
        .q_max = {2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508},
        .qd_max = {2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26},
        .qdd_max = {10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0},
        .qddd_max = {5000.0, 5000.0, 5000.0, 5000.0, 5000.0, 5000.0, 5000.0},
        .slow_low = {-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196},
        .slow_high = {2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196},
        .slow_braking = {6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0},
        .slow_offset = {0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35},
        .joint_damping = 0.21,
    },
};

const controller_common CONTROLLER_COMMON = {
    .opening_max = 0.08,
    .ctrl_open = 255.0,
    .servo_damping = {450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0},
    .speed_left = 1e-3,
    .torque_max = {87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0},
    .torque_rate_max = 1000.0,
};

static const double POSITION = 1.0, VELOCITY = 2.0, ACCELERATION = 3.0, JERK = 4.0;
static const double MIN_WIDTH = 1e-9;
static const double BRAKING = 0.95;
static const double ROUNDING = 1e-9;
static const double RETURN_RATE = 20.0;
static const double END_MARGIN = 0.001; /* rad */
static const double APPROACH_RATE = 5.0; /* 1/s */
static const double END_ZONE = 0.8;  /* rad */
static const double END_SPEED = 2.0; /* rad/s */
static const double END_PULL[JOINTS] = {60.0, 60.0, 60.0, 0.0, 60.0, 60.0, 60.0}; /* 1/(rad s) */

static double lowest(const controller_robot *robot, int joint) { return robot->q_min[joint] + END_MARGIN; }
static double highest(const controller_robot *robot, int joint) { return robot->q_max[joint] - END_MARGIN; }

/* Speed at which a joint is pulled away from an end at this distance. */
static double pull(int joint, double room)
{
    const double inside = larger(END_ZONE - room, 0.0);
    return smaller(END_PULL[joint] * inside * inside, END_SPEED);
}

/* Velocity that leads a joint away from the ends of its range. */
double pull_from_ends(const controller_robot *robot, int joint, double q_ref)
{
    return pull(joint, q_ref - lowest(robot, joint)) - pull(joint, highest(robot, joint) - q_ref);
}

void limits_of(const controller_gains *gains, double period, joint_limits *limits)
{
    const controller_robot *robot = robot_of(gains);
    const double share = gains->limit_share;
    limits->robot = robot;
    limits->share = share;
    limits->lead = gains->reference_lead;
    limits->period = period;
    for (int i = 0; i < JOINTS; i++) {
        const double speed = share * robot->qd_max[i], change = share * robot->qdd_max[i] * period;
        const double onset = period + robot->qdd_max[i] / robot->qddd_max[i];
        limits->speed[i] = speed;
        limits->change[i] = change;
        limits->step[i] = share * robot->qddd_max[i] * period * period;
        limits->twice_braking[i] = 2.0 * BRAKING * share * robot->qdd_max[i];
        limits->half_change[i] = 0.5 * BRAKING * share * robot->qdd_max[i] * onset;
        const double slow = robot->qd_max[i] + robot->slow_offset[i];
        const double slow_room =
            slow * slow / (2.0 * robot->slow_braking[i]) + (highest(robot, i) - robot->slow_high[i]);
        limits->stop[i] =
            larger(speed * speed / limits->twice_braking[i] + speed * onset, speed / APPROACH_RATE);
        limits->stop[i] = larger(limits->stop[i], slow_room);
        limits->slack[i] = change * change / limits->step[i];
    }
}

/* Change of speed in the last period, clamped to the acceleration limit. */
static double change_before(const joint_limits *limits, int joint, const joint_course *course)
{
    const double change = limits->change[joint];
    return clamp(limits->period * course->qdd_before[joint], -change, change);
}

/* Lowest and highest change of speed that acceleration and jerk allow. */
static void allowed_changes(const joint_limits *limits, int joint, const joint_course *course, double *least,
                            double *most)
{
    const double before = change_before(limits, joint, course);
    *least = larger(before - limits->step[joint], -limits->change[joint]);
    *most = smaller(before + limits->step[joint], limits->change[joint]);
}

bool limits_inactive(const joint_limits *limits, const double *qd, const joint_course *course)
{
    const controller_robot *robot = limits->robot;
    for (int i = 0; i < JOINTS; i++) {
        const double middle = 0.5 * (robot->q_min[i] + robot->q_max[i]);
        const double room = 0.5 * (highest(robot, i) - lowest(robot, i)) - limits->stop[i];
        const double change = qd[i] - course->qd_before[i], turn = change - limits->period * course->qdd_before[i];
        if (!(fabs(qd[i]) < limits->speed[i] - limits->slack[i] && fabs(change) < limits->change[i] &&
              fabs(turn) < limits->step[i] && fabs(course->lag[i]) < limits->lead &&
              fabs(course->q_ref[i] - middle) < room))
            return false;
    }
    return true;
}

/* Largest speed at a distance before the end of the robot's velocity limit. */
static double speed_limit(const controller_robot *robot, int joint, double room)
{
    const double speed = sqrt(2.0 * robot->slow_braking[joint] * larger(room, 0.0)) - robot->slow_offset[joint];
    return clamp(speed, CONTROLLER_COMMON.speed_left, robot->qd_max[joint]);
}

/* Highest speed v at which the joint approaches its upper end, if `up`, or its lower one, and can stop in time:
 * braking takes v^2 / (2 a) + v (T + a / j) / 2. */
static double stoppable(const joint_limits *limits, int joint, double q_ref, bool up)
{
    const controller_robot *robot = limits->robot;
    const double room = larger(up ? highest(robot, joint) - q_ref : q_ref - lowest(robot, joint), 0.0);
    const double until = up ? robot->slow_high[joint] - q_ref : q_ref - robot->slow_low[joint];
    const double half = limits->half_change[joint];
    const double speed = sqrt(limits->twice_braking[joint] * room + half * half) - half;
    return smaller(smaller(speed, APPROACH_RATE * room), limits->share * speed_limit(robot, joint, until));
}

/* Largest change of speed that can be reduced to 0, step by step, within a given speed margin. */
static double reachable(const joint_limits *limits, int joint, double room)
{
    const double step = limits->step[joint];
    const double count = floor(0.5 * (sqrt(1.0 + 8.0 * larger(room, 0.0) / step) - 1.0));
    return (room + 0.5 * step * count * (count + 1.0)) / (count + 1.0);
}

void velocity_box(const joint_limits *limits, const joint_course *course, double low[JOINTS],
                  double high[JOINTS])
{
    for (int i = 0; i < JOINTS; i++) {
        const double q_ref = course->q_ref[i], before = course->qd_before[i], lag = course->lag[i];
        double slowest = -stoppable(limits, i, q_ref, false);
        double fastest = stoppable(limits, i, q_ref, true);
        const double excess = fabs(lag) - limits->lead, back = RETURN_RATE * excess;
        if (excess > 0.0 && lag < 0.0) slowest = smaller(back, fastest);
        if (excess > 0.0 && lag > 0.0) fastest = larger(-back, slowest);
        slowest = before - reachable(limits, i, before - slowest);
        fastest = before + reachable(limits, i, fastest - before);
        if (lag < 0.0) slowest = smaller(slowest, fastest);
        if (lag > 0.0) fastest = larger(fastest, slowest);
        double least, most;
        allowed_changes(limits, i, course, &least, &most);
        low[i] = clamp(slowest, before + least, before + most);
        high[i] = larger(clamp(fastest, before + least, before + most), low[i] + MIN_WIDTH);
    }
}

bool within(const double *qd, const double *low, const double *high)
{
    for (int i = 0; i < JOINTS; i++)
        if (!(low[i] <= qd[i] && qd[i] <= high[i])) return false;
    return true;
}

double binding_limit(const joint_limits *limits, int joint, double qd, const joint_course *course, double low,
                     double high)
{
    const double before = course->qd_before[joint], q_ref = course->q_ref[joint];
    double least, most;
    if (!(qd <= low || qd >= high)) return 0.0;
    allowed_changes(limits, joint, course, &least, &most);
    if (qd <= before + least || qd >= before + most)
        return fabs(qd - before) >= (1.0 - ROUNDING) * limits->change[joint] ? ACCELERATION : JERK;
    const double free_speed =
        smaller(stoppable(limits, joint, q_ref, false), stoppable(limits, joint, q_ref, true));
    return free_speed >= limits->speed[joint] && fabs(course->lag[joint]) <= limits->lead ? VELOCITY : POSITION;
}
