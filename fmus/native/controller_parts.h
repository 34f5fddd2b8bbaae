/* The parts of the control law, see controller_law.h. */
#ifndef CONTROLLER_PARTS_H
#define CONTROLLER_PARTS_H

#include <stdbool.h>

#include "controller_law.h"

static inline double smaller(double a, double b) { return b < a ? b : a; }
static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double clamp(double x, double low, double high) { return smaller(larger(x, low), high); }

static inline const controller_robot *robot_of(const controller_gains *gains)
{
    return &CONTROLLER_ROBOTS[(int)gains->robot - 1];
}

/* controller_ik.c: controller/ik.py, linalg.py */
void pose_error(const controller_functions *mj, const double cmd[POSE], const controller_inputs *in,
                double error[TWIST]);
void correcting_twist(const controller_functions *mj, const double error[TWIST], const controller_gains *gains,
                      double twist[TWIST]);
void damped_factor(const controller_functions *mj, const double *jac, double damping,
                   double factor[TWIST * TWIST]);
void damped_least_squares(const controller_functions *mj, const double *jac, const double *factor,
                          const double *twist, const double *drift, double qd[JOINTS]);
void keep_null_space_part(const controller_functions *mj, const double *jac, double damping,
                          double drift[JOINTS]);
void scaled_least_squares(const controller_functions *mj, const double *jac, const double *error,
                          double damping, double singular, const double low[JOINTS],
                          const double high[JOINTS], double qd[JOINTS]);
double manipulability(const double *factor);
double smallest_singular_value(const controller_functions *mj, const double *factor,
                               double weak_direction[TWIST]);
void find_weak_direction(const controller_functions *mj, const double *jac, double direction[TWIST]);
double singular_damping(double smallest, const controller_gains *gains);

/* controller_limits.c: controller/limits.py */
typedef struct {
    const controller_robot *robot;
    double share, lead, period, speed[JOINTS], change[JOINTS], step[JOINTS], twice_braking[JOINTS];
    double half_change[JOINTS], stop[JOINTS], slack[JOINTS];
} joint_limits;

/* Joint reference, its velocity and acceleration in the last period, and its lead over the joints. */
typedef struct {
    const double *q_ref, *qd_before, *qdd_before, *lag;
} joint_course;

double pull_from_ends(const controller_robot *robot, int joint, double q_ref);
void limits_of(const controller_gains *gains, double period, joint_limits *limits);
bool limits_inactive(const joint_limits *limits, const double *qd, const joint_course *course);
void velocity_box(const joint_limits *limits, const joint_course *course, double low[JOINTS],
                  double high[JOINTS]);
bool within(const double *qd, const double *low, const double *high);
double binding_limit(const joint_limits *limits, int joint, double qd, const joint_course *course, double low,
                     double high);

/* controller_pid.c: controller/pid.py */
void pid_reset(controller_pid_state *pid);
void pid_update(controller_pid_state *pid, const controller_gains *gains, double period,
                const double error[JOINTS], double correction[JOINTS]);

/* controller_law.c: controller/reference_law.py, tutorial_law.py, signals.py */
void reset_late(double rows[KEPT][JOINTS], const double now[JOINTS]);
void get_pose_cmd(const controller_inputs *in, double pose[POSE]);
void get_twist_cmd(const controller_inputs *in, double twist[TWIST]);
void late_pose_error(controller *c, const controller_functions *mj, double poses[KEPT][POSE],
                     double error[TWIST]);
void inertia_force(const controller_mujoco *mj, const double *q, const double *qdd, double force[JOINTS]);

void start_reference_law(controller *c, const controller_mujoco *mujoco);
void update_reference_law(controller *c, const controller_mujoco *mujoco);
void start_tutorial_law(controller *c, const controller_mujoco *mujoco);
void update_tutorial_law(controller *c, const controller_mujoco *mujoco);

/* controller_impedance.c: controller/impedance.py */
void start_impedance_law(controller *c, const controller_mujoco *mj);
void update_impedance_law(controller *c, const controller_mujoco *mj);

/* controller_touch.c: controller/touch.py */
bool touch_takes_over(controller *c, const controller_mujoco *mujoco);

#endif
