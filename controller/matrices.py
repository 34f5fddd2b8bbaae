"""The matrices by which the control law's signals are made from others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .gains import Gains
from .limits import LimitBox
from .signals import (
    MOVES,
    OF_SUMS,
    OF_WISHES,
    SUMS,
    WISHES,
    Layout,
    Memory,
    places,
    some,
)

Matrix = NDArray[np.float64]


class Blocks:
    """A matrix that makes signals from others that stand side by side.

    Args:
        results: What the rows make.
        signals: What the columns are applied to.

    Attributes:
        matrix: All blocks; zeros at first.
    """

    def __init__(self, results: Layout, signals: Layout) -> None:
        self._rows, self._columns = places(results), places(signals)
        self.matrix = np.zeros((results.itemsize // 8, signals.itemsize // 8))

    def rows(self, *results: str) -> Matrix:
        """View of all that makes neighbouring results."""
        return self.matrix[self._rows[results[0]].start : self._rows[results[-1]].stop]

    def columns(self, *signals: str) -> slice:
        """Where neighbouring signals are."""
        return slice(self._columns[signals[0]].start, self._columns[signals[-1]].stop)

    def block(self, result: str, signal: str) -> Matrix:
        """View of what one signal adds to one result."""
        return self.matrix[self._rows[result], self._columns[signal]]


def wish_matrix(gains: Gains) -> Matrix:
    """What is wished, `WISHES`, from the signals `OF_WISHES`.

    These are the joint velocities towards the posture (7,) [rad/s], the pose error (6,) [m, rad],
    and the twist of the hand that error and command ask for (6,) [m/s, rad/s].
    """
    wishes = Blocks(some(WISHES), some(OF_WISHES))
    three, six, rate = np.eye(3), np.eye(6), np.array(gains.posture_gain)
    wishes.block("drift", "qpos_ref")[:] = -np.diag(rate)
    wishes.block("drift", "one")[:, 0] = rate * gains.posture
    wishes.block("error", "pos_cmd")[:3] = three
    wishes.block("error", "hand_xpos")[:3] = -three
    wishes.block("error", "rotation")[3:] = three
    # With the next command, the mean over the period ahead.
    wishes.block("twist", "vel_cmd")[:3] = 1.5 * three
    wishes.block("twist", "omega_cmd")[3:] = 1.5 * three
    wishes.block("twist", "twist_before")[:] = -0.5 * six
    wishes.rows("twist")[:] += gains.ik_gain * wishes.rows("error")
    return wishes.matrix


class Sums:
    """What is summed up from the signals `OF_SUMS`.

    Attributes:
        matrix: To be multiplied by the signals; with the PID where it has proportional gains only.
        results: Where the results go, of layout `SUMS`.
    """

    def __init__(self) -> None:
        self._sums = sums = Blocks(SUMS, some(OF_SUMS))
        self.matrix, self.results = sums.matrix, Memory(SUMS)
        one = np.eye(7)
        sums.block("ctrl", "gripper")[7] = 1.0
        for result in ("dq", "qpos_ref", "qpos_next"):
            sums.block(result, "qpos_ref")[:] = one
        sums.block("dq", "qpos")[:] = -one
        for name in MOVES:
            sums.block("qvel_ref", name)[:] = one
        # What inertia makes: reach and ctrl of all seven joints, in one block of rows.
        rows = len(one)
        forced = sums.rows("reach_share", "ctrl")[: 2 * rows].reshape(2, rows, -1)
        moving, before = sums.columns(*MOVES), sums.columns("qvel_before")
        self._by_motion = forced[:, :, moving].reshape(2, rows, len(MOVES), rows)
        self._by_before = forced[:, :, before]
        self._impulse = np.zeros((2, rows, rows))

    def tune(self, gains: Gains, period: float, box: LimitBox, small_error: float) -> None:
        """Set all but the inertia.

        Args:
            gains: Gains.
            period: Time between two updates [s].
            box: What the joints may do.
            small_error: Numbers of a pose error that count as a share of 1 [m, rad].
        """
        sums = self._sums
        angle = 1.0 / np.array(gains.servo_stiffness)  # [rad/(N.m)]
        kp = np.array(gains.kp) * (not any(gains.ki + gains.kd))
        for name in MOVES:
            sums.block("qpos_next", name)[:] = period * np.eye(7)
        velocity = sums.rows("qvel_ref")
        sums.rows("lag_share")[:] = sums.rows("dq") / box.lead
        sums.rows("speed_share")[:] = velocity / box.speed[:, np.newaxis]
        sums.rows("change_share")[:] = velocity / box.change[:, np.newaxis]
        sums.block("change_share", "qvel_before")[:] = -np.diag(1.0 / box.change)
        sums.block("error_share", "error")[:] = np.eye(6) / small_error
        # The share is that of the way from the reference to the servo's target.
        for result, own, unit in (("ctrl", 1.0, np.ones(7)), ("reach_share", 0.0, box.room)):
            sums.block(result, "qpos_ref")[:7] = np.diag((own + kp) / unit)
            sums.block(result, "qpos")[:7] = np.diag(-kp / unit)
            bias = angle * gains.gravity_feedforward
            sums.block(result, "qfrc_bias")[:7] = np.diag(bias / unit)
        units = np.stack((box.room, np.ones(7)))[:, :, np.newaxis]
        self._lag = (np.diag(gains.servo_lag) / units)[:, :, np.newaxis]
        per_impulse = np.array(gains.inertia_feedforward) * angle / period
        self._per_impulse = per_impulse[:, np.newaxis] / units

    def weigh(self, mass: Matrix) -> None:
        """Set the inertia, after `tune`.

        Args:
            mass: Mass matrix (7, 7) [kg.m^2].
        """
        impulse = self._impulse
        np.multiply(mass, self._per_impulse, out=impulse)
        np.add(self._lag, impulse[:, :, np.newaxis], out=self._by_motion)
        np.negative(impulse, out=self._by_before)
