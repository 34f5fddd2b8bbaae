"""Rows and failures by value: what the report's bars and cells show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .results import Results, value_names
from .statistics import number_text, share_bounds

Array = NDArray[np.float64]

BINS: Final = (6, 24)  # of a marginal: fewest and most
CELLS: Final = (5, 14)  # of a heat map, each way
IN_A_BIN: Final = 12  # least mean number of rows per bin
MOST_VALUES: Final = 60  # that have a bar each


@dataclass(frozen=True, eq=False)
class Axis:
    """The parts of a value's range: each value by itself, or bins."""

    starts: Array  # where each part begins (m,)
    ends: Array  # a row at an inner edge of two bins is in the upper one (m,)
    names: list[str]  # what is in each part
    ticks: list[str]  # what is written beside it: the value, or both ends of all bins
    part: NDArray[np.intp]  # of each row (n,)

    @classmethod
    def of(cls, results: Results, key: str, bins: int, *, is_grid: bool) -> Axis:
        """Divide a value's range, into bins if it has too many values.

        Of a grid, few rows, too, have a part for each value.
        """
        column = results.values[key]
        values, part = np.unique(column, return_inverse=True)
        few = is_grid or 2 * len(values) <= len(column) or len(values) == 1
        if key in results.labels or (few and len(values) <= MOST_VALUES):
            half = _half_widths(values)
            names = results.labels.get(key) or value_names(values.tolist())
            return cls(values - half, values + half, names, names, part)
        edges = _edges(float(values[0]), float(values[-1]), bins)
        part = np.clip(np.searchsorted(edges, column, "right") - 1, 0, bins - 1)
        texts = [f"{v:.3g}" for v in edges[[0, -1]]]
        texts[1:1] = [number_text(v) for v in edges[1:-1].tolist()]
        names = [f"{low} to {high}" for low, high in pairwise(texts)]
        ticks = [texts[0], *[""] * (bins - 2), texts[-1]]
        return cls(edges[:-1], edges[1:], names, ticks, part)

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(self.names)

    def drawn(self) -> dict[str, Any]:
        """Return the parts as the page draws them."""
        return {
            "starts": self.starts.tolist(),
            "ends": self.ends.tolist(),
            "names": self.names,
            "ticks": self.ticks,
        }


def _half_widths(values: Array) -> Array:
    """Return half the width of a bar at each value, so that none reaches its neighbours."""
    if len(values) == 1:
        return np.maximum(np.abs(values), 1.0) / 2
    gaps = np.diff(values)
    half: Array = 0.4 * np.minimum(np.append(gaps, gaps[-1]), np.insert(gaps, 0, gaps[0]))
    return half


def _edges(low: float, high: float, bins: int) -> Array:
    """Return the ends, and inner edges of few digits."""
    edges = np.linspace(low, high, bins + 1)
    edges[1:-1] = np.round(edges[1:-1], math.ceil(1 - math.log10((high - low) / bins)))
    return edges


def _between(number: float, ends: tuple[int, int]) -> int:
    return int(min(max(number, ends[0]), ends[1]))


def marginal(results: Results, key: str, *, is_grid: bool, bounds: bool) -> dict[str, Any]:
    """Return rows and failures by value; with the bounds of their share, if rows are samples."""
    axis = Axis.of(results, key, _between(len(results.bad) / IN_A_BIN, BINS), is_grid=is_grid)
    rows = np.bincount(axis.part, minlength=len(axis))
    bad = np.bincount(axis.part[results.bad], minlength=len(axis))
    pairs = zip(bad.tolist(), rows.tolist(), strict=True)
    shares = [share_bounds(k, n) for k, n in pairs] if bounds else []
    return {
        **axis.drawn(),
        "rows": rows.tolist(),
        "bad": bad.tolist(),
        "bounds": [[round(low, 4), round(high, 4)] for low, high in shares],
    }


def heat_map(results: Results, first: str, second: str, *, is_grid: bool) -> dict[str, Any]:
    """Return rows and failures in the cells of two values, those of `first` one after the other."""
    bins = _between(math.sqrt(len(results.bad) / IN_A_BIN), CELLS)
    x, y = (Axis.of(results, key, bins, is_grid=is_grid) for key in (first, second))
    cell, cells = x.part * len(y) + y.part, len(x) * len(y)
    return {
        "keys": [first, second],
        "names": [x.names, y.names],
        "ticks": [x.ticks, y.ticks],
        "rows": np.bincount(cell, minlength=cells).tolist(),
        "bad": np.bincount(cell[results.bad], minlength=cells).tolist(),
    }
