"""The curves of a page: few points where little happens, all points around the worst."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.messages import TEXT_LENGTH, legible

Array = NDArray[np.float64]

POINTS: Final = 2400
POINTS_INSIDE: Final = 700  # of a curve that stays inside its tube
CLOSE: Final = 250  # rows on each side of the worst, all kept


def curve(  # noqa: PLR0913 - all that a figure shows
    unit: str,
    runs: Mapping[str, Array],
    time: Array,
    worst: float,
    tube: tuple[Array, Array] | None = None,
    tolerance: float | None = None,
    points: int = POINTS,
) -> dict[str, Any]:
    """Return a column's curve for the page's script.

    Numbers are float32. All but the baseline are stored as differences from it, so that a narrow
    tube around a large value keeps its digits; where it has no value, they are stored as they are.
    """
    baseline, *others = runs.values()
    origin = np.nan_to_num(baseline, posinf=0.0, neginf=0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        differences = [values - origin for values in others]
        kept = _choose((baseline, *differences), int(np.argmin(np.abs(time - worst))), points)
        return {
            "unit": "" if unit == "1" else legible(unit, TEXT_LENGTH),
            "names": [legible(name, TEXT_LENGTH) for name in runs],
            "tolerance": tolerance,
            "worst": worst,
            "time": _encode(time[kept], "<f8"),
            "baseline": _encode(baseline[kept]),
            "runs": [_encode(values[kept]) for values in differences],
            "tube": tube and [_encode((edge - origin)[kept]) for edge in tube],
        }


def _choose(series: Sequence[Array], worst: int, points: int) -> NDArray[np.int64]:
    """Choose rows: the extremes of each series in each stretch, and all near the worst."""
    n = len(series[0])
    if n <= points:
        return np.arange(n)
    edges = np.linspace(0, n, points // (2 * len(series)) + 1).astype(np.int64)
    chosen = [np.array([0, n - 1]), np.arange(max(worst - CLOSE, 0), min(worst + CLOSE + 1, n))]
    for values in series:
        chosen.append(np.flatnonzero(~np.isfinite(values))[:CLOSE])
        clean = np.nan_to_num(values)
        pairs = [(clean[a:b].argmin() + a, clean[a:b].argmax() + a) for a, b in pairwise(edges)]
        chosen.append(np.ravel(pairs))
    return np.unique(np.concatenate(chosen))


def _encode(values: Array, kind: str = "<f4") -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")
