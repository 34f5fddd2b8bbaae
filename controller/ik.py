"""Differential inverse kinematics of the arm, with and without limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX
from controller import linalg
from controller.gains import Gains

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
LEAST_DAMPING = 1e-5  # [1] of the least squares, by which they have one solution despite rounding
_SIDES = np.array([[-1.0], [1.0]])
_SURELY = 1.0 - 1e-9  # of a limit: rounding does not reach it


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
        self._gains, rate = gains, gains.ik_gain
        limits = (
            (gains.linear_correction, gains.linear_braking),
            (gains.angular_correction, gains.angular_braking),
        )
        # What is shorter than that need not be shortened.
        self._short = min(
            (min(speed / rate, 2.0 * braking / rate**2) for speed, braking in limits)
            if rate > 0.0
            else (math.inf,)
        )

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
        self._weakest[:] = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0  # along no axis, which could be a wrong one
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
        return math.prod(self._diagonal.tolist()), 1.0 / math.sqrt(inverse_square)


class Joints(NamedTuple):
    """Buffers of what moves the joint reference, each (7,).

    Attributes:
        q: Positions [rad].
        qd: Velocities in this period [rad/s].
        qd_before: Velocities in the period before [rad/s].
        lag: Positions minus the measured ones [rad].
    """

    q: Vector
    qd: Vector
    qd_before: Vector
    lag: Vector


class _Bound:
    """A bound of each number's magnitude in a buffer."""

    def __init__(self, values: Vector, bound: Vector) -> None:
        self._values, self._bound = values, bound
        # A vector that is shorter than that has no number beyond its bound; this takes less to see.
        self._norm, self._least = linalg.norm(values), float(bound.min())

    def holds(self) -> bool:
        """Tell whether all are less than their bound."""
        return self._norm() < self._least or bool((np.abs(self._values) < self._bound).all())


class LimitBox:
    """The joint velocities that the robot's limits allow in one period, as a box.

    Speed is bounded by the velocity limit and by what leaves room to brake before a joint's end;
    a reference that has run too far ahead of its joint comes back. The change of speed is bounded
    by the acceleration limit, which comes first: it can always be kept.

    Args:
        period: Length of the period [s].
        share: Share of the limits that may be used [1].
        lead: How far the reference may be ahead of the measured joints [rad].
        joints: Buffers of the reference's joint positions and velocities; all else is of it.

    Attributes:
        low: Lowest joint velocities (7,) [rad/s].
        high: Highest joint velocities (7,) [rad/s].
        room: Where `spares` has said so, no joint's reference is nearer to an end [rad].
    """

    def __init__(self, period: float, share: float, lead: float, joints: Joints) -> None:
        self._period, self._lead, self._joints = period, lead, joints
        self._speed = share * QD_MAX
        self._speed_low = -self._speed
        self._braking = 2.0 * share * QDD_MAX * _SIDES  # (2, 7)
        self._speed_step = share * QDD_MAX * period * _SIDES  # (2, 7)
        self._half_step = 0.5 * self._speed_step[1]
        self.room = _SURELY * float((self._speed**2 / self._braking[1]).min())
        change = np.zeros(7)
        self._see_change = linalg.subtract(change, joints.qd, joints.qd_before)
        self._spared_speed = _Bound(joints.qd, _SURELY * self._speed)
        self._spared_change = _Bound(change, _SURELY * self._speed_step[1])
        self._lag = linalg.norm(joints.lag)
        self._reach = np.zeros((2, 7))
        self._slowest, self._fastest = self._reach
        self._box = np.zeros((2, 7))
        self.low, self.high = self._box
        self.forget()

    def forget(self) -> None:
        """Look at the joints' ends at the next update, wherever the joints were before."""
        self._clear = 0  # number of periods in which no end can come near

    def spares(self) -> bool:
        """Tell whether no limit can bind in this period, as far as that shows at a glance.

        Where this is so, `update` need not be called.
        """
        self._see_change()
        spared = (
            self._clear > 0
            and self._lag() < self._lead
            and self._spared_speed.holds()
            and self._spared_change.holds()
        )
        if spared:
            self._clear -= 1
        return spared

    def update(self) -> None:
        """Set the box of this period."""
        q_ref, lag, qd = self._joints.q, self._joints.lag, self._joints.qd_before
        np.add(self._speed_step, qd, out=self._reach)
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

    def holds(self) -> bool:
        """Tell whether the joint velocities are within the box."""
        qd = self._joints.qd
        return bool(((self.low <= qd) & (qd <= self.high)).all())

    def _clear_periods(self, q_ref: Vector, qd: Vector) -> int:
        """How long braking for an end cannot begin, at full speed towards it."""
        if (np.abs(qd) > self._speed).any():  # after a change of gains
            return 0
        way = self._speed * self._period
        room = np.minimum(Q_MAX - q_ref, q_ref - Q_MIN) - self._speed**2 / self._braking[1] - way
        return max(0, int((room / way).min()))

    def limits(self) -> Vector:
        """Tell which limit binds each joint at the joint velocities, which are within the box.

        Returns:
            `POSITION`, `VELOCITY`, `ACCELERATION` or 0 for none (7,).
        """
        qd = self._joints.qd
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
