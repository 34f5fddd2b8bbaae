"""Differential inverse kinematics of the arm, with and without limits of the joints."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from . import linalg
from .gains import Gains

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# mju_boxQP stops where the gradient is shorter than 1e-8, which the weak pull in the null space
# always is. The problem is solved times this factor.
SCALE = 1e6
SLOPE = 1e-6 * SCALE  # of the problem's value, at most, where it counts as flat
_ALONG_NO_AXIS = np.arange(1.0, 7.0)  # where to look first; an axis could be the wrong direction
LEAST_DAMPING = 1e-5  # [1] within a box, by which there is one solution despite rounding


def rotation_error(
    out: Vector, quat_cmd: Vector, hand_xquat: Vector
) -> tuple[linalg.Call, linalg.Call]:
    """Bind what turns the hand into the command, in the world frame, as two calls.

    Args:
        out: Receives the rotation vector (3,) [rad], of length pi at most.
        quat_cmd: Commanded orientation (w, x, y, z).
        hand_xquat: Measured orientation (w, x, y, z).
    """
    in_hand = np.zeros(3)
    return (
        linalg.turn_between(in_hand, quat_cmd, hand_xquat),
        linalg.rotate(out, in_hand, hand_xquat),
    )


def small_error(gains: Gains) -> float:
    """Number above 0; an error of smaller ones need not be shortened [m, rad]."""
    rate = max(gains.ik_gain, 1e-9)
    speed = min(gains.linear_correction, gains.angular_correction)
    braking = min(gains.linear_braking, gains.angular_braking)
    # Three numbers below 0.57 of a length are shorter than it together.
    return max(0.57 * min(speed / rate, 2.0 * braking / rate**2), 1e-300)


def shorten(error: Vector, gains: Gains) -> Vector:
    """Shorten both parts of a pose error to what the correcting speeds allow.

    Args:
        error: Displacement and rotation vector (6,) [m, rad].
        gains: Rate of correction, its speeds and how soon they can be taken off again.

    Returns:
        The error (6,), as far as it may be acted upon.
    """
    speeds = gains.linear_correction, gains.angular_correction
    brakings = gains.linear_braking, gains.angular_braking
    parts = []
    for part, speed, braking in zip(np.split(error, 2), speeds, brakings, strict=True):
        length = float(np.linalg.norm(part))
        fastest = min(speed, math.sqrt(2.0 * braking * length))
        wanted = gains.ik_gain * length
        parts.append(part * (fastest / wanted) if wanted > fastest else part)
    return np.concatenate(parts)


def pseudo_inverse_step(jac: Matrix, error: Vector) -> Vector:
    """Smallest joint displacement that removes a pose error, to first order.

    Args:
        jac: Hand Jacobian (6, 7), world axes, linear rows first.
        error: Pose error (6,) [m, rad], world frame.

    Returns:
        Joint displacement (7,) [rad].
    """
    step: Vector = np.linalg.pinv(jac) @ error
    return step


class Dexterity:
    """How far the arm is from a singularity.

    Source of the manipulability: T. Yoshikawa, "Manipulability of Robotic Mechanisms", IJRR
    4(2), 1985. The smallest singular value comes from one step of inverse iteration a call, of
    which a slowly changing Jacobian needs no more.

    Args:
        jac: Buffer of the hand Jacobian J (6, 7).
        weakest: Buffer (6,) for the direction in which the hand is hardest to move.

    Attributes:
        factor: Cholesky factor (6, 6) of J J^T, for others to solve with; see `damp`.
    """

    def __init__(self, jac: Matrix, weakest: Vector) -> None:
        self._weakest = weakest
        self.factor = np.zeros((6, 6))
        self._squares = self.factor.reshape(-1)[::7]  # on its diagonal
        self._roots = self._squares.data  # of which they become these
        self._square = linalg.square_of_rows(self.factor, jac)
        self._factorize = linalg.factorize(self.factor, 1e-20)
        iterate = linalg.solve_factorized(weakest, self.factor, weakest)
        self._look = linalg.chain(self._square, self._factorize, iterate)
        self._normalize = linalg.normalize(weakest)

    def begin(self) -> None:
        """Find the weakest direction from nothing."""
        self._weakest[:] = _ALONG_NO_AXIS
        for _ in range(50):
            self.measure()

    def measure(self) -> tuple[float, float]:
        """Measure.

        Returns:
            Manipulability sqrt(det(J J^T)), and the smallest singular value of J.
        """
        self._look()
        inverse_square = self._normalize()
        if not 0.0 < inverse_square < math.inf:  # numbers beyond reason, which shall not stay
            self._weakest[:] = _ALONG_NO_AXIS
            inverse_square = math.inf
        return math.prod(self._roots), 1.0 / math.sqrt(inverse_square)

    def damp(self, damping: float) -> None:
        """Make the factor that of J J^T + damping^2, until `measure` is called again."""
        self._square()
        self._squares += damping * damping
        self._factorize()


class BoxedIk:
    """Damped least squares for joint velocities, at need within a box.

    Minimises |J qd - v|^2 + damping^2 |qd - drift|^2: as the damping goes to 0, `drift` acts in
    the null space of J alone. Damping near singularities: Y. Nakamura and H. Hanafusa, "Inverse
    Kinematic Solutions With Singularity Robustness for Robot Manipulator Control", ASME JDSMC
    108(3), 1986.

    Args:
        jac: Buffer of the hand Jacobian J (6, 7).
        factor: Buffer of the Cholesky factor (6, 6) of J J^T + damping^2.
        twist: Buffer of the hand's velocity v (6,) [m/s, rad/s] in the world frame.
        drift: Buffer of the joint velocities (7,) [rad/s] that are wanted besides.
        motion: Buffer (7,) that receives what the hand needs beyond `drift` [rad/s].

    Attributes:
        solve: Makes `motion`, as if there were no box; the solution is qd = drift + motion.
    """

    def __init__(
        self, jac: Matrix, factor: Matrix, twist: Vector, drift: Vector, motion: Vector
    ) -> None:
        self._jac, self._twist, self._drift = jac, twist, drift
        rest = np.zeros(6)
        self.solve = linalg.chain(
            linalg.multiply(rest, jac, drift),
            linalg.subtract(rest, twist, rest),
            linalg.solve_factorized(rest, factor, rest),
            linalg.multiply_transposed(motion, jac, rest),
        )
        self._factor, self._index = np.zeros((7, 14)), np.zeros(7, dtype=np.int32)

    def solve_within(self, qd: Vector, low: Vector, high: Vector, damping: float) -> None:
        """Solve within a box, of which the solution as if there were none was not within.

        Args:
            qd: That solution (7,) [rad/s]; receives the one within the box.
            low: Lowest joint velocities (7,) [rad/s].
            high: Highest joint velocities (7,) [rad/s].
            damping: Damping [1]; `LEAST_DAMPING` at least is used.
        """
        jac, square = self._jac, max(damping, LEAST_DAMPING) ** 2
        with np.errstate(over="ignore", invalid="ignore"):  # numbers beyond reason: no curvature
            hessian = SCALE * (jac.T @ jac + square * np.eye(7))
            pull = SCALE * (jac.T @ self._twist + square * self._drift)
        free = self._minimise(qd, low, high, hessian, pull)
        # Where many joints come to their limits at once, the solver may stop short: about twice
        # in a thousand random problems. From another corner of the box it finds the way.
        for corner in (low, high):
            if free >= 0 and _is_minimum(qd, low, high, hessian, pull):
                return
            np.copyto(qd, corner)
            free = self._minimise(qd, low, high, hessian, pull)
        if free < 0:  # no curvature: braking is always allowed
            np.clip(0.0, low, high, out=qd)

    def _minimise(
        self, qd: Vector, low: Vector, high: Vector, hessian: Matrix, pull: Vector
    ) -> int:
        """Let MuJoCo solve, from and into qd; return the number of joints that no limit binds."""
        free: int = mujoco.mju_boxQP(qd, self._factor, self._index, hessian, -pull, low, high)
        return free


def _is_minimum(qd: Vector, low: Vector, high: Vector, hessian: Matrix, pull: Vector) -> bool:
    """Tell whether nothing is to be gained by joints within their limits."""
    slope = hessian @ qd - pull
    within = (qd > low) & (qd < high)
    return bool(np.abs(slope[within]).max(initial=0.0) <= SLOPE)
