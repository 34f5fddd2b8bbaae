"""Differential inverse kinematics of the arm, with and without limits."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

POSITION, VELOCITY, ACCELERATION = 1.0, 2.0, 3.0  # kinds of limit
# [rad/s] The solver wants a box that is not flat, as it is where a joint must brake all it can.
_MIN_WIDTH = 1e-9
_RETURN_RATE = 20.0  # [1/s] at which a reference comes back that is too far ahead of its joint
_ENDS = np.stack((Q_MIN, Q_MAX))
# mju_boxQP stops where the gradient is shorter than 1e-8, which the weak pull in the null space
# always is. The problem is solved times this factor.
SCALE = 1e6
SLOPE = 1e-6 * SCALE  # of the problem's value, at most, where it counts as flat
_SIDES = np.array([[-1.0], [1.0]])


def rotation_error(quat_cmd: Vector, quat_hand: Vector, out: Vector) -> None:
    """Rotation vector that turns the hand into the command, in the world frame.

    Args:
        quat_cmd: Commanded orientation (w, x, y, z).
        quat_hand: Measured orientation (w, x, y, z).
        out: Receives the vector (3,) [rad], of length pi at most.
    """
    # On plain floats this is twice as fast as on arrays.
    aw, ax, ay, az = quat_cmd.tolist()
    bw, bx, by, bz = quat_hand.tolist()
    w = aw * bw + ax * bx + ay * by + az * bz  # of the product q_cmd * conj(q_hand)
    x = ax * bw - aw * bx + az * by - ay * bz
    y = ay * bw - aw * by + ax * bz - az * bx
    z = az * bw - aw * bz + ay * bx - ax * by
    sine = math.sqrt(x * x + y * y + z * z)
    # atan2 of both with the sign of w turned positive: the shorter way round.
    scale = 2.0 * math.atan2(sine, abs(w)) / sine if sine > 0.0 else 2.0
    scale = math.copysign(scale, w)
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


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
        weakest: Buffer (6,) for the direction in which the hand is hardest to move.
    """

    def __init__(self, weakest: Vector) -> None:
        self._weakest = weakest
        self._factor = np.zeros((6, 6))

    def begin(self, jac: Matrix) -> None:
        """Find the weakest direction from nothing."""
        self._weakest[:] = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0  # along no axis, which could be a wrong one
        for _ in range(50):
            self.measure(jac)

    def measure(self, jac: Matrix) -> tuple[float, float]:
        """Measure.

        Args:
            jac: Hand Jacobian J (6, 7).

        Returns:
            Manipulability sqrt(det(J J^T)), and the smallest singular value of J.
        """
        factor, weakest = self._factor, self._weakest
        mujoco.mju_mulMatMatT(factor, jac, jac)
        mujoco.mju_cholFactor(factor, 1e-20)
        mujoco.mju_cholSolve(weakest, factor, weakest)
        inverse_square = mujoco.mju_normalize(weakest)
        return math.prod(factor.diagonal().tolist()), 1.0 / math.sqrt(inverse_square)


class LimitBox:
    """The joint velocities that the robot's limits allow in one period, as a box.

    Speed is bounded by the velocity limit and by what leaves room to brake before a joint's end;
    a reference that has run too far ahead of its joint comes back. The change of speed is bounded
    by the acceleration limit, which comes first: it can always be kept.

    Args:
        period: Length of the period [s].
        share: Share of the limits that may be used [1].
        lead: How far the reference may be ahead of the measured joints [rad].

    Attributes:
        low: Lowest joint velocities (7,) [rad/s].
        high: Highest joint velocities (7,) [rad/s].
    """

    def __init__(self, period: float, share: float, lead: float) -> None:
        self._period, self._lead = period, lead
        self._speed = share * QD_MAX
        self._speed_low = -self._speed
        self._braking = 2.0 * share * QDD_MAX * _SIDES  # (2, 7)
        self._speed_step = share * QDD_MAX * period * _SIDES  # (2, 7)
        self._half_step = 0.5 * self._speed_step[1]
        self._reach = np.zeros((2, 7))
        self._slowest, self._fastest = self._reach
        self._box = np.zeros((2, 7))
        self.low, self.high = self._box
        self.forget()

    def forget(self) -> None:
        """Look at the joints' ends at the next update, wherever the joints were before."""
        self._clear = 0  # number of periods in which no end can come near

    def update(self, q_ref: Vector, lag: Vector, qd: Vector) -> None:
        """Set the box of this period.

        Args:
            q_ref: Joint reference (7,) [rad].
            lag: Reference minus measured joint positions (7,) [rad].
            qd: Velocity of the reference in the period before (7,) [rad/s].
        """
        np.add(self._speed_step, qd, out=self._reach)
        if self._clear > 0 and math.hypot(*lag.tolist()) < self._lead:
            self._clear -= 1
            np.maximum(self._slowest, self._speed_low, out=self.low)
            np.minimum(self._fastest, self._speed, out=self.high)
            return
        # Braking from v in steps takes v^2 / (2 a) + v T / 2.
        room = np.maximum(self._braking * (_ENDS - q_ref), 0.0)
        braking = _SIDES * (np.sqrt(room + self._half_step**2) - self._half_step)
        np.clip(braking, self._speed_low, self._speed, out=self._box)
        excess = _RETURN_RATE * (np.abs(lag) - self._lead)
        np.copyto(self.low, excess, where=(excess > 0.0) & (lag < 0.0))
        np.copyto(self.high, -excess, where=(excess > 0.0) & (lag > 0.0))
        np.clip(self._box, self._slowest, self._fastest, out=self._box)
        np.maximum(self.high, self.low + _MIN_WIDTH, out=self.high)
        self._clear = self._clear_periods(q_ref, qd)

    def _clear_periods(self, q_ref: Vector, qd: Vector) -> int:
        """How long braking for an end cannot begin, at full speed towards it."""
        if (np.abs(qd) > self._speed).any():  # after a change of gains
            return 0
        way = self._speed * self._period
        room = np.minimum(Q_MAX - q_ref, q_ref - Q_MIN) - self._speed**2 / self._braking[1] - way
        return max(0, int((room / way).min()))

    def limits(self, qd: Vector) -> Vector:
        """Tell which limit binds each joint.

        Args:
            qd: A velocity within the box (7,) [rad/s].

        Returns:
            `POSITION`, `VELOCITY`, `ACCELERATION` or 0 for none (7,).
        """
        bound = (qd <= self.low) | (qd >= self.high)
        by_acceleration = (qd <= self._slowest) | (qd >= self._fastest)
        by_speed = np.abs(qd) >= self._speed
        kinds = np.where(by_speed, VELOCITY, POSITION)
        kinds[by_acceleration] = ACCELERATION
        limits: Vector = np.where(bound, kinds, 0.0)
        return limits


