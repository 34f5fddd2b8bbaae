/* Differential inverse kinematics: pose error, damped least squares, singularities. */
#include <math.h>
#include <string.h>

#include "controller_parts.h"

static const double QP_SCALE = 1e6;
static const double FLAT_GRADIENT = 1e-6 * 1e6;
static const double MIN_DAMPING = 1e-5;
static const double MIN_PIVOT = 1e-20;
static const double START_DIRECTION[TWIST] = {1.0, 2.0, 3.0, 4.0, 5.0, 6.0};
static const double LENGTH = 0.1034;      /* m/rad, see controller/ik.py */
static const double OFF_PATH = 0.018;     /* m */
static const double LEAST_ERROR = 0.001;  /* m */
static const double LEAST_SPEED = 0.001;  /* m/s */
enum { START_ITERATIONS = 50, SCALED = JOINTS + 1 };

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

/* Whether the gradient vanishes along each unknown that is inside its bounds. */
static bool is_minimum(const controller_functions *mj, const double *hessian, const double *gradient,
                       const double *low, const double *high, const double *z)
{
    double slope[SCALED];
    mj->mju_mulMatVec(slope, hessian, z, SCALED, SCALED);
    for (int i = 0; i < SCALED; i++)
        if (z[i] > low[i] && z[i] < high[i] && !(fabs(slope[i] + gradient[i]) <= FLAT_GRADIENT)) return false;
    return true;
}

static bool is_finite(const double *z)
{
    for (int i = 0; i < SCALED; i++)
        if (!isfinite(z[i])) return false;
    return true;
}

/* False at extreme speeds, where rounding exceeds the box's width; mju_boxQP would then end the process. */
static bool is_box(const double *low, const double *high)
{
    for (int i = 0; i < SCALED; i++)
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

/* Length of a twist, in metres. */
static double length_of(const controller_functions *mj, const double twist[TWIST])
{
    double weighted[TWIST];
    for (int i = 0; i < TWIST; i++) weighted[i] = (i < 3 ? 1.0 : LENGTH) * twist[i];
    return mj->mju_normalize(weighted, TWIST);
}

/* In place: joint velocities within a box that move the hand along its path, or slower. */
void scaled_least_squares(const controller_functions *mj, const double *jac, const double *error,
                          double damping, double singular, const double low[JOINTS],
                          const double high[JOINTS], double qd[JOINTS])
{
    double twist[TWIST];
    mj->mju_mulMatVec(twist, jac, qd, TWIST, JOINTS);
    double task[TWIST * SCALED], hessian[SCALED * SCALED], gradient[SCALED], factor[SCALED * (SCALED + 7)];
    double from[SCALED], to[SCALED], middle[SCALED], z[SCALED];
    const double off = length_of(mj, error), ratio = OFF_PATH / larger(off, LEAST_ERROR);
    const double far_off = singular * smaller(off / OFF_PATH, 1.0);
    const double at_least = larger(sqrt(damping * damping + far_off * far_off), MIN_DAMPING);
    const double price = larger(length_of(mj, twist), LEAST_SPEED) * ratio * ratio;
    const double *const starts[3] = {middle, from, to};
    int index[SCALED], unbound = -1;
    for (int row = 0; row < TWIST; row++) {
        const double weight = row < 3 ? 1.0 : LENGTH;
        for (int i = 0; i < JOINTS; i++) task[SCALED * row + i] = weight * jac[JOINTS * row + i];
        task[SCALED * row + JOINTS] = -weight * twist[row];
    }
    mj->mju_mulMatTMat(hessian, task, task, TWIST, SCALED, SCALED);
    for (int i = 0; i < SCALED; i++) {
        const double square = i < JOINTS ? at_least * at_least : price * price;
        hessian[(SCALED + 1) * i] += square;
        gradient[i] = -QP_SCALE * (square * (i < JOINTS ? qd[i] : 1.0));
        from[i] = i < JOINTS ? low[i] : 0.0;
        to[i] = i < JOINTS ? high[i] : 1.0;
        middle[i] = 0.5 * (from[i] + to[i]);
    }
    for (int i = 0; i < SCALED * SCALED; i++) hessian[i] *= QP_SCALE;
    for (int i = 0; i < 3 && is_box(from, to); i++) {
        memcpy(z, starts[i], sizeof z);
        unbound = mj->mju_boxQP(z, factor, index, hessian, gradient, SCALED, from, to);
        memcpy(qd, z, JOINTS * sizeof *z);
        if (!is_finite(z)) unbound = -1; /* a failure that MuJoCo 3 does not tell */
        if (unbound >= 0 && is_minimum(mj, hessian, gradient, from, to, z)) return;
    }
    if (unbound >= 0) return;
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
