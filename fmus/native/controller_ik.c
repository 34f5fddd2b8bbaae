/* Differential inverse kinematics: pose error, damped least squares, singularities. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

static const double QP_SCALE = 1e6;
static const double FLAT_GRADIENT = 1e-6 * 1e6;
static const double MIN_DAMPING = 1e-5;
static const double MIN_PIVOT = 1e-20;
static const double START_DIRECTION[TWIST] = {1.0, 2.0, 3.0, 4.0, 5.0, 6.0};
enum { START_ITERATIONS = 50 };

void pose_error(const controller_functions *mj, const double cmd[POSE], const controller_inputs *in,
                double error[TWIST])
{
    double in_hand[3];
    for (int i = 0; i < 3; i++) error[i] = cmd[i] - in->hand_xpos[i];
    mj->mju_subQuat(in_hand, cmd + 3, in->hand_xquat);
    mj->mju_rotVecQuat(error + 3, in_hand, in->hand_xquat);
}

/* Factor, at most 1, that slows down the correction of one part of the pose error. */
static double slowdown(const controller_functions *mj, const double error[3], double rate, double fastest,
                       double braking)
{
    const double length = mj->mju_norm3(error), speed = rate * length;
    const double allowed = smaller(fastest, sqrt(2.0 * braking * length));
    return speed > allowed ? allowed / speed : 1.0;
}

void correcting_twist(const controller_functions *mj, const double error[TWIST], const controller_gains *gains,
                      double twist[TWIST])
{
    const double linear =
        slowdown(mj, error, gains->ik_gain, gains->linear_correction, gains->linear_braking);
    const double angular =
        slowdown(mj, error + 3, gains->ik_gain, gains->angular_correction, gains->angular_braking);
    for (int i = 0; i < TWIST; i++) {
        twist[i] = gains->ik_gain * error[i];
        twist[i] *= i < 3 ? linear : angular;
    }
}

void damped_factor(const controller_functions *mj, const double *jac, double damping,
                   double factor[TWIST * TWIST])
{
    mj->mju_mulMatMatT(factor, jac, jac, TWIST, JOINTS, TWIST);
    for (int i = 0; i < TWIST; i++) factor[(TWIST + 1) * i] += damping * damping;
    mj->mju_cholFactor(factor, TWIST, MIN_PIVOT);
}

void damped_least_squares(const controller_functions *mj, const double *jac, const double *factor,
                          const double *twist, const double *drift, double qd[JOINTS])
{
    double rest[TWIST], solution[TWIST];
    mj->mju_mulMatVec(rest, jac, drift, TWIST, JOINTS);
    for (int i = 0; i < TWIST; i++) rest[i] = twist[i] - rest[i];
    mj->mju_cholSolve(solution, factor, rest, TWIST);
    mj->mju_mulMatTVec(qd, jac, solution, TWIST, JOINTS);
    for (int i = 0; i < JOINTS; i++) qd[i] = drift[i] + qd[i];
}

/* Whether the gradient vanishes along each joint that is inside its bounds. */
static bool is_minimum(const controller_functions *mj, const double *hessian, const double *gradient,
                       const double *low, const double *high, const double *qd)
{
    double slope[JOINTS];
    mj->mju_mulMatVec(slope, hessian, qd, JOINTS, JOINTS);
    for (int i = 0; i < JOINTS; i++)
        if (qd[i] > low[i] && qd[i] < high[i] && !(fabs(slope[i] + gradient[i]) <= FLAT_GRADIENT)) return false;
    return true;
}

static bool is_finite(const double *qd)
{
    for (int i = 0; i < JOINTS; i++)
        if (!isfinite(qd[i])) return false;
    return true;
}

/* False at extreme speeds, where rounding exceeds the box's width; mju_boxQP would then end the process. */
static bool is_box(const double *low, const double *high)
{
    for (int i = 0; i < JOINTS; i++)
        if (!(low[i] < high[i])) return false;
    return true;
}

/* In place: drift <- (1 - J^T (J J^T + damping^2)^-1 J) drift. */
void keep_null_space_part(const controller_functions *mj, const double *jac, double damping,
                          double drift[JOINTS])
{
    static const double AT_REST[TWIST] = {0};
    double factor[TWIST * TWIST], part[JOINTS];
    damped_factor(mj, jac, damping, factor);
    damped_least_squares(mj, jac, factor, AT_REST, drift, part);
    memcpy(drift, part, sizeof part);
}

void box_least_squares(const controller_functions *mj, const double *jac, const double *twist,
                       const double *drift, double damping, const double low[JOINTS],
                       const double high[JOINTS], double qd[JOINTS])
{
    double hessian[JOINTS * JOINTS], gradient[JOINTS], factor[JOINTS * (JOINTS + 7)], middle[JOINTS];
    const double at_least = larger(damping, MIN_DAMPING), square = at_least * at_least;
    const double *const starts[3] = {middle, low, high};
    int index[JOINTS], free_joints = -1;
    mj->mju_mulMatTMat(hessian, jac, jac, TWIST, JOINTS, JOINTS);
    for (int i = 0; i < JOINTS; i++) hessian[(JOINTS + 1) * i] += square;
    for (int i = 0; i < JOINTS * JOINTS; i++) hessian[i] *= QP_SCALE;
    mj->mju_mulMatTVec(gradient, jac, twist, TWIST, JOINTS);
    for (int i = 0; i < JOINTS; i++) {
        gradient[i] = -QP_SCALE * (gradient[i] + square * drift[i]);
        middle[i] = 0.5 * (low[i] + high[i]);
    }
    for (int i = 0; i < 3 && is_box(low, high); i++) {
        memcpy(qd, starts[i], sizeof middle);
        free_joints = mj->mju_boxQP(qd, factor, index, hessian, gradient, JOINTS, low, high);
        if (!is_finite(qd)) free_joints = -1; /* a failure that MuJoCo 3 does not tell */
        if (free_joints >= 0 && is_minimum(mj, hessian, gradient, low, high, qd)) return;
    }
    if (free_joints >= 0) return;
    for (int i = 0; i < JOINTS; i++) qd[i] = clamp(0.0, low[i], high[i]); /* braking is always permitted */
}

double manipulability(const double *factor)
{
    double product = 1.0;
    for (int i = 0; i < TWIST; i++) product *= factor[(TWIST + 1) * i];
    return product;
}

double smallest_singular_value(const controller_functions *mj, const double *factor,
                               double weak_direction[TWIST])
{
    double solution[TWIST];
    mj->mju_cholSolve(solution, factor, weak_direction, TWIST);
    const double inverse_square = mj->mju_normalize(solution, TWIST);
    const bool is_sound = inverse_square > 0.0 && inverse_square < HUGE_VAL;
    memcpy(weak_direction, is_sound ? solution : START_DIRECTION, sizeof solution);
    return is_sound ? 1.0 / sqrt(inverse_square) : 0.0;
}

void find_weak_direction(const controller_functions *mj, const double *jac, double direction[TWIST])
{
    double factor[TWIST * TWIST];
    damped_factor(mj, jac, 0.0, factor);
    memcpy(direction, START_DIRECTION, sizeof START_DIRECTION);
    for (int i = 0; i < START_ITERATIONS; i++) smallest_singular_value(mj, factor, direction);
}

double singular_damping(double smallest, const controller_gains *gains)
{
    if (smallest >= gains->singular_value) return 0.0;
    const double ratio = smallest / gains->singular_value;
    return gains->singular_damping * sqrt(1.0 - ratio * ratio);
}
