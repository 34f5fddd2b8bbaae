"""The robot's joint limits, as bounds of the joint velocities of one period."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..assets.fields import Vector
from ..assets.franka import PANDA
from ..assets.limits import RobotLimits

Box = NDArray[np.float64]  # rows lowest and highest joint velocity (2, 7) [rad/s]

POSITION, VELOCITY, ACCELERATION, JERK = 1.0, 2.0, 3.0, 4.0  # kinds of limit
# [rad/s] Smallest width of the box: the solver needs one even where a joint must brake fully.
MIN_WIDTH = 1e-9
# Share of the acceleration that is planned for braking before an end. Braking sets in late, as the
# jerk is limited; the rest of the acceleration makes up for that.
BRAKING = 0.95
ROUNDING = 1e-9  # of a change
RETURN_RATE = 20.0  # [1/s] rate at which a joint reference that is too far ahead returns

END_MARGIN = 0.001  # [rad] between a joint reference and the joint's end, for the servo's overshoot
# [1/s] A joint's speed towards its end is at most this rate times the distance left, so that the
# other joints take over gradually. If it braked as late as it can, they would jump.
APPROACH_RATE = 5.0
# Within a zone before its end, a joint is pulled back in the null space, by 60 w^2 where it is w
# inside. So joints rarely reach their ends where the hand's path leaves a choice. The pull has a
# largest speed: if the arm turned about the hand as fast as it can, the hand would leave its path.
# Joint 4 is not pulled: the hand's distance decides where it is, and near its end the arm is
# stretched.
END_ZONE = 0.8  # [rad]
END_SPEED = 2.0  # [rad/s]
END_PULL = np.array([60.0, 60.0, 60.0, 0.0, 60.0, 60.0, 60.0])  # [1/(rad s)]

_SIDES = np.array([[-1.0], [1.0]])


def clamp(values: Vector, low: Vector, high: Vector) -> Vector:
    """Return values within bounds (n,); the upper bound wins. Faster than `np.clip`."""
    return np.minimum(np.maximum(values, low), high)


class Motion(NamedTuple):
    """The joint reference of the period before, (7,) each."""

    q_ref: Vector  # [rad] of this period
    qd: Vector  # [rad/s]
    qdd: Vector  # [rad/s^2]
    lag: Vector  # [rad] joint reference minus measured joint positions


class JointLimits:
    """Bounds of the joint reference's velocity, per joint.

    Speed is bounded by the velocity limit at the joint's position, and before the end of the
    joint's range by what leaves room to brake gradually; a reference that has run too far ahead of
    its joint comes back. The change of speed is bounded by the acceleration limit, and its change
    by the jerk limit, which take precedence: they can always be kept.

    `share` of the limits may be used [1], and the joint reference be ahead of the measured joint by
    `lead` [rad]. Joint velocities qd are (7,) [rad/s].
    """

    def __init__(self, share: float, lead: float, period: float, robot: RobotLimits = PANDA):
        self._share, self._lead, self._period, self._robot = share, lead, period, robot
        acceleration, jerk = robot.acceleration, robot.jerk
        self._ends = np.stack((robot.q_min + END_MARGIN, robot.q_max - END_MARGIN))
        self._middle = 0.5 * (robot.q_min + robot.q_max)
        self._speed = share * robot.velocity
        self._change = share * acceleration * period
        self._step = share * jerk * period * period  # of the change, from period to period
        self._twice_braking = 2.0 * BRAKING * share * acceleration
        self._half_change = 0.5 * BRAKING * share * acceleration * (period + acceleration / jerk)
        self._half_squared = self._half_change * self._half_change
        stop = self._speed * self._speed / self._twice_braking + self._speed * (
            period + acceleration / jerk
        )
        stop = np.maximum(stop, self._speed / APPROACH_RATE)
        if approach := robot.approach:
            slow = robot.velocity + approach["offset"]
            room = slow * slow / (2.0 * approach["braking"]) + (self._ends[1] - approach["high"])
            stop = np.maximum(stop, room)
        # A change may be taken back in steps alone, so that the speed goes on growing meanwhile.
        slack = self._change * self._change / self._step
        rates = (self._speed - slack, self._change, self._step)
        room = 0.5 * (self._ends[1] - self._ends[0]) - stop
        self._near = np.stack((*rates, np.full(7, lead), room))

    def pull_from_ends(self, q_ref: Vector) -> Vector:
        """Joint velocities that lead away from the ends of the joints' ranges."""
        inside = np.maximum(END_ZONE - _SIDES * (self._ends - q_ref), 0.0)
        up, down = np.minimum(END_PULL * inside * inside, END_SPEED)
        return np.asarray(up - down)

    def inactive(self, qd: Vector, before: Motion) -> bool:
        """Check cheaply that no limit is near; `velocity_box` then contains qd."""
        change = qd - before.qd
        turn = change - self._period * before.qdd  # at least as large as in `_changes`
        sizes = np.abs(np.array((qd, change, turn, before.lag, before.q_ref - self._middle)))
        return bool(np.count_nonzero(sizes < self._near) == self._near.size)  # faster than `all`

    def velocity_box(self, before: Motion) -> Box:
        """Return the joint velocities that are allowed in this period."""
        q_ref, qd_before, qdd_before, lag = before
        box = _SIDES * self._stoppable(q_ref)
        excess = np.abs(lag) - self._lead
        if excess.max() > 0.0:
            self._come_back(box, excess, lag)
        low, high = qd_before + _SIDES * self._reachable(_SIDES * (box - qd_before))
        # Coming back, too, no faster than the speed can be kept from growing beyond its limit.
        lowest = np.where(lag < 0.0, np.minimum(low, high), low)
        highest = np.where(lag > 0.0, np.maximum(high, low), high)
        least, most = self._changes(qdd_before)
        box = clamp(np.stack((lowest, highest)), qd_before + least, qd_before + most)
        box[1] = np.maximum(box[1], box[0] + MIN_WIDTH)
        return box

    def _changes(self, qdd_before: Vector) -> tuple[Vector, Vector]:
        """Lowest and highest change of speed that acceleration and jerk allow (7,) [rad/s]."""
        before = clamp(self._period * qdd_before, -self._change, self._change)
        least: Vector = np.maximum(before - self._step, -self._change)
        most: Vector = np.minimum(before + self._step, self._change)
        return least, most

    def _stoppable(self, q_ref: Vector) -> Vector:
        """Highest speeds at which the joints approach their lower and upper ends (2, 7)."""
        # They approach at `APPROACH_RATE`, and can stop in time: braking from v takes v^2 / (2 a) +
        # v (T + a / j) / 2, with the time in which the brake comes on.
        room = np.maximum(_SIDES * (self._ends - q_ref), 0.0)
        speed = np.sqrt(self._twice_braking * room + self._half_squared) - self._half_change
        speed = np.minimum(speed, APPROACH_RATE * room)
        return np.minimum(speed, self._share * self._robot.speed(q_ref, _SIDES))

    def _reachable(self, room: Vector) -> Vector:
        """Largest change of speed that can be reduced to 0, step by step, within a room (2, 7)."""
        # A change of d is followed by d - step, d - 2 step and so on.
        count = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * np.maximum(room, 0.0) / self._step) - 1.0))
        return (room + 0.5 * self._step * count * (count + 1.0)) / (count + 1.0)

    def _come_back(self, box: Box, excess: Vector, lag: Vector) -> None:
        """Pull back, in place, joint references that are too far ahead by `excess` (7,) [rad]."""
        low, high = box
        speed = RETURN_RATE * excess
        behind, ahead = (excess > 0.0) & (lag < 0.0), (excess > 0.0) & (lag > 0.0)
        low[:] = np.where(behind, np.minimum(speed, high), low)
        high[:] = np.where(ahead, np.maximum(-speed, low), high)

    def binding(self, qd: Vector, before: Motion, box: Box) -> Vector:
        """Tell which limit binds each joint (7,): `POSITION` to `JERK`, or 0 for none."""
        low, high = box
        least, most = self._changes(before.qdd)
        by_change = (qd <= before.qd + least) | (qd >= before.qd + most)
        full = np.abs(qd - before.qd) >= (1.0 - ROUNDING) * self._change
        free = self._stoppable(before.q_ref).min(axis=0) >= self._speed
        kinds = np.where(free & (np.abs(before.lag) <= self._lead), VELOCITY, POSITION)
        kinds = np.where(by_change, np.where(full, ACCELERATION, JERK), kinds)
        return np.where((qd <= low) | (qd >= high), kinds, 0.0)


def within(qd: Vector, box: Box) -> bool:
    """Whether joint velocities (7,) are within a box."""
    return bool(((box[0] <= qd) & (qd <= box[1])).all())
