"""The robot's joint limits, as bounds of the joint velocities of one period."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX

Vector = NDArray[np.float64]
Box = NDArray[np.float64]  # rows lowest and highest joint velocity (2, 7) [rad/s]

POSITION, VELOCITY, ACCELERATION = 1.0, 2.0, 3.0  # kinds of limit
# [rad/s] Smallest width of the box: the solver needs one even where a joint must brake fully.
MIN_WIDTH = 1e-9
RETURN_RATE = 20.0  # [1/s] of the return of a reference that is too far ahead of its joint

END_MARGIN = 0.001  # [rad] between a reference and its joint's end, for the servo's overshoot

_ENDS = np.stack((Q_MIN + END_MARGIN, Q_MAX - END_MARGIN))
_SIDES = np.array([[-1.0], [1.0]])
_MIDDLE = 0.5 * (Q_MIN + Q_MAX)


def clamp(values: Vector, low: Vector, high: Vector) -> Vector:
    """Return values within bounds (n,); the upper bound wins. Faster than `np.clip`."""
    clamped: Vector = np.minimum(np.maximum(values, low), high)
    return clamped


class JointLimits:
    """Bounds of the joint reference's velocity, per joint.

    The velocity limit bounds the speed, and so does the room to brake before the end of the
    joint's range; a reference that is too far ahead of its joint returns to it. The acceleration
    limit bounds the change of speed and takes precedence, since it can always be met.

    Args:
        share: Share of the limits that may be used [1].
        lead: How far the reference may be ahead of the measured joint [rad].
        period: Length of a period [s].
    """

    def __init__(self, share: float, lead: float, period: float) -> None:
        self._lead = lead
        self._speed = share * QD_MAX
        self._change = share * QDD_MAX * period
        self._twice_braking = 2.0 * share * QDD_MAX
        self._half_change = 0.5 * self._change
        self._half_squared = self._half_change * self._half_change
        stop = self._speed * self._speed / self._twice_braking + self._speed * period
        self._near = np.stack(
            (self._speed, self._change, np.full(7, lead), 0.5 * (_ENDS[1] - _ENDS[0]) - stop)
        )

    def inactive(self, qd: Vector, q_ref: Vector, qd_before: Vector, lag: Vector) -> bool:
        """Whether all limits are so far away that `velocity_box` is sure to contain qd.

        This is a cheap check. A limit counts as near where, for instance, a joint could not
        stop from full speed before the end of its range.

        Args:
            qd: Joint velocities (7,) [rad/s].
            q_ref: See `velocity_box`.
            qd_before: See `velocity_box`.
            lag: See `velocity_box`.
        """
        sizes = np.abs(np.array((qd, qd - qd_before, lag, q_ref - _MIDDLE)))
        return bool((sizes < self._near).all())

    def velocity_box(self, q_ref: Vector, qd_before: Vector, lag: Vector) -> Box:
        """Return the bounds of the joint velocities in this period.

        Args:
            q_ref: Joint reference (7,) [rad].
            qd_before: Its velocity in the period before (7,) [rad/s].
            lag: Joint reference minus measured joint positions (7,) [rad].
        """
        room = np.maximum(_SIDES * (_ENDS - q_ref), 0.0)
        # Braking from v in steps takes v^2 / (2 a) + v T / 2.
        speed = np.sqrt(self._twice_braking * room + self._half_squared) - self._half_change
        box = _SIDES * np.minimum(speed, self._speed)
        excess = np.abs(lag) - self._lead
        if excess.max() > 0.0:
            self._come_back(box, excess, lag)
        box = clamp(box, qd_before - self._change, qd_before + self._change)
        box[1] = np.maximum(box[1], box[0] + MIN_WIDTH)
        return box

    def _come_back(self, box: Box, excess: Vector, lag: Vector) -> None:
        """Let references that are too far ahead, by `excess` (7,) [rad], return; in place."""
        low, high = box
        speed = RETURN_RATE * excess
        behind, ahead = (excess > 0.0) & (lag < 0.0), (excess > 0.0) & (lag > 0.0)
        low[:] = np.where(behind, np.minimum(speed, high), low)
        high[:] = np.where(ahead, np.maximum(-speed, low), high)

    def binding(self, qd: Vector, qd_before: Vector, box: Box) -> Vector:
        """Return the limit that binds each joint.

        Args:
            qd: Joint velocities (7,) [rad/s], within the box.
            qd_before: Those of the period before (7,) [rad/s].
            box: Of this period.

        Returns:
            `POSITION`, `VELOCITY`, `ACCELERATION`, or 0 for none (7,).
        """
        low, high = box
        by_change = (qd <= qd_before - self._change) | (qd >= qd_before + self._change)
        kinds = np.where(np.abs(qd) >= self._speed, VELOCITY, POSITION)
        kinds = np.where(by_change, ACCELERATION, kinds)
        binds: Vector = np.where((qd <= low) | (qd >= high), kinds, 0.0)
        return binds


def within(qd: Vector, box: Box) -> bool:
    """Whether joint velocities (7,) are within a box."""
    return bool(((box[0] <= qd) & (qd <= box[1])).all())
