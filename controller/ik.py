"""Differential inverse kinematics: pose error, its correction, and damped least squares."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..assets.fields import Matrix, Vector
from .gains import Gains
from .limits import Box, clamp
from .linalg import cholesky_solve, damped_factor, mat_t_vec, mat_vec
from .model import FINGERTIPS

# mju_boxQP stops where the gradient is shorter than 1e-8, which the weak pull in the null space
# always is. So the problem is scaled up.
QP_SCALE = 1e6
FLAT_GRADIENT = 1e-6 * QP_SCALE
MIN_DAMPING = 1e-5  # [1] within a box, so that the solution is unique
# [m/rad] An error of the hand's orientation counts as much as it moves the fingertips, which are
# this far below the hand's origin.
LENGTH = FINGERTIPS[2]
WEIGHTS = np.array([1.0, 1.0, 1.0, LENGTH, LENGTH, LENGTH])
SCALED = 8  # unknowns: joint velocities, and the scale of the hand's
OFF_PATH = 0.018  # [m] pose error at which leaving the path costs as much as stopping
LEAST_ERROR = 0.001  # [m] below which the price does not grow
LEAST_SPEED = 0.001  # [m/s] in the price, for a hand at rest
# Damping in the null-space projection, as a share of the task's damping. With 1, the hand stops
# millimetres off near singularities. With 0, nothing keeps the stretched arm from folding the
# wrong way.
PULL_DAMPING = 0.05  # [1]


def pose_error(pos_cmd: Vector, quat_cmd: Vector, xpos: Vector, xquat: Vector) -> Vector:
    """Displacement and rotation vector (6,) [m, rad] that bring the hand to its command, world."""
    # Positions (3,) are in m, orientations (w, x, y, z); the rotation is at most pi long.
    error, in_hand = np.empty(6), np.empty(3)
    error[:3] = pos_cmd - xpos
    mujoco.mju_subQuat(in_hand, quat_cmd, xquat)
    mujoco.mju_rotVecQuat(error[3:], in_hand, xquat)
    return error


def correcting_twist(error: Vector, gains: Gains) -> Vector:
    """Twist ik_gain e (6,) [m/s, rad/s] that drives a pose error e (6,) [m, rad] to zero."""
    # Its two parts are along the error's, and no faster than they can brake in time.
    twist, rate = gains.ik_gain * error, gains.ik_gain
    _slow_down(twist[:3], error[:3], rate, gains.linear_correction, gains.linear_braking)
    _slow_down(twist[3:], error[3:], rate, gains.angular_correction, gains.angular_braking)
    return twist


def _slow_down(twist: Vector, error: Vector, rate: float, fastest: float, braking: float) -> None:
    """Slow down, in place, the correction of one part (3,) of an error, where it is too fast."""
    length = mujoco.mju_norm3(error)
    speed = rate * length
    allowed = min(fastest, math.sqrt(2.0 * braking * length))
    if speed > allowed:
        twist *= allowed / speed


def damped_least_squares(jac: Matrix, factor: Matrix, twist: Vector, drift: Vector) -> Vector:
    """Joint velocities qd (7,) [rad/s] that minimise |J qd - v|^2 + damping^2 |qd - drift|^2."""
    # J (6, 7) is the hand's Jacobian, world axes, linear rows first; `factor` (6, 6) the Cholesky
    # factor of J J^T + damping^2; v (6,) the hand's twist [m/s, rad/s]. As the damping goes to 0,
    # `drift` (7,) [rad/s] acts in the null space of J alone.
    rest = twist - mat_vec(jac, drift)
    return drift + mat_t_vec(jac, cholesky_solve(factor, rest))


def null_space_part(jac: Matrix, damping: float, drift: Vector) -> Vector:
    """Part of `drift` (7,) [rad/s] that does not move the hand."""
    # It is (1 - J^T (J J^T + damping^2)^-1 J) drift; without damping, the projection onto the null
    # space of J (6, 7).
    return damped_least_squares(jac, damped_factor(jac, damping), np.zeros(len(jac)), drift)


def scaled_least_squares(  # noqa: PLR0913 - the problem as it is
    jac: Matrix, error: Vector, free: Vector, damping: float, singular: float, box: Box
) -> Vector:
    """Joint velocities (7,) [rad/s] within a box that move the hand along its path, or slower.

    With W the weights 1 for metres and `LENGTH` for radians, and v = J free the twist of the joint
    velocities without limits, they minimise over qd and the scale s, 0 <= s <= 1,

        |W (J qd - s v)|^2 + price^2 (1 - s)^2 + damping^2 |qd - free|^2
        price = |W v| (`OFF_PATH` / |W e|)^2

    Where a limit just begins to bind, they still equal `free`, so that the joints do not jerk.

    While the pose error e (6,) [m, rad] is small, the hand keeps its speed, and leaves its path as
    little as it can; the further off it is, the more it slows down instead. The damping's square is
    `damping`^2 plus the square of `singular` (damping near a singularity), which grows with e up to
    its value at `OFF_PATH`: an arm that cannot follow comes to rest. The scale is that of
    F. Flacco, A. De Luca, O. Khatib, "Control of Redundant Robots Under Hard Joint Constraints:
    Saturation in the Null Space", IEEE Transactions on Robotics 31(3), 2015. At least `MIN_DAMPING`
    is used. Where the solver finds no solution: the velocities nearest to 0.
    """
    twist, task = mat_vec(jac, free), np.empty((6, SCALED))
    task[:, :7], task[:, 7] = WEIGHTS[:, None] * jac, -WEIGHTS * twist
    off = mujoco.mju_normalize(WEIGHTS * error)
    ratio = OFF_PATH / max(off, LEAST_ERROR)
    price = max(mujoco.mju_normalize(WEIGHTS * twist), LEAST_SPEED) * ratio * ratio
    singular *= min(off / OFF_PATH, 1.0)
    damping = max(math.sqrt(damping * damping + singular * singular), MIN_DAMPING)
    squares = np.array([damping * damping] * 7 + [price * price])
    hessian = np.empty((SCALED, SCALED))
    mujoco.mju_mulMatTMat(hessian, task, task)
    hessian.reshape(-1)[:: SCALED + 1] += squares
    hessian *= QP_SCALE
    gradient = -QP_SCALE * (squares * np.append(free, 1.0))  # at qd = 0, s = 0
    low, high = np.append(box[0], 0.0), np.append(box[1], 1.0)
    unbound = -1
    # Where many joints reach their bounds at once, the solver may stop early: about two in a
    # thousand random problems. Started from another point in the box, it converges.
    starts = (0.5 * (low + high), low, high) if (low < high).all() else ()
    for start in starts:
        z: Vector = start.copy()
        factor, index = np.empty((SCALED, SCALED + 7)), np.empty(SCALED, dtype=np.int32)
        unbound = mujoco.mju_boxQP(z, factor, index, hessian, gradient, low, high)
        if not np.isfinite(z).all():  # a failure that MuJoCo 3 does not tell
            unbound = -1
        if unbound >= 0 and _is_minimum(z, hessian, gradient, low, high):
            return z[:7]
    if unbound >= 0:
        return z[:7]
    return clamp(np.zeros(7), *box)  # braking is always allowed


def _is_minimum(z: Vector, hessian: Matrix, gradient: Vector, low: Vector, high: Vector) -> bool:
    """Whether the gradient vanishes along each unknown that is inside its bounds."""
    slope = np.abs(mat_vec(hessian, z) + gradient)
    inside = (z > low) & (z < high)
    return bool((slope[inside] <= FLAT_GRADIENT).all())
