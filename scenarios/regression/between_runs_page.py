"""The page of a comparison of runs: tables, and curves of all runs overlaid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..judging.criterion import Criterion, bound_text, margin_text, quantity
from .between_runs import CriterionRow, Row, RunComparison, SignalRow
from .between_runs_view import view_parts
from .guards import measure, short
from .templating import DASH, fill, number

Array = NDArray[np.float64]

TEMPLATE: Final = "between_runs_template.html"
FIGURES: Final = 12
ALIKE: Final = 2  # figures of one signal's elements
WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 620, 220, 100, 10, 22  # of a figure [px]
BUCKETS: Final = 300  # stretches of a curve; each keeps its smallest and largest value


def page(comparison: RunComparison) -> str:
    """Return the page; all text in it is escaped."""
    first, *others = comparison.names
    content = {
        "names": comparison.names,
        "first": first,
        "others": others,
        "identical": comparison.identical,
        "parameters": [_values(row) for row in comparison.parameters],
        "criteria": [_criterion(row) for row in comparison.criteria],
        "metrics": [_values(row) for row in comparison.metrics],
        "signals": [_signal(row) for row in comparison.signals],
        "missing": comparison.missing,
        "figures": [_figure(row, comparison) for row in _varied(comparison.signals)],
        "size": (WIDTH, HEIGHT),
        "view": view_parts(comparison),
    }
    return fill(TEMPLATE, content)


def _values(row: Row) -> tuple[str, ...]:
    return (row.name, *map(number, row.values))


def _criterion(row: CriterionRow) -> tuple[str, ...]:
    bound = next(bound_text(c) for c in row.judged if c is not None)
    return (row.name, bound, *map(judged_text, row.judged))


def judged_text(criterion: Criterion | None) -> str:
    """Format the measured value and its margin."""
    if criterion is None:
        return DASH
    if not criterion.measured:
        return f"not measured: {criterion.reason}"
    missed = "" if criterion.ok else ", missed"
    value = quantity(criterion.value, criterion.unit)
    return f"{value} ({margin_text(criterion)}{missed})"


def _signal(row: SignalRow) -> tuple[str, ...]:
    told = [
        f"{measure(d, row.unit)} at {t:.3f} s" for d, t in zip(row.largest, row.times, strict=True)
    ]
    return (row.name, f"{row.share:.2%}", *told)


def _varied(rows: Sequence[SignalRow]) -> list[SignalRow]:
    """Return the first rows, limiting the elements per signal."""
    counts: Counter[str] = Counter()
    kept = []
    for row in rows:
        counts[row.name.partition("[")[0]] += 1
        if counts[row.name.partition("[")[0]] <= ALIKE:
            kept.append(row)
    return kept[:FIGURES]


def _figure(row: SignalRow, comparison: RunComparison) -> dict[str, Any]:
    """Return a figure: one SVG path per run, and the numbers at its corners."""
    curves = [(r.time, r[row.name]) for r in comparison.recordings]
    values = np.concatenate([v[np.isfinite(v)] for _, v in curves])
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    end = max(float(t[-1]) if len(t) else 0.0 for t, _ in curves) or 1.0
    pad = (high - low) * 0.05 or abs(high) * 0.05 or 1.0
    return {
        "name": row.name,
        "text": "; ".join(_signal(row)[2:]),
        "meaning": comparison.recordings[0].descriptions.get(row.name, ""),
        "unit": "" if row.unit == "1" else row.unit,
        "paths": [_path(t, v, low - pad, high + pad, end) for t, v in curves],
        "low": short(low),
        "high": short(high),
        "end": f"{end:g} s",
        "box": (LEFT, TOP, WIDTH - LEFT, HEIGHT - TOP - BOTTOM),
    }


def _path(time: Array, values: Array, low: float, high: float, end: float) -> str:
    rows = _extremes(values)
    x = LEFT + time[rows] / end * (WIDTH - LEFT)
    y = HEIGHT - BOTTOM - (values[rows] - low) / (high - low) * (HEIGHT - TOP - BOTTOM)
    text, pen = "", "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not np.isfinite(b):
            pen = "M"
            continue
        text += f"{pen}{a:.1f} {b:.1f}"
        pen = "L"
    return text


def _extremes(values: Array) -> NDArray[np.int64]:
    """Return the rows of each stretch's smallest and largest value."""
    if len(values) <= 2 * BUCKETS:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), BUCKETS + 1).astype(np.int64)
    clean = np.nan_to_num(values)
    pairs = pairwise(edges)
    rows = [[a + clean[a:b].argmin(), a + clean[a:b].argmax()] for a, b in pairs]
    return np.unique(np.array([0, *np.ravel(rows), len(values) - 1], dtype=np.int64))


__all__ = ["judged_text", "number", "page"]