class BoxedIk:
    """Damped least squares for joint velocities within a box.

    Minimises |J qd - v|^2 + damping^2 |qd - posture_rate|^2: as the damping goes to 0,
    `posture_rate` acts in the null space of J alone. Damping near singularities: Y. Nakamura
    and H. Hanafusa, "Inverse Kinematic Solutions With Singularity Robustness for Robot
    Manipulator Control", ASME JDSMC 108(3), 1986.

    Args:
        damping: Damping [1].
    """

    def __init__(self, damping: float) -> None:
        self._rows = np.vstack((np.zeros((6, 7)), np.eye(7)))  # of J and of the damping
        self._jac = self._rows[:6]
        self._weights = np.full(13, SCALE)
        self._hessian, self._gradient = np.zeros((7, 7)), np.zeros(7)
        self._factor, self._index = np.zeros((7, 14)), np.zeros(7, dtype=np.int32)
        self.damping = damping

    @property
    def damping(self) -> float:
        """Damping [1]."""
        return self._damping

    @damping.setter
    def damping(self, damping: float) -> None:
        self._damping = damping
        self._weights[6:] = SCALE * damping * damping

    def solve(self, jac: Matrix, wanted: Vector, box: LimitBox, qd: Vector) -> bool:
        """Solve for the joint velocities of this period.

        Args:
            jac: Hand Jacobian (6, 7).
            wanted: Minus the hand velocity (6,) [m/s, rad/s] in the world frame, then minus
                damping^2 times the velocity in the null space (7,) [rad/s]; times `SCALE`.
            box: Limits.
            qd: Velocities of the period before (7,) [rad/s]; receives those of this one.

        Returns:
            Whether a limit binds.
        """
        np.copyto(self._jac, jac)
        mujoco.mju_sqrMatTD(self._hessian, self._rows, self._weights)
        mujoco.mju_mulMatTVec(self._gradient, self._rows, wanted)
        free = self._minimise(box, qd)
        if free == 7:
            return False
        # Where many joints come to their limits at once, the solver may stop short: about twice
        # in a thousand random problems. From another corner of the box it finds the way.
        for corner in (box.low, box.high):
            if free >= 0 and self._is_minimum(box, qd):
                return True
            np.copyto(qd, corner)
            free = self._minimise(box, qd)
        if free < 0:  # no curvature: braking is always allowed
            np.clip(0.0, box.low, box.high, out=qd)
        return True

    def _minimise(self, box: LimitBox, qd: Vector) -> int:
        """Let MuJoCo solve, from and into qd; return the number of joints that no limit binds."""
        free: int = mujoco.mju_boxQP(
            qd, self._factor, self._index, self._hessian, self._gradient, box.low, box.high
        )
        return free

    def _is_minimum(self, box: LimitBox, qd: Vector) -> bool:
        """Tell whether nothing is to be gained by joints within their limits."""
        slope = self._hessian @ qd + self._gradient
        within = (qd > box.low) & (qd < box.high)
        return bool(np.abs(slope[within]).max(initial=0.0) <= SLOPE)
