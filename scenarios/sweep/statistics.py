"""Statistics of a results table: shares with bounds, sensitivities, and which values fail."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, rankdata

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CONFIDENCE: Final = 0.95
Z: Final = 1.959963984540054  # its quantile of the normal distribution
DEPTH: Final = 3  # of the tree
_CUTS: Final = 31  # tried for each key
_SMALLEST: Final = 0.01  # least share of all rows in a leaf
_PURE: Final = 0.98  # share of failures from which a leaf is not divided


def share_bounds(count: int, total: int) -> tuple[float, float]:
    """Bounds of a probability by Clopper and Pearson, at `CONFIDENCE`.

    Args:
        count: Number of events.
        total: Number of trials.
    """
    if not total:
        return 0.0, 1.0
    found = binomtest(count, total).proportion_ci(CONFIDENCE, "exact")
    return float(found.low), float(found.high)


@dataclass(frozen=True)
class Influence:
    """Influence of a varied value on a result.

    Attributes:
        key: Which value.
        value: Rank correlation.
        low: Lower bound at `CONFIDENCE`.
        high: Upper bound.
    """

    key: str
    value: float
    low: float
    high: float


def rank_correlations(values: Mapping[str, Array], result: Array) -> list[Influence]:
    """Spearman's rank correlation of each value with a result, the strongest first.

    Ref: Bonett and Wright, Sample size requirements for estimating Pearson, Kendall and Spearman
    correlations, 2000: the variance of its Fisher transform is (1 + r^2/2) / (n - 3).
    """
    known = np.isfinite(result)
    ranks, count = rankdata(result[known]), int(known.sum())
    found = []
    if count > 4 and np.ptp(ranks) > 0:
        for key, column in values.items():
            if np.ptp(column[known]) > 0:
                r = float(np.corrcoef(rankdata(column[known]), ranks)[0, 1])
                width = Z * math.sqrt((1 + r * r / 2) / (count - 3))
                middle = math.atanh(max(min(r, 1 - 1e-12), -1 + 1e-12))
                low, high = math.tanh(middle - width), math.tanh(middle + width)
                found.append(Influence(key, r, low, high))
    return sorted(found, key=lambda each: -abs(each.value))


Condition = tuple[str, str, float]  # key, "<=" or ">", and the bound


@dataclass(frozen=True)
class Leaf:
    """Rows that meet some conditions.

    Attributes:
        rule: The conditions in words; "" for all rows.
        rows: Number of rows.
        bad: Number of failures among them.
        share: `bad` as a share of all failures.
    """

    rule: str
    rows: int
    bad: int
    share: float


def failure_tree(
    values: Mapping[str, Array], bad: Flags, units: Mapping[str, str] | None = None
) -> list[Leaf]:
    """Divide the rows by at most `DEPTH` cuts to separate failures from the rest.

    Args:
        values: Numbers by key, each (n,).
        bad: Which rows fail (n,).
        units: Units by key, as far as they are known.

    Returns:
        The leaves with failures, the most failures first.
    """
    found: list[tuple[tuple[Condition, ...], int, int]] = []
    if bad.any():
        smallest = max(int(_SMALLEST * len(bad)), 1)
        _divide(values, bad, np.arange(len(bad)), (), smallest, found)
    leaves = [
        Leaf(_rule(conditions, units or {}), rows, failing, failing / int(bad.sum()))
        for conditions, rows, failing in found
        if failing
    ]
    return sorted(leaves, key=lambda leaf: -leaf.bad)


def _divide(  # noqa: PLR0913 - a recursion
    values: Mapping[str, Array],
    bad: Flags,
    rows: NDArray[np.intp],
    conditions: tuple[Condition, ...],
    smallest: int,
    found: list[tuple[tuple[Condition, ...], int, int]],
) -> None:
    failing = int(bad[rows].sum())
    cut = None
    if len(conditions) < DEPTH and 0 < failing < _PURE * len(rows):
        cut = _best_cut(values, bad, rows, smallest)
    if cut is None:
        found.append((conditions, len(rows), failing))
        return
    key, at = cut
    below = values[key][rows] <= at
    for side, sign in ((below, "<="), (~below, ">")):
        _divide(values, bad, rows[side], (*conditions, (key, sign, at)), smallest, found)


def _best_cut(
    values: Mapping[str, Array], bad: Flags, rows: NDArray[np.intp], smallest: int
) -> tuple[str, float] | None:
    """Return the cut that lowers Gini impurity most; None: none does."""
    best, found = 1e-3 * _impurity(len(rows), int(bad[rows].sum())), None
    before = _impurity(len(rows), int(bad[rows].sum()))
    for key, column in values.items():
        here, failing = column[rows], bad[rows]
        for at in _cuts(here):
            below = here <= at
            count, count_bad = int(below.sum()), int(failing[below].sum())
            other, other_bad = len(rows) - count, int(failing.sum()) - count_bad
            if min(count, other) >= smallest:
                gain = before - _impurity(count, count_bad) - _impurity(other, other_bad)
                if gain > best:
                    best, found = gain, (key, float(at))
    return found


def _cuts(column: Array) -> Array:
    """Midpoints between neighbours if these are few, else quantiles."""
    distinct = np.unique(column[:: max(len(column) // 20_000, 1)])
    if len(distinct) <= 4 * _CUTS:
        return (distinct[1:] + distinct[:-1]) / 2
    return np.quantile(distinct, np.linspace(0, 1, 4 * _CUTS + 2)[1:-1])


def _impurity(count: int, bad: int) -> float:
    return 2.0 * bad * (count - bad) / count if count else 0.0


def _rule(conditions: Sequence[Condition], units: Mapping[str, str]) -> str:
    """Write conditions with units; of two on one side of a key, only the tighter."""
    tightest: dict[tuple[str, str], float] = {}
    for key, sign, at in conditions:
        tighter: Any = min if sign == "<=" else max
        tightest[key, sign] = tighter(at, tightest.get((key, sign), at))
    return " and ".join(
        f"{key} {sign} {at:.3g} {units.get(key, '')}".rstrip()
        for (key, sign), at in sorted(tightest.items())
    )


__all__ = ["Influence", "Leaf", "failure_tree", "rank_correlations", "share_bounds"]
