"""Statistics of a results table: shares with bounds, influences, and which values fail."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, kruskal, rankdata

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Labels = Mapping[str, Sequence[str]]

CONFIDENCE: Final = 0.95
FEWEST: Final = 10  # rows of which correlations are given
Z: Final = 1.959963984540054  # its quantile of the normal distribution
DEPTH: Final = 3  # of the tree
_CUTS: Final = 124  # tried for each key
_SMALLEST: Final = 0.01  # least share of all rows in a leaf
_PURE: Final = 0.98  # share of failures from which a leaf is not divided


def share_bounds(count: int, total: int) -> tuple[float, float]:
    """Bounds of a probability by Clopper and Pearson, at `CONFIDENCE`, after events in trials."""
    if not total:
        return 0.0, 1.0
    bounds = binomtest(count, total).proportion_ci(CONFIDENCE, "exact")
    return float(bounds.low), float(bounds.high)


def lower_bound(count: int, total: int, confidence: float) -> float:
    """Return the one-sided lower bound of a probability by Clopper and Pearson."""
    test = binomtest(count, total, alternative="greater")
    return float(test.proportion_ci(confidence, "exact").low)


@dataclass(frozen=True)
class Influence:
    """Influence of a varied value on a result."""

    key: str
    value: float  # Spearman's rank correlation, -1 to 1; of words the correlation ratio, 0 to 1
    low: float | None = None  # bound of a rank correlation at `CONFIDENCE`; None: words
    high: float | None = None


def influences(values: Mapping[str, Array], labels: Labels, result: Array) -> list[Influence]:
    """Return the influence of each value that varies, the strongest first; none of few rows.

    Values are given by key (n,), those of words as their numbers in `labels`. A result of -inf
    ranks lowest, and NaN leaves the row out (n,).
    """
    known = ~np.isnan(result)
    ranks = rankdata(result[known])
    if len(ranks) < FEWEST or np.ptp(ranks) == 0:
        return []
    strengths = [
        _of_words(key, column[known], ranks)
        if key in labels
        else _of_numbers(key, rankdata(column[known]), ranks)
        for key, column in values.items()
        if len(np.unique(column[known])) > 1
    ]
    return sorted(strengths, key=lambda each: -abs(each.value))


def _of_numbers(key: str, ranks: Array, result: Array) -> Influence:
    """Correlate ranks.

    Ref: Bonett and Wright, Sample size requirements for estimating Pearson, Kendall and Spearman
    correlations, 2000: the variance of its Fisher transform is (1 + r^2/2) / (n - 3). That of 1 is
    infinite, so its bounds are those of the next lower correlation, with two neighbours swapped.
    """
    count, r = len(ranks), float(np.corrcoef(ranks, result)[0, 1])
    most = 1 - max(12 / (count * (count**2 - 1)), 1e-15)
    middle = math.atanh(max(min(r, most), -most))
    width = Z * math.sqrt((1 + r * r / 2) / (count - 3))
    return Influence(key, r, min(r, math.tanh(middle - width)), max(r, math.tanh(middle + width)))


def _of_words(key: str, codes: Array, result: Array) -> Influence:
    """Return the root of the share of the ranks' variance that lies between words.

    Ref: Tomczak and Tomczak, The need to report effect size estimates revisited, 2014: of
    Kruskal and Wallis's H it is (H - k + 1) / (n - k).
    """
    groups = [result[codes == code] for code in np.unique(codes)]
    freedom = len(codes) - len(groups)
    share = (kruskal(*groups).statistic - len(groups) + 1) / freedom if freedom else 0.0
    return Influence(key, math.sqrt(max(float(share), 0.0)))


@dataclass(frozen=True)
class Leaf:
    """Rows that meet some conditions."""

    rule: str  # the conditions in words, which select exactly these rows; "" for all rows
    rows: int
    bad: int  # failures among them
    share: float  # `bad` as a share of all failures


def failure_tree(
    values: Mapping[str, Array], labels: Labels, bad: Flags, units: Mapping[str, str]
) -> list[Leaf]:
    """Divide the rows by at most `DEPTH` cuts to separate failures from the rest.

    Values are given by key (n,), those of words as their numbers in `labels`. The leaves with
    failures are returned, the most failures first.
    """
    smallest = max(int(_SMALLEST * len(bad)), 1)
    leaves = []

    def divide(rows: NDArray[np.intp], rule: Mapping[tuple[str, str], str], depth: int) -> None:
        here, failing = {key: column[rows] for key, column in values.items()}, bad[rows]
        is_mixed = depth and 0 < failing.sum() < _PURE * len(rows)
        if is_mixed and (cut := _best_cut(here, labels, failing, smallest)):
            key, below = cut
            high, low = float(here[key][~below].min()), float(here[key][below].max())
            for side, sign in ((~below, ">"), (below, "<=")):
                if words := labels.get(key):
                    codes = np.unique(here[key][side]).astype(int)
                    more = {(key, "="): " or ".join(words[code] for code in codes)}
                else:
                    bound = number_text(short_between(low, high))
                    more = {(key, sign): f"{bound} {units.get(key, '')}".rstrip()}
                divide(rows[side], {**rule, **more}, depth - 1)
        elif failing.any():
            text = " and ".join(f"{key} {sign} {at}" for (key, sign), at in sorted(rule.items()))
            share = failing.sum() / bad.sum()
            leaves.append(Leaf(text, len(rows), int(failing.sum()), share))

    divide(np.arange(len(bad)), {}, DEPTH)
    return sorted(leaves, key=lambda leaf: -leaf.bad)


def _best_cut(
    values: Mapping[str, Array], labels: Labels, bad: Flags, smallest: int
) -> tuple[str, Flags] | None:
    """Return the key and the side of the cut that lowers Gini impurity most; None: none does."""
    before = _impurity(len(bad), int(bad.sum()))
    best, cut = 1e-3 * before, None
    for key, column in values.items():
        scores = _by_share(column, bad) if key in labels else column
        for at in _cuts(scores):
            below = scores <= at
            count, count_bad = int(below.sum()), int(bad[below].sum())
            other, other_bad = len(bad) - count, int(bad.sum()) - count_bad
            if min(count, other) >= smallest:
                gain = before - _impurity(count, count_bad) - _impurity(other, other_bad)
                if gain > best:
                    best, cut = gain, (key, below)
    return cut


def _by_share(codes: Array, bad: Flags) -> Array:
    """Number words by their share of failures.

    Ref: Breiman et al., Classification and Regression Trees, 1984, theorem 4.5: the best of all
    ways to part the words is a cut in this order.
    """
    whole = codes.astype(np.intp)
    share = np.bincount(whole, weights=bad) / np.maximum(np.bincount(whole), 1)
    order: Array = rankdata(share, method="ordinal").astype(np.float64)[whole]
    return order


def _cuts(column: Array) -> Array:
    """Return all values but the largest if these are few, else quantiles."""
    distinct = np.unique(column[:: max(len(column) // 20_000, 1)])
    if len(distinct) <= _CUTS:
        return distinct[:-1]
    return np.quantile(distinct, np.linspace(0, 1, _CUTS + 2)[1:-1])


def _impurity(count: int, bad: int) -> float:
    return 2.0 * bad * (count - bad) / count if count else 0.0


def short_between(low: float, high: float) -> float:
    """Return a number of few digits from `low` on, and below `high`."""
    first = math.floor(-math.log10(high - low))
    tries: Any = (round((low + high) / 2, digits) for digits in range(first, first + 20))
    return next((value for value in tries if low <= value < high), low)


def number_text(value: float) -> str:
    """Return a number in as few digits as read back as the same."""
    return repr(value + 0.0).removesuffix(".0")
