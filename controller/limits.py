"""The limits of the robot's joints, as they bound the joint velocities of one period."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX

Vector = NDArray[np.float64]

POSITION, VELOCITY, ACCELERATION = 1.0, 2.0, 3.0  # kinds of limit
# [rad/s] The solver wants a box that is not flat, as it is where a joint must brake all it can.
_MIN_WIDTH = 1e-9
_RETURN_RATE = 20.0  # [1/s] at which a reference comes back that is too far ahead of its joint
_ENDS = np.stack((Q_MIN, Q_MAX))
_SIDES = np.array([[-1.0], [1.0]])
_SLACK = 0.2  # [rad] that a joint is further from its ends than braking takes, while none is near
_LONG = 1e6  # periods, after which the ends are looked at in any case
_SURELY = 1.0 - 1e-9  # of a limit: rounding does not reach it


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
        lead: How far the reference may be ahead of the measured joints [rad].
        speed: Below these joint velocities, no limit of the speed binds (7,) [rad/s].
        change: Below these changes of them, no limit of the acceleration binds (7,) [rad/s].
        room: In a period that `spares` spares, each joint's reference is at least as far from
            its ends (7,) [rad].
    """

    def __init__(self, period: float, share: float, lead: float, joints: Joints) -> None:
        self.lead = lead
        self._period, self._joints = period, joints
        self._speed = share * QD_MAX
        self._speed_low = -self._speed
        self._braking = 2.0 * share * QDD_MAX * _SIDES  # (2, 7)
        self._speed_step = share * QDD_MAX * period * _SIDES  # (2, 7)
        self._half_step = 0.5 * self._speed_step[1]
        self.speed, self.change = _SURELY * self._speed, _SURELY * self._speed_step[1]
        self.room = _SLACK + _SURELY * self._speed**2 / self._braking[1]
        self._reach = np.zeros((2, 7))
        self._slowest, self._fastest = self._reach
        self._box = np.zeros((2, 7))
        self.low, self.high = self._box
        self.forget()

    def forget(self) -> None:
        """Look at the joints' ends at the next update, wherever the joints were before."""
        self._clear = 0  # number of periods in which no end can come near

    def spares(self) -> bool:
        """Tell whether no joint's end can come near in this period.

        Where this is so, and the numbers are below `lead`, `speed` and `change`, no limit binds
        and `update` need not be called; and what is less than `room` away from the reference is
        within the joints' ends. To be asked once a period, as periods are counted.
        """
        self._clear -= 1
        return self._clear >= 0

    def update(self) -> None:
        """Set the box of this period."""
        q_ref, lag, qd = self._joints.q, self._joints.lag, self._joints.qd_before
        np.add(self._speed_step, qd, out=self._reach)
        # Braking from v in steps takes v^2 / (2 a) + v T / 2.
        room = np.maximum(self._braking * (_ENDS - q_ref), 0.0)
        braking = _SIDES * (np.sqrt(room + self._half_step**2) - self._half_step)
        np.clip(braking, self._speed_low, self._speed, out=self._box)
        excess = _RETURN_RATE * (np.abs(lag) - self.lead)
        behind, ahead = (excess > 0.0) & (lag < 0.0), (excess > 0.0) & (lag > 0.0)
        np.copyto(self.low, np.minimum(excess, self.high), where=behind)
        np.copyto(self.high, np.maximum(-excess, self.low), where=ahead)
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
        near = _SLACK + self._speed**2 / self._braking[1] + way
        room = np.minimum(Q_MAX - q_ref, q_ref - Q_MIN) - near
        return int(np.clip((room / way).min(), 0.0, _LONG))

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
