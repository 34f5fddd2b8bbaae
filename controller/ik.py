"""Differential inverse kinematics of the arm, with and without limits of the joints."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from controller import linalg
from controller.gains import Gains

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# mju_boxQP stops where the gradient is shorter than 1e-8, which the weak pull in the null space
# always is. The problem is solved times this factor.
SCALE = 1e6
SLOPE = 1e-6 * SCALE  # of the problem's value, at most, where it counts as flat
_ALONG_NO_AXIS = np.arange(1.0, 7.0)  # where to look first; an axis could be the wrong direction
LEAST_DAMPING = 1e-5  # [1] of the least squares, by which they have one solution despite rounding


class PoseError:
    """What turns and moves the hand into the command, in the world frame.

    Args:
        pos_cmd: Commanded position (3,) [m].
        quat_cmd: Commanded orientation (w, x, y, z).
        hand_xpos: Measured position (3,) [m].
        hand_xquat: Measured orientation (w, x, y, z).
        out: Receives displacement and rotation vector (6,) [m, rad], the latter of length pi
            at most.

    Attributes:
        update: Compares the poses.
    """

    def __init__(
        self, pos_cmd: Vector, quat_cmd: Vector, hand_xpos: Vector, hand_xquat: Vector, out: Vector
    ) -> None:
        self.position, self.rotation = out[:3], out[3:]
        in_hand = np.zeros(3)
        self.update = linalg.chain(
            linalg.subtract(self.position, pos_cmd, hand_xpos),
            linalg.turn_between(in_hand, quat_cmd, hand_xquat),
            linalg.rotate(self.rotation, in_hand, hand_xquat),
        )
        self._far, self._turned = linalg.norm(self.position), linalg.norm(self.rotation)
        self._both = linalg.norm(out)
        self._short = 0.0

    def tune(self, gains: Gains) -> None:
        """Take over the rate, and the speeds and accelerations that it may lead to."""
        self._gains, rate = gains, max(gains.ik_gain, 1e-9)
        speed = min(gains.linear_correction, gains.angular_correction)
        braking = min(gains.linear_braking, gains.angular_braking)
        # What is shorter than that need not be shortened.
        self._short = min(speed / rate, 2.0 * braking / rate**2)

    def shorten(self) -> None:
        """Shorten both parts to what the correcting speeds allow."""
        if self._both() < self._short:
            return
        gains, rate = self._gains, self._gains.ik_gain
        far, turned = self._far(), self._turned()
        fastest = min(gains.linear_correction, math.sqrt(2.0 * gains.linear_braking * far))
        if rate * far > fastest:
            self.position *= fastest / (rate * far)
        fastest = min(gains.angular_correction, math.sqrt(2.0 * gains.angular_braking * turned))
        if rate * turned > fastest:
            self.rotation *= fastest / (rate * turned)


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
    """

    def __init__(self, jac: Matrix, weakest: Vector) -> None:
        self._weakest = weakest
        factor = np.zeros((6, 6))
        self._diagonal = factor.diagonal()
        self._square = linalg.square_of_rows(factor, jac)
        self._factorize = linalg.factorize(factor, 1e-20)
        self._iterate = linalg.solve_factorized(weakest, factor, weakest)
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
        self._square()
        self._factorize()
        self._iterate()
        inverse_square = self._normalize()
        if not 0.0 < inverse_square < math.inf:  # numbers beyond reason, which shall not stay
            self._weakest[:] = _ALONG_NO_AXIS
            inverse_square = math.inf
        return math.prod(self._diagonal.tolist()), 1.0 / math.sqrt(inverse_square)


class BoxedIk:
    """Damped least squares for joint velocities within a box.

    Minimises |J qd - v|^2 + damping^2 |qd - posture_rate|^2: as the damping goes to 0,
    `posture_rate` acts in the null space of J alone. Damping near singularities: Y. Nakamura
    and H. Hanafusa, "Inverse Kinematic Solutions With Singularity Robustness for Robot
    Manipulator Control", ASME JDSMC 108(3), 1986.

    Args:
        damping: Damping [1], `LEAST_DAMPING` or more.
        jac: Buffer of the hand Jacobian J (6, 7).
        wanted: Buffer of the hand's velocity v (6,) [m/s, rad/s] in the world frame, then
            damping^2 times `posture_rate` (7,) [rad/s]; both times `SCALE`.
        qd: Buffer (7,) that receives the joint velocities [rad/s].

    Attributes:
        solve: Solves for the joint velocities as if there were no box.
    """

    def __init__(self, damping: float, jac: Matrix, wanted: Vector, qd: Vector) -> None:
        rows = np.vstack((np.zeros((6, 7)), np.eye(7)))  # of J and of the damping
        self._weights = np.full(13, SCALE)
        self._hessian, self._pull, self._qd = np.zeros((7, 7)), np.zeros(7), qd
        self._factor, self._index = np.zeros((7, 14)), np.zeros(7, dtype=np.int32)
        self._square = linalg.square_of_columns(self._hessian, rows, self._weights)
        self.solve = linalg.chain(
            linalg.copy(rows[:6], jac),
            self._square,
            linalg.multiply_transposed(self._pull, rows, wanted),
            linalg.factorize(self._hessian, 1e-15),
            linalg.solve_factorized(qd, self._hessian, self._pull),
        )
        self.damping = damping

    @property
    def damping(self) -> float:
        """Damping [1]."""
        return self._damping

    @damping.setter
    def damping(self, damping: float) -> None:
        self._damping = damping
        self._weights[6:] = SCALE * damping * damping

    def solve_within(self, low: Vector, high: Vector) -> None:
        """Solve within a box, after `solve`, of which no solution was within.

        Args:
            low: Lowest joint velocities (7,) [rad/s].
            high: Highest joint velocities (7,) [rad/s].
        """
        self._square()
        free = self._minimise(low, high)
        # Where many joints come to their limits at once, the solver may stop short: about twice
        # in a thousand random problems. From another corner of the box it finds the way.
        for corner in (low, high):
            if free >= 0 and self._is_minimum(low, high):
                return
            np.copyto(self._qd, corner)
            free = self._minimise(low, high)
        if free < 0:  # no curvature: braking is always allowed
            np.clip(0.0, low, high, out=self._qd)

    def _minimise(self, low: Vector, high: Vector) -> int:
        """Let MuJoCo solve, from and into qd; return the number of joints that no limit binds."""
        free: int = mujoco.mju_boxQP(
            self._qd, self._factor, self._index, self._hessian, -self._pull, low, high
        )
        return free

    def _is_minimum(self, low: Vector, high: Vector) -> bool:
        """Tell whether nothing is to be gained by joints within their limits."""
        slope = self._hessian @ self._qd - self._pull
        within = (self._qd > low) & (self._qd < high)
        return bool(np.abs(slope[within]).max(initial=0.0) <= SLOPE)
