"""What a sweep's report needs of its table: columns, bars and cells by value, and statistics.

These are shares with bounds, and influences.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time
from numpy.typing import NDArray

from ...assets.fields import Array
from ..compare.wording import numbers
from .row import MARGIN, TEXTS
from .store import Store

Labels = Mapping[str, Sequence[str]]

CONFIDENCE: Final = 0.95
FEWEST: Final = 10  # rows of which correlations are given
Z: Final = 1.959963984540054  # its quantile of the normal distribution
BINS: Final = (6, 24)  # of a marginal: fewest and most
CELLS: Final = (5, 14)  # of a heat map, each way
IN_A_BIN: Final = 12  # least mean number of rows per bin
MOST_VALUES: Final = 60  # that have a bar each


def share_bounds(count: int, total: int) -> tuple[float, float]:
    """Bounds of a probability by Clopper and Pearson, at `CONFIDENCE`, after events in trials."""
    if not total:
        return 0.0, 1.0
    bounds = scipy.stats.binomtest(count, total).proportion_ci(CONFIDENCE, "exact")
    return float(bounds.low), float(bounds.high)


@dataclass(frozen=True)
class Influence:
    """Influence of a varied value on a result."""

    key: str
    value: float  # Spearman's rank correlation, -1 to 1; of words see `_of_words`, 0 to 1
    low: float | None = None  # bound of a rank correlation at `CONFIDENCE`; None: words
    high: float | None = None


def influences(values: Mapping[str, Array], labels: Labels, result: Array) -> list[Influence]:
    """Return the influence of each value that varies, the strongest first; none of few rows."""
    # Values are given by key (n,), those of words as their numbers in `labels`. A result of -inf
    # ranks lowest, and NaN leaves the row out (n,).
    known = ~np.isnan(result)
    ranks = scipy.stats.rankdata(result[known])
    if len(ranks) < FEWEST or np.ptp(ranks) == 0:
        return []
    strengths = [
        _of_words(key, column[known], ranks)
        if key in labels
        else _of_numbers(key, scipy.stats.rankdata(column[known]), ranks)
        for key, column in values.items()
        if len(np.unique(column[known])) > 1
    ]
    return sorted(strengths, key=lambda each: -abs(each.value))


def _of_numbers(key: str, ranks: Array, result: Array) -> Influence:
    """Correlate ranks."""
    # Ref: Bonett and Wright, Sample size requirements for estimating Pearson, Kendall and Spearman
    # correlations, 2000: the variance of its Fisher transform is (1 + r^2/2) / (n - 3). That of 1
    # is infinite, so its bounds are those of the next lower one, with two neighbours swapped.
    count, r = len(ranks), float(np.corrcoef(ranks, result)[0, 1])
    most = 1 - max(12 / (count * (count**2 - 1)), 1e-15)
    middle = math.atanh(max(min(r, most), -most))
    width = Z * math.sqrt((1 + r * r / 2) / (count - 3))
    return Influence(key, r, min(r, math.tanh(middle - width)), max(r, math.tanh(middle + width)))


def _of_words(key: str, codes: Array, result: Array) -> Influence:
    """Return the root of the share of the ranks' variance between words, beyond chance; or 0."""
    # Ref: Tomczak and Tomczak, The need to report effect size estimates revisited, 2014: of Kruskal
    # and Wallis's H it is (H - k + 1) / (n - k).
    groups = [result[codes == code] for code in np.unique(codes)]
    freedom = len(codes) - len(groups)
    share = (scipy.stats.kruskal(*groups).statistic - len(groups) + 1) / freedom if freedom else 0.0
    return Influence(key, math.sqrt(max(float(share), 0.0)))


class Results:
    """The columns of a sweep's table that its page needs, each (n,).

    Attributes:
        store: The sweep's folder.
        content: Of its sweep.json.
        values: Varied values by key; words as their numbers in `labels`.
        labels: Words by key, the scenarios' names among them.
        margins: Margins by column; -inf if not measured, NaN if of another scenario.
        metrics: All other columns of numbers: the summary's, instants of events.
        bad: Whether a row failed, or missed a criterion.
        index: Numbers of the rows.
        missed: Number of rows by the first criterion that they missed.
        is_grid: Whether the values are those of a grid.
    """

    def __init__(self, store: Store) -> None:
        self.store, self.content = store, store.content
        content = self.content
        names = [name for name in content.columns if name.split(".")[0] == MARGIN]
        keys = content.keys + (["scenario"] if len(content.nominal) > 1 else [])
        table = store.table(list({*keys, *names, "status", "missed", "index", "scenario"}))
        self.values: dict[str, Array] = {}
        self.labels: dict[str, list[str]] = {}
        for key in keys:
            column = table[key]
            if str(column.type) == "double":
                self.values[key] = column.to_numpy()
            else:
                words, codes = np.unique(column.cast("string").to_numpy(), return_inverse=True)
                self.values[key], self.labels[key] = codes.astype(np.float64), words.tolist()
        self.margins = {name: _margins(table, name, content.nominal) for name in names}
        others = {*keys, *names, *TEXTS, "index", "wall_s"}
        self.metrics = [name for name in content.columns if name not in others]
        status = table["status"].to_numpy()
        self.bad = np.asarray(status != "success", dtype=bool)
        missed = table["missed"].to_numpy()[status == "missed"]
        self.missed = dict(Counter(filter(None, missed)).most_common())
        self.index: NDArray[np.int64] = table["index"].to_numpy()
        self.is_grid = content.origin["definition"]["design"] == "grid"

    def columns(self, keys: Sequence[str], rows: NDArray[np.intp]) -> Iterator[tuple[str, Array]]:
        """Yield values, margins and metrics of some rows (n,) by name, each (n,)."""
        yield from ((key, self.values[key][rows]) for key in keys)
        yield from ((name, margin[rows]) for name, margin in self.margins.items())
        table = self.store.table([*self.metrics, "index"], self.index[rows].tolist())
        yield from ((name, table[name].to_numpy()) for name in self.metrics)


