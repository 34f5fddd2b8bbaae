"""The page of a comparison of runs: tables, and curves of all runs overlaid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..judging.criterion import Criterion, bound_text, margin_text, quantity
from .between_runs import CriterionRow, Extent, Row, RunComparison, SignalRow
from .between_runs_view import view_parts
from .guards import measure, precise, short
from .templating import DASH, fill, numbers

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
        "state": "bad" if comparison.unmet else "good" if comparison.identical else "",
        "verdict": verdict(comparison),
        "extents": extent_rows(comparison),
        "parameters": [_values(row) for row in comparison.parameters],
        "criteria": [_criterion(row) for row in comparison.criteria],
        "metrics": [_values(row) for row in comparison.metrics],
        "signals": [_signal(row) for row in comparison.signals],
        "missing": comparison.missing,
        "other_units": comparison.other_units,
        "figures": [_figure(row, comparison) for row in _varied(comparison.signals)],
        "size": (WIDTH, HEIGHT),
        "view": view_parts(comparison),
    }
    return fill(TEMPLATE, content)


def verdict(comparison: RunComparison) -> str:
    """Say in a sentence or two what was compared, and what came of it."""
    if comparison.identical:
        result = "All recorded signals are equal"
    else:
        count = len(comparison.signals)
        result = f"{count or 'None'} of the compared columns differ{'s' if count < 2 else ''}"
        result += "" if count else ", but the runs are not the same"
    begin, end = precise(comparison.begin), precise(comparison.end)
    extent = f"{comparison.columns} columns, {comparison.rows} rows, from {begin} to {end} s"
    return f"{result}. Compared: {extent}."


def extent_rows(comparison: RunComparison) -> list[tuple[str, ...]]:
    """Return the rows of a table: span, number of rows and end of each run."""
    rows: dict[str, Callable[[Extent], str]] = {
        "span": lambda e: f"{precise(e.begin)} to {precise(e.end)} s",
        "rows": lambda e: str(e.rows),
        "ended": lambda e: "complete" if e.complete else f"early: {e.reason}",
    }
    return [(name, *map(text, comparison.extents)) for name, text in rows.items()]


def _values(row: Row) -> tuple[str, ...]:
    return (row.name, *numbers(row.values))


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
    return (row.name, percent(row.share), *told)


def percent(share: float) -> str:
    """Format a share in percent."""
    return f"{short(100.0 * share)} %"


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


__all__ = ["extent_rows", "judged_text", "page", "percent", "verdict"]
