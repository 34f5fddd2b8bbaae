"""Fewer rows of a long run to show, with no peak lost.

A picture draws each curve through rows of its own. On a page all curves share their instants: of a
run of more than `ALL_ROWS` rows, every k-th pose is kept, and the smallest and largest value of
each curve in each of `STRETCHES` stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..assets.fields import Array

ALL_ROWS: Final = 30_001  # 30 s at 1 ms
POSES: Final = 120_000  # of a longer run
STRETCHES: Final = 4_000  # of a longer run's curves; each gives two points
CLOSE: Final = 250  # rows on each side of one that matters, all drawn
NOISE: Final = 1e-12  # a curve that stays below is rounding noise: it is shown as 0, or left out


def drawn_rows(series: Sequence[Array], count: int, around: int | None = None) -> NDArray[np.intp]:
    """Return about `count` rows to draw curves (n,) through, which share their instants.

    They are both ends, the extremes of each curve in each stretch, the first ones that are not
    finite, and all those `around` a row that matters.
    """
    n = len(series[0])
    if n <= count:
        return np.arange(n)
    chosen = [0, n - 1]
    if around is not None:
        chosen += range(max(around - CLOSE, 0), min(around + CLOSE + 1, n))
    stretches = [*pairwise(np.linspace(0, n, count // len(series) // 2 + 1).astype(int))]
    for values in series:
        chosen += np.flatnonzero(~np.isfinite(values))[:CLOSE].tolist()
        finite = np.nan_to_num(values)
        for begin, end in stretches:
            part = finite[begin:end]
            chosen += [begin + int(part.argmin()), begin + int(part.argmax())]
    return np.unique(chosen)


@dataclass(frozen=True)
class Thinning:
    """The kept rows of a run: all, or poses at regular rows and curves by stretches."""

    time: Array  # instants of all rows (n,) [s]
    every: int = 1  # rows from one pose to the next; the last row is kept, too
    edges: NDArray[np.int64] | None = None  # rows between stretches of curves; None: all are kept

    @classmethod
    def of(cls, time: Array) -> Thinning:
        """Choose the rows to keep of a run with these instants (n,) [s]."""
        if len(time) <= ALL_ROWS:
            return cls(time)
        edges = np.linspace(0, len(time), STRETCHES + 1).astype(np.int64)
        return cls(time, -(-len(time) // POSES), edges)

    @property
    def curve_time(self) -> Array:
        """Instants of the curves' points (k,) [s]."""
        if self.edges is None:
            return self.time
        first, middle = self.edges[:-1], (self.edges[:-1] + self.edges[1:] - 1) // 2
        return np.asarray(self.time[np.ravel(np.column_stack((first, middle)))])

    def poses(self, values: Array) -> Array:
        """Return the rows (k, ...) of poses."""
        if self.every == 1:
            return values
        return np.concatenate((values[: -1 : self.every], values[-1:]))

    def curve(self, values: Array) -> Array:
        """Return a column's points (k,): all, or minimum and maximum of each stretch, in order."""
        if self.edges is None:
            return values
        first = self.edges[:-1]
        low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
        rising = values[first] <= (low + high) / 2
        pairs = np.column_stack((np.where(rising, low, high), np.where(rising, high, low)))
        return np.ravel(pairs)

    def words(self) -> str:
        """Describe what was left out, or ""."""
        if self.edges is None:
            return ""
        span = 1e3 * float(self.time[-1] - self.time[0])  # [ms]
        return (
            f"Thinned from {len(self.time)} rows: poses every "
            f"{span * self.every / (len(self.time) - 1):.3g} ms, linear in between; curves show "
            f"the least and the greatest value of every {span / STRETCHES:.3g} ms. Paths are drawn "
            "around the present."
        )
