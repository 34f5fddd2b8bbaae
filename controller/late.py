"""Commands of the last updates, with which late readings are compared."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

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
