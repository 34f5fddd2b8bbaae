"""What the controller reads and writes, its last commands, and the protocol of its laws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import SimpleNamespace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from ..assets.fields import as_arrays
from .gains import Gains

Vector = NDArray[np.float64]
Layout = np.dtype[np.void]
Views = SimpleNamespace  # arrays by name

# The fields' order is that of the flat buffers. Poses and twists are those of the hand body's
# origin in the world frame, quaternions (w, x, y, z); units are in the FMU's table.
INPUTS = np.dtype(
    [
        ("pos_cmd", float, 3),
        ("quat_cmd", float, 4),
        ("vel_cmd", float, 3),
        ("omega_cmd", float, 3),
        ("grip_cmd", float),
        ("posture_cmd", float, 7),
        ("posture_vel_cmd", float, 7),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("jac", float, (6, 7)),
        ("qpos", float, 7),
        ("qvel", float, 7),
        ("qfrc_bias", float, 7),
        ("actuator_force", float, 8),
        ("force_cmd", float, 3),
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
        ("external_torque", float, 7),
        ("external_force", float, 6),
        ("joint_contact", float, 7),
        ("motor_torque", float, 7),
    ]
)


class Law(ABC):
    """A control law: how the inputs become servo targets of the arm.

    It gets the controller's period [s] and named views of `INPUTS`, `OUTPUTS` and its own `STATE`
    (see `Buffer`), which it reads and writes in place. The `STATE` is what it keeps from one update
    to the next: fields of 64-bit floats only, so that it can be saved and restored as bytes.
    """

    STATE: ClassVar[Layout]

    def __init__(self, inputs: Views, outputs: Views, state: Views, period: float) -> None:
        self._inputs, self._outputs, self._state = inputs, outputs, state
        self._period = period

    def set_gains(self, gains: Gains) -> None:
        """Change the gains; allowed between any two updates."""
        self._gains = as_arrays(gains)

    @abstractmethod
    def start(self) -> None:
        """Start from the present inputs, whatever state and outputs hold."""

    @abstractmethod
    def update(self) -> None:
        """Compute the outputs of one period, except for the gripper's target."""


class Buffer:
    """A flat array (n,), `values`, with named fields of 64-bit floats.

    The fields share its memory: by name for users of the controller, `record["qpos"] = q`, and as
    attributes, `views.qpos[:] = q`. A scalar field is an array of shape ().
    """

    def __init__(self, layout: Layout, values: Vector | None = None) -> None:
        self.values = np.zeros(layout.itemsize // 8) if values is None else values
        rows = self.values.view(layout)
        self.record: Any = rows[0]
        self.views = _views(rows)


def _views(rows: NDArray[Any]) -> Views:
    """Return the fields of a structured array (1,) as attributes."""
    fields = {name: rows[name] for name in rows.dtype.names or ()}
    return SimpleNamespace(
        **{
            name: _views(field) if field.dtype.names else field.reshape(field.shape[1:])
            for name, field in fields.items()
        }
    )


KEPT: Final = 20  # updates: the largest `reading_delay` by the smallest period


class Late:
    """A vector (n,) of each of the last updates, the latest first, in a law's state (KEPT, n)."""

    def __init__(self, rows: NDArray[np.float64], reading_delay: float, period: float) -> None:
        self._rows, self._age = rows, round(reading_delay / period)  # [updates]

    def reset(self, now: Vector) -> None:
        """Start as if the vector had been the same before."""
        self._rows[:] = now

    def recall(self, now: Vector) -> Vector:
        """Keep this update's vector, and return that of the time when the readings were taken."""
        if self._age == 0:
            return now
        due: Vector = self._rows[self._age - 1].copy()
        self._rows[1:] = self._rows[:-1].copy()
        self._rows[0] = now
        return due
