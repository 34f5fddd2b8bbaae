"""Reductions of a signal over time to one number.

Each function takes times (n,) [s], values (n,) and the criterion with its band, target and level,
and returns the number, or None if there is none. n is at least 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..definition.criteria import SignalCriterion

Array = NDArray[np.float64]
Reduction = Callable[[Array, Array, SignalCriterion], float | None]
AT_TARGET: Final = 1e-6  # share of the largest deviation within which a signal starts at its target
TIMES: Final = frozenset({"settle", "duration_above", "duration_below"})  # results in s


def _settle(time: Array, values: Array, criterion: SignalCriterion) -> float | None:
    """Time from the window's start until the signal stays in the band.

    If it ends outside, the row after the window's last: it settles then at the earliest.
    """
    target = values[-1] if criterion.target is None else criterion.target
    outside = np.flatnonzero(~(np.abs(values - target) <= (criterion.band or 0.0)))
    if not len(outside):
        return 0.0
    after = np.append(time, 2.0 * time[-1] - time[-2]) if len(time) > 1 else time
    return float(after[outside[-1] + 1] - time[0]) if len(after) > len(time) else None


def _overshoot(_time: Array, values: Array, criterion: SignalCriterion) -> float:
    """Largest deviation from the target on its far side, seen from the first value.

    A signal that starts at the target has no far side: its largest deviation counts.
    """
    target = values[-1] if criterion.target is None else criterion.target
    beyond = values - target
    if abs(beyond[0]) <= AT_TARGET * np.abs(beyond).max():
        return float(np.abs(beyond).max())
    return max(float((-np.sign(beyond[0]) * beyond).max()), 0.0)


def _duration(time: Array, inside: NDArray[np.bool_]) -> float:
    """Total time of the steps that begin inside."""
    return float(np.diff(time)[inside[:-1]].sum())


REDUCE: Final[Mapping[str, Reduction]] = MappingProxyType(
    {
        "max": lambda _t, x, _c: float(x.max()),
        "min": lambda _t, x, _c: float(x.min()),
        "peak": lambda _t, x, _c: float(np.abs(x).max()),
        "mean": lambda _t, x, _c: float(x.mean()),
        "rms": lambda _t, x, _c: float(np.sqrt(np.mean(x**2))),
        "final": lambda _t, x, _c: float(x[-1]),
        "range": lambda _t, x, _c: float(x.max() - x.min()),
        "settle": _settle,
        "overshoot": _overshoot,
        "duration_above": lambda t, x, c: _duration(t, x > (c.level or 0.0)),
        "duration_below": lambda t, x, c: _duration(t, x < (c.level or 0.0)),
    }
)

__all__ = ["REDUCE", "TIMES"]
