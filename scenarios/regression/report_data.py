"""The curves of a report: few points where little happens, all points around the worst."""

from __future__ import annotations

import base64
import math
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..definition.tolerances import Tolerances
from ..recording import Recording
from .compare import Deviation, tube_of
from .reference import Reference

Array = NDArray[np.float64]

POINTS: Final = 2400  # of a curve that leaves its tube
POINTS_INSIDE: Final = 700  # of one that stays inside
CLOSE: Final = 250  # ticks on each side of the worst, all kept
_PER_BUCKET = 4  # points per stretch of a curve


def curve(
    deviation: Deviation, recording: Recording, reference: Reference, tolerances: Tolerances
) -> dict[str, Any]:
    """Return a column's curve for the report's script.

    Numbers are float32. All but the reference are stored as differences from it, so that a narrow
    tube around a large value keeps its digits.

    Args:
        deviation: The column and its worst point.
        recording: Of the run.
        reference: Its reference.
        tolerances: The scenario's.
    """
    expected = reference.values[deviation.name]
    lower, upper = tube_of(deviation.name, reference, tolerances)
    found = _on_ticks(recording, deviation.name, reference)
    worst = min(max(round(deviation.time / reference.step_size), 0), reference.rows - 1)
    points = POINTS_INSIDE if deviation.ok else POINTS
    kept = _choose(found - expected, expected, worst, points)
    return {
        "name": deviation.name,
        "unit": deviation.unit,
        "tolerance": deviation.tolerance,
        "share": deviation.share if math.isfinite(deviation.share) else None,
        "worst": deviation.time,
        "step": reference.step_size,
        "ticks": _encode(kept.astype("<u4")),
        "reference": _encode(expected[kept].astype("<f4")),
        "actual": _encode((found - expected)[kept].astype("<f4")),
        "lower": _encode((lower - expected)[kept].astype("<f4")),
        "upper": _encode((upper - expected)[kept].astype("<f4")),
    }


def _on_ticks(recording: Recording, name: str, reference: Reference) -> Array:
    """Return a column at the reference's ticks, NaN if it has no value there."""
    ticks = np.round(np.nan_to_num(recording.time, nan=-1.0) / reference.step_size)
    inside = (ticks >= 0) & (ticks < reference.rows)
    found = np.full(reference.rows, np.nan)
    found[ticks[inside].astype(np.int64)] = recording[name][inside]
    return found


def _choose(error: Array, expected: Array, worst: int, points: int) -> NDArray[np.int64]:
    """Choose ticks: the extremes of each stretch, and all near the worst."""
    n = len(error)
    if n <= points:
        return np.arange(n)
    edges = np.linspace(0, n, points // _PER_BUCKET + 1).astype(np.int64)
    near = np.arange(max(worst - CLOSE, 0), min(worst + CLOSE + 1, n))
    chosen = [np.array([0, worst, n - 1]), near, np.flatnonzero(~np.isfinite(error))[:CLOSE]]
    for values in (np.nan_to_num(error), expected):
        for first, last in pairwise(edges):
            part = values[first:last]
            chosen.append(first + np.array([part.argmin(), part.argmax()]))
    return np.unique(np.concatenate(chosen))


def _encode(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")


__all__ = ["curve"]
