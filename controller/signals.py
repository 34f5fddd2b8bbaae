"""The controller's signals: how they lie in memory, and the matrices that weigh them."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from controller.gains import Gains
from controller.ik import SCALE

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

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
# What the next update depends on besides the inputs. Neighbours that the law multiplies by one
# matrix stand side by side.
STATE = np.dtype(
    [
        ("law", float),
        ("opening", float),
        ("pid", float, (3, 7)),
        ("weakest", float, 6),
        ("until_weighing", float),
        ("weighed_qpos", float, 7),
        ("twist_cmd", float, 6),
        ("twist_before", float, 6),
        ("error", float, 6),
        ("one", float),
        ("qpos_ref", float, 7),
        ("qvel_ref", float, 7),
        ("qvel_before", float, 7),
        ("qpos", float, 7),
        ("qvel", float, 7),
        ("qfrc_bias", float, 7),
    ]
)
WISHES = ("twist_cmd", "twist_before", "error", "one", "qpos_ref")
MEASURED = ("qpos", "qvel", "qfrc_bias")
SIGNALS = ("qpos_ref", "qvel_ref", "qvel_before", *MEASURED)


def wish_matrix(gains: Gains, damping: float) -> Matrix:
    """What is wanted of `BoxedIk`, from the signals `WISHES`.

    Returns:
        Matrix (13, 26): to the hand's velocity, and damping^2 times the null space's; both times
        `SCALE`.
    """
    matrix, part = _blank(13, WISHES)
    six = np.eye(6)
    part["twist_cmd"][:6] = 1.5 * six  # with the next, the mean over the period ahead
    part["twist_before"][:6] = -0.5 * six
    part["error"][:6] = gains.ik_gain * six
    rate = damping * damping * np.array(gains.posture_gain)
    part["qpos_ref"][6:] = -np.diag(rate)
    part["one"][6:, 0] = rate * gains.posture
    return SCALE * matrix


class CtrlMatrix:
    """What each of the signals `SIGNALS` adds to the servos' targets.

    Attributes:
        matrix: Matrix (7, 42); with the PID where it has proportional gains only.
    """

    def __init__(self) -> None:
        self.matrix, self._part = _blank(7, SIGNALS)

    def tune(self, gains: Gains, period: float) -> None:
        """Set all but the inertia.

        Args:
            gains: Gains.
            period: Time between two updates [s].
        """
        angle = 1.0 / np.array(gains.servo_stiffness)  # [rad/(N.m)]
        kp = np.array(gains.kp) * (not any(gains.ki + gains.kd))
        self._part["qpos_ref"][:] = np.diag(1.0 + kp)
        self._part["qpos"][:] = np.diag(-kp)
        self._part["qfrc_bias"][:] = np.diag(angle * gains.gravity_feedforward)
        self._lag = np.diag(gains.servo_lag)
        self._per_impulse = (np.array(gains.inertia_feedforward) * angle / period)[:, np.newaxis]

    def weigh(self, mass: Matrix) -> None:
        """Set the inertia, after `tune`.

        Args:
            mass: Mass matrix (7, 7) [kg.m^2].
        """
        impulse = mass * self._per_impulse
        np.add(self._lag, impulse, out=self._part["qvel_ref"])
        np.negative(impulse, out=self._part["qvel_before"])


def _blank(rows: int, names: tuple[str, ...]) -> tuple[Matrix, dict[str, Matrix]]:
    """Return a matrix of zeros for neighbouring signals, and each signal's columns in it."""
    sizes = [STATE[name].itemsize // 8 for name in names]
    matrix = np.zeros((rows, sum(sizes)))
    columns = np.split(matrix, np.cumsum(sizes)[:-1], axis=1)
    return matrix, dict(zip(names, columns, strict=True))


def part(values: Vector, layout: np.dtype[np.void], *names: str) -> Vector:
    """Return a view of neighbouring fields in a flat buffer."""
    assert layout.fields is not None
    start = layout.fields[names[0]][1] // 8
    return values[start : start + sum(layout[name].itemsize // 8 for name in names)]


def scalars(values: Vector, layout: np.dtype[np.void], *names: str) -> memoryview[float]:
    """Return that view as memory, of which single numbers are read and written far sooner."""
    return cast("memoryview[float]", part(values, layout, *names).data)
