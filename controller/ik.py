"""Differential inverse kinematics: pose error, its correction, and damped least squares."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from .gains import Gains
from .limits import Box, clamp
from .linalg import cholesky_solve, damped_factor, mat_t_vec, mat_vec

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# mju_boxQP stops where the gradient is shorter than 1e-8, which the weak pull in the null space
# always is. So the problem is scaled up.
QP_SCALE = 1e6
FLAT_GRADIENT = 1e-6 * QP_SCALE
MIN_DAMPING = 1e-5  # [1] within a box, so that the solution is unique
# Damping in the null-space projection, as a share of the task's damping. With 1, the hand stops
# millimetres off near singularities. With 0, nothing keeps the stretched arm from folding the
# wrong way.
PULL_DAMPING = 0.05  # [1]


def pose_error(pos_cmd: Vector, quat_cmd: Vector, xpos: Vector, xquat: Vector) -> Vector:
    """Displacement and rotation vector (6,) [m, rad] that bring the hand to its command, world.

    Positions (3,) are in m, orientations (w, x, y, z); the rotation is at most pi long.
    """
    error, in_hand = np.empty(6), np.empty(3)
    error[:3] = pos_cmd - xpos
    mujoco.mju_subQuat(in_hand, quat_cmd, xquat)
    mujoco.mju_rotVecQuat(error[3:], in_hand, xquat)
    return error


def correcting_twist(error: Vector, gains: Gains) -> Vector:
    """Twist ik_gain e (6,) [m/s, rad/s] that drives a pose error e (6,) [m, rad] to zero.

    Its two parts are along the error's, and no faster than they can brake in time.
    """
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
    """Joint velocities qd (7,) [rad/s] that minimise |J qd - v|^2 + damping^2 |qd - drift|^2.

    J (6, 7) is the hand's Jacobian, world axes, linear rows first; `factor` (6, 6) the Cholesky
    factor of J J^T + damping^2; v (6,) the hand's twist [m/s, rad/s]. As the damping goes to 0,
    `drift` (7,) [rad/s] acts in the null space of J alone.
    """
    rest = twist - mat_vec(jac, drift)
    return drift + mat_t_vec(jac, cholesky_solve(factor, rest))


def null_space_part(jac: Matrix, damping: float, drift: Vector) -> Vector:
    """Part of `drift` (7,) [rad/s] that does not move the hand.

    It is (1 - J^T (J J^T + damping^2)^-1 J) drift; without damping, the projection onto the null
    space of J (6, 7).
    """
    return damped_least_squares(jac, damped_factor(jac, damping), np.zeros(len(jac)), drift)


def box_least_squares(
    jac: Matrix, twist: Vector, drift: Vector, damping: float, box: Box
) -> Vector:
    """Damped least squares as above, with the joint velocities (7,) [rad/s] within a box.

    At least `MIN_DAMPING` is used. Where the solver finds no solution: those nearest to 0.
    """
    low, high = box
    damping = max(damping, MIN_DAMPING)
    square = damping * damping
    hessian = np.empty((7, 7))
    mujoco.mju_mulMatTMat(hessian, jac, jac)
    hessian.reshape(-1)[::8] += square
    hessian *= QP_SCALE
    gradient = -QP_SCALE * (mat_t_vec(jac, twist) + square * drift)  # at qd = 0
    free = -1
    # Where many joints reach their bounds at once, the solver may stop early: about two in a
    # thousand random problems. Started from another point in the box, it converges.
    starts = (0.5 * (low + high), low, high) if (low < high).all() else ()
    for start in starts:
        qd: Vector = start.copy()
        factor, index = np.empty((7, 14)), np.empty(7, dtype=np.int32)
        free = mujoco.mju_boxQP(qd, factor, index, hessian, gradient, low, high)
        if not np.isfinite(qd).all():  # a failure that MuJoCo 3 does not tell
            free = -1
        if free >= 0 and _is_minimum(qd, hessian, gradient, box):
            return qd
    if free >= 0:
        return qd
    return clamp(np.zeros(7), low, high)  # braking is always allowed


def _is_minimum(qd: Vector, hessian: Matrix, gradient: Vector, box: Box) -> bool:
    """Whether the gradient vanishes along each joint that is inside its bounds."""
    slope = np.abs(mat_vec(hessian, qd) + gradient)
    inside = (qd > box[0]) & (qd < box[1])
    return bool((slope[inside] <= FLAT_GRADIENT).all())
