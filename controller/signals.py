"""What the controller reads and writes, its last commands, and the protocol of its laws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from ..assets.fields import Layout, Vector, Views, as_arrays, layouts
from .gains import Gains

INPUTS, OUTPUTS, TRUTH, READINGS = layouts(__file__)  # the last two of the sensors


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