def _margins(table: Any, name: str, nominal: Mapping[str, Collection[str]]) -> Array:
    column = np.asarray(table[name].to_numpy(), dtype=np.float64)
    column = np.where(np.isnan(column), -np.inf, column)
    for scenario, columns in nominal.items():
        criteria = {each for each in columns if each.startswith(f"{MARGIN}.")}
        if not criteria or name not in (MARGIN, *criteria):  # a criterion may be another's
            column[table["scenario"].to_numpy() == scenario] = np.nan
    return column


def missing(store: Store) -> str:
    """Say which rows an unfinished sweep lacks; "" if it is complete."""
    absent = np.setdiff1d(np.arange(rows := store.content.rows), store.done())
    if not len(absent):
        return ""
    among = "" if np.ptp(absent) < len(absent) else "among "
    return f"{len(absent)} of {rows} rows are missing: {among}rows {absent[0]} to {absent[-1]}."


class Axis:
    """The parts of a value's range: each value by itself if they are few or of a grid, else bins.

    Attributes:
        starts: Where each part begins (m,).
        ends: Where it ends (m,); a row at an inner edge of two bins is in the upper one.
        names: What is in each part.
        ticks: What is written beside it: the value, or both ends of all bins.
        part: The part of each row (n,).
    """

    def __init__(self, results: Results, key: str, bins: int) -> None:
        column = results.values[key]
        values, self.part = np.unique(column, return_inverse=True)
        few = results.is_grid or 2 * len(values) <= len(column) or len(values) == 1
        if key in results.labels or (few and len(values) <= MOST_VALUES):
            half = _half_widths(values)
            self.starts, self.ends = values - half, values + half
            self.names = self.ticks = results.labels.get(key) or numbers(values.tolist())
            return
        edges = np.linspace(values[0], values[-1], bins + 1)  # inner ones of few digits
        edges[1:-1] = np.round(edges[1:-1], math.ceil(1 - math.log10(np.ptp(values) / bins)))
        self.starts, self.ends = edges[:-1], edges[1:]
        self.part = np.clip(np.searchsorted(edges, column, "right") - 1, 0, bins - 1)
        texts = numbers(edges.tolist())
        self.names = [f"{low} to {high}" for low, high in pairwise(texts)]
        self.ticks = [texts[0], *[""] * (bins - 2), texts[-1]]

    def counts(self, results: Results, within: Axis | None = None) -> dict[str, list[int]]:
        """Return rows and failures in each part, or in those of another axis within each."""
        part, parts = self.part, len(self.names)
        if within is not None:
            part, parts = part * len(within.names) + within.part, parts * len(within.names)
        rows = {"rows": part, "bad": part[results.bad]}
        return {name: np.bincount(each, minlength=parts).tolist() for name, each in rows.items()}


def _half_widths(values: Array) -> Array:
    """Return half the width of a bar at each value, so that none reaches its neighbours."""
    if len(values) == 1:
        return np.maximum(np.abs(values), 1.0) / 2
    gaps = np.diff(values)
    half: Array = 0.4 * np.minimum(np.append(gaps, gaps[-1]), np.insert(gaps, 0, gaps[0]))
    return half


def marginal(results: Results, key: str, *, bounds: bool) -> dict[str, object]:
    """Return rows and failures by value; with the bounds of their share, if rows are samples."""
    axis = Axis(results, key, int(np.clip(len(results.bad) / IN_A_BIN, *BINS)))
    counts = axis.counts(results)
    shares = map(share_bounds, counts["bad"], counts["rows"]) if bounds else ()
    return {
        "starts": axis.starts.tolist(),
        "ends": axis.ends.tolist(),
        "names": axis.names,
        "ticks": axis.ticks,
        "each": axis.ticks == axis.names,
        **counts,
        "bounds": [[round(low, 4), round(high, 4)] for low, high in shares],
    }


def heat_map(results: Results, first: str, second: str) -> dict[str, object]:
    """Return rows and failures in the cells of two values, those of `first` one after the other."""
    bins = int(np.clip(math.sqrt(len(results.bad) / IN_A_BIN), *CELLS))
    x, y = (Axis(results, key, bins) for key in (first, second))
    names, ticks = [x.names, y.names], [x.ticks, y.ticks]
    return {"keys": [first, second], "names": names, "ticks": ticks, **x.counts(results, y)}
