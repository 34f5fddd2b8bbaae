"""Chooses the rows of a recording for the page, and describes the choice.

Up to `ALL_ROWS` rows, all are kept. Of a longer run, every k-th pose is kept, and the smallest and
largest value of each curve in each of `STRETCHES` stretches, so that no peak is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ALL_ROWS: Final = 30_001  # 30 s at 1 ms
POSES: Final = 120_000  # of a longer run
STRETCHES: Final = 4_000  # of a longer run's curves; each gives two points


@dataclass(frozen=True)
class Thinning:
    """The kept rows of a run.

    Attributes:
        time: Instants of all rows (n,) [s].
        every: Rows from one pose to the next.
        stretches: Number of stretches of curves; 0: all rows are kept.
    """

    time: Array
    every: int = 1
    stretches: int = 0

    @classmethod
    def of(cls, time: Array) -> Thinning:
        """Choose the rows to keep of a run with these instants (n,) [s]."""
        if len(time) <= ALL_ROWS:
            return cls(time)
        return cls(time, every=-(-len(time) // POSES), stretches=STRETCHES)

    @property
    def pose_time(self) -> Array:
        """Instants of the poses (k,) [s]; the last row is among them."""
        return self.poses(self.time)

    @property
    def curve_time(self) -> Array:
        """Instants of the curves' points (k,) [s]."""
        if not self.stretches:
            return self.time
        first, end = self._edges()
        return np.ravel(np.column_stack((self.time[first], self.time[(first + end - 1) // 2])))

    def poses(self, values: Array) -> Array:
        """Return the rows (k, ...) of poses."""
        if self.every == 1:
            return values
        return np.concatenate((values[: -1 : self.every], values[-1:]))

    def curve(self, values: Array) -> Array:
        """Return a column's points (k,): all, or minimum and maximum of each stretch, in order."""
        if not self.stretches:
            return values
        first, _ = self._edges()
        low = np.minimum.reduceat(values, first)
        high = np.maximum.reduceat(values, first)
        rising = values[first] <= (low + high) / 2
        pairs = np.column_stack((np.where(rising, low, high), np.where(rising, high, low)))
        return np.ravel(pairs)

    def _edges(self) -> tuple[Any, Any]:
        """Return the first and end row of each stretch."""
        edges = np.linspace(0, len(self.time), self.stretches + 1).astype(np.int64)
        return edges[:-1], edges[1:]

    def words(self) -> str:
        """Describe what was left out, or ""."""
        if not self.stretches:
            return ""
        span = float(self.time[-1] - self.time[0])
        return (
            f"Thinned from {len(self.time)} rows: poses every "
            f"{1e3 * span * self.every / (len(self.time) - 1):.3g} ms, linear in between; curves "
            f"show the least and the greatest value of every "
            f"{1e3 * span / self.stretches:.3g} ms. Paths are drawn around the present."
        )


def describe_time(time: Array) -> dict[str, Any]:
    """Return instants for the page: start and step if evenly spaced, else all."""
    if len(time) < 2:
        return {"start": float(time[0]) if len(time) else 0.0, "step": 0.001, "rows": len(time)}
    step = float(time[-1] - time[0]) / (len(time) - 1)
    even = time[0] + step * np.arange(len(time))
    if step > 0 and np.abs(time - even).max() < 1e-7:
        return {"start": float(time[0]), "step": step, "rows": len(time)}
    from .columns import encode  # noqa: PLC0415 - rarely needed

    return {"rows": len(time), "block": encode([time], [1e-6])}
