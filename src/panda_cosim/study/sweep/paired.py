"""Two sweeps, pair by pair: what a treatment makes better or worse, where all else is equal.

Rows are paired by the values that vary within the sweeps. What is constant within each and differs
between them, such as a law, a gain or a version, is the treatment. Whether success changes is told
by the exact test of McNemar (Psychometrika 12, 1947), on the pairs with one success; intervals are
those of the bootstrap over pairs (percentiles of 9999 resamples, always the same ones).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time
from numpy.typing import ArrayLike, NDArray

from ...fmus.errors import InputError
from ..compare.differences import Row as Changed
from .row import MARGIN, Row
from .store import Store, changes

CONFIDENCE: Final = 0.95
RESAMPLES: Final = 9999
SUCCESS: Final = "success"


@dataclass(frozen=True)
class Difference:
    """A mean over pairs, the second less the first, with its interval."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, pairs: ArrayLike) -> Difference:
        """Return that of differences (n,), n at least 1."""
        values: NDArray[np.float64] = np.asarray(pairs, float)
        mean = float(values.mean())
        if np.ptp(values) == 0.0:
            return cls(mean, mean, mean)
        found = scipy.stats.bootstrap(
            (values,), np.mean, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
            method="percentile", rng=np.random.default_rng(0),
        )  # fmt: skip
        return cls(mean, *map(float, found.confidence_interval))


@dataclass(frozen=True)
class Paired:
    """Two sweeps of the same values; `pair` makes it."""

    keys: tuple[str, ...]  # by whose values rows are paired
    treatment: tuple[str, ...]  # what differs between the sweeps, a line each
    pairs: tuple[tuple[Row, Row], ...]  # of both, in the order of the first
    unpaired: tuple[int, int]  # rows of each without a partner

    def flipped(self, *, lost: bool) -> list[tuple[Row, Row]]:
        """Return the pairs of which only the first succeeds (`lost`), or only the second."""
        sides = zip(self.pairs, self._successes.tolist(), strict=True)
        return [pair for pair, good in sides if good == [lost, not lost]]

    @cached_property
    def _successes(self) -> NDArray[np.bool_]:
        return np.array([[row["status"] == SUCCESS for row in pair] for pair in self.pairs])

    @property
    def rates(self) -> tuple[float, float]:
        """Success rate of each, over the pairs."""
        first, second = self._successes.mean(axis=0).tolist()
        return first, second

    @property
    def p_value(self) -> float:
        """How likely such uneven flips are if the treatment does nothing; exact, two-sided."""
        lost, gained = (len(self.flipped(lost=side)) for side in (True, False))
        return float(scipy.stats.binomtest(lost, lost + gained).pvalue) if lost + gained else 1.0

    @cached_property
    def success(self) -> Difference:
        """Change of the success rate."""
        return Difference.of(np.diff(self._successes.astype(float)).ravel())

    @property
    def unseen(self) -> float:
        """Share of flips that no flip among the pairs leaves possible, at 97.5 %; exact."""
        return 1.0 - float((0.5 - CONFIDENCE / 2.0) ** (1.0 / len(self.pairs)))

    @cached_property
    def margins(self) -> dict[str, Difference]:
        """Change of each margin that both sweeps measured, by criterion; "": the smallest."""
        first, second = self.pairs[0]
        found = {}
        for name in (n for n in first if n in second and n.split(".")[0] == MARGIN):
            pairs = [(a[name], b[name]) for a, b in self.pairs]
            if values := [now - before for before, now in pairs if None not in (before, now)]:
                found[name.partition(".")[2]] = Difference.of(values)
        return found

    def is_worse(self, allowed: float | None) -> bool:
        """Whether the rate may have sunk by more than allowed; None: whether it surely sank."""
        return self.success.high < 0.0 if allowed is None else self.success.low < -allowed


def pair(first: str | Path, second: str | Path) -> Paired:
    """Pair the rows of two sweeps' folders.

    Raises:
        InputError: They have no values in common, or rows of equal values.
    """
    stores = Store(first), Store(second)
    before, now = (store.content for store in stores)
    tables = [store.table().to_pylist() for store in stores]
    every = dict.fromkeys(("scenario", *before.keys, *now.keys))
    values = {key: [{row.get(key) for row in rows} for rows in tables] for key in every}
    shared = [key for key in every if all(key in rows[0] for rows in tables)]
    keys = tuple(key for key in shared if max(map(len, values[key])) > 1)
    sides = [_by_values(s.folder, rows, keys) for s, rows in zip(stores, tables, strict=True)]
    common = [at for at in sides[0] if at in sides[1]]
    if not common:
        names = ", ".join(keys) or "constant values"
        raise InputError(f"{second}: no row has the values of a row of {first} ({names})")
    constant = [
        str(Changed(key, (*one, *other)))
        for key, (one, other) in values.items()
        if one != other and len(one) == len(other) == 1
    ]
    return Paired(
        keys,
        (*constant, *changes(before.origin, now.origin)),
        tuple((sides[0][at], sides[1][at]) for at in common),
        (len(sides[0]) - len(common), len(sides[1]) - len(common)),
    )


def _by_values(
    folder: Path, rows: Sequence[Row], keys: Sequence[str]
) -> dict[tuple[object, ...], Row]:
    found: dict[tuple[object, ...], Row] = {}
    for row in rows:
        values = tuple(row[key] for key in keys)
        if values in found:
            raise InputError(
                f"{folder}: rows {found[values]['index']} and {row['index']} have the same values "
                f"of {', '.join(keys) or 'all keys'}; must differ, to be paired"
            )
        found[values] = row
    return found
