"""The signals of the control law, and the matrices by which one is made from others.

Signals that are multiplied by one matrix stand side by side in memory: so a law of some thirty
small sums takes two products.
"""

from __future__ import annotations

from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from controller.gains import Gains
from controller.limits import LimitBox

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Layout = np.dtype[np.void]

# What the controller takes and gives; the fields' order is that of the flat buffers.
INPUTS = np.dtype(
    [
        ("pos_cmd", float, 3),
        ("quat_cmd", float, 4),
        ("vel_cmd", float, 3),
        ("omega_cmd", float, 3),
        ("grip_cmd", float),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("jac", float, (6, 7)),
        ("qpos", float, 7),
        ("qvel", float, 7),
        ("qfrc_bias", float, 7),
    ]
)
OUTPUTS = np.dtype(
    [
        ("ctrl", float, 8),
        ("dq", float, 7),
        ("qpos_ref", float, 7),
        ("qvel_ref", float, 7),
        ("manipulability", float),
        ("singular", float),
        ("limit", float, 7),
    ]
)
N_INPUTS, N_OUTPUTS = INPUTS.itemsize // 8, OUTPUTS.itemsize // 8
POSES = ("pos_cmd", "quat_cmd", "vel_cmd", "omega_cmd", "grip_cmd", "hand_xpos", "hand_xquat")
MEASURED = ("qpos", "qvel", "qfrc_bias")
SUMMED_OUTPUTS = ("ctrl", "dq", "qpos_ref", "qvel_ref")


# All that an update computes with besides its inputs: what it remembers of earlier ones, and what
# it makes on its way.
SIGNALS = np.dtype(
    [
        ("law", float),
        ("opening", float),
        ("pid", float, (3, 7)),
        ("weakest", float, 6),
        ("until_weighing", float),
        ("weighed_qpos", float, 7),
        # From here on what wishes are made of: copies of the inputs POSES among it ...
        ("one", float),
        ("twist_before", float, 6),
        ("rotation", float, 3),
        *((name, float, INPUTS[name].shape) for name in POSES),
        # ... and from here on what sums are made of, too ...
        ("qvel_before", float, 7),
        ("qpos_ref", float, 7),
        # ... from here on sums alone, with copies of the inputs MEASURED.
        ("gripper", float),
        *((name, float, 7) for name in MEASURED),
        ("motion", float, 7),
        # These are wished.
        ("drift", float, 7),
        ("error", float, 6),
        ("twist", float, 6),
    ]
)


def _from_to(first: str, last: str) -> tuple[str, ...]:
    """Names of neighbours among the signals."""
    names = cast("tuple[str, ...]", SIGNALS.names)
    return names[names.index(first) : names.index(last) + 1]


OF_WISHES: Final = _from_to("one", "qpos_ref")
WISHES: Final = _from_to("drift", "twist")
OF_SUMS: Final = _from_to("qvel_before", "error")
VELOCITY: Final = ("motion", "drift")  # whose sum is the reference's
# What is summed up: the first outputs, the reference of the next update, and how near to its bound
# each of the things is that seldom come near one: beyond 1, a closer look is due. `reach_share`
# stands before `ctrl`, as inertia makes both.
SUMS = np.dtype(
    [
        ("change_share", float, 7),
        ("error_share", float, 6),
        ("reach_share", float, 7),
        *((name, float, OUTPUTS[name].shape) for name in SUMMED_OUTPUTS),
        ("qpos_next", float, 7),
        ("lag_share", float, 7),
        ("speed_share", float, 7),
    ]
)
SHARES: Final = (("change_share", "error_share", "reach_share"), ("lag_share", "speed_share"))


class Blocks:
    """A matrix that makes signals from others that stand side by side.

    Args:
        results: What the rows make.
        signals: What the columns are applied to.

    Attributes:
        matrix: All blocks; zeros at first.
    """

    def __init__(self, results: Layout, signals: Layout) -> None:
        self._rows, self._columns = _places(results), _places(signals)
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
    wishes = Blocks(_some(WISHES), _some(OF_WISHES))
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
        values: Where the results go (70,), in the order of `SUMS`.
    """

    def __init__(self) -> None:
        self._sums = sums = Blocks(SUMS, _some(OF_SUMS))
        self.matrix, self.values = sums.matrix, np.zeros(SUMS.itemsize // 8)
        one = np.eye(7)
        sums.block("ctrl", "gripper")[7] = 1.0
        for result in ("dq", "qpos_ref", "qpos_next"):
            sums.block(result, "qpos_ref")[:] = one
        sums.block("dq", "qpos")[:] = -one
        for name in VELOCITY:
            sums.block("qvel_ref", name)[:] = one
        # What inertia makes: reach and ctrl of all seven joints, in one block of rows.
        rows = len(one)
        forced = sums.rows("reach_share", "ctrl")[: 2 * rows].reshape(2, rows, -1)
        moving, before = sums.columns(*VELOCITY), sums.columns("qvel_before")
        self._by_motion = forced[:, :, moving].reshape(2, rows, len(VELOCITY), rows)
        self._by_before = forced[:, :, before]
        self._impulse = np.zeros((2, rows, rows))

    def tune(self, gains: Gains, period: float, box: LimitBox, small_error: float) -> None:
        """Set all but the inertia.

        Args:
            gains: Gains.
            period: Time between two updates [s].
            box: What the joints may do.
            small_error: Of this length, a pose error has a share of 1 at least [m, rad].
        """
        sums = self._sums
        angle = 1.0 / np.array(gains.servo_stiffness)  # [rad/(N.m)]
        kp = np.array(gains.kp) * (not any(gains.ki + gains.kd))
        for name in VELOCITY:
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


def _some(names: tuple[str, ...]) -> Layout:
    """Layout of some of the signals, side by side."""
    return np.dtype([(name, SIGNALS[name]) for name in names])


def _places(layout: Layout) -> dict[str, slice]:
    """Where each field of a layout is in its flat buffer."""
    assert layout.fields is not None
    starts = {name: field[1] // 8 for name, field in layout.fields.items()}
    return {
        name: slice(start, start + layout[name].itemsize // 8) for name, start in starts.items()
    }


def part(values: Vector, layout: Layout, *names: str) -> Vector:
    """Return a view of neighbouring fields in a flat buffer."""
    places = _places(layout)
    return values[places[names[0]].start : places[names[-1]].stop]


def scalars(values: Vector, layout: Layout, *names: str) -> memoryview[float]:
    """Return that view as memory, of which single numbers are read and written far sooner."""
    return cast("memoryview[float]", part(values, layout, *names).data)
