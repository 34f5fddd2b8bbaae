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
from .results import CONFIDENCE
from .row import MARGIN, Row
from .store import Store, changes

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
    before, now = _Side(first), _Side(second)
    every = dict.fromkeys(("scenario", *before.content.keys, *now.content.keys))
    values = {key: (before.values(key), now.values(key)) for key in every}
    keys = tuple(key for key, sides in values.items()
                 if max(map(len, sides)) > 1 and {None} not in sides)  # fmt: skip
    one, other = before.by(keys), now.by(keys)
    common = [at for at in one if at in other]
    if not common:
        names = ", ".join(keys) or "constant values"
        raise InputError(f"{second}: no row has the values of a row of {first} ({names})")
    constant = [
        str(Changed(key, (*old, *new)))
        for key, (old, new) in values.items()
        if old != new and len(old) == len(new) == 1
    ]
    return Paired(
        keys,
        (*constant, *changes(before.content.origin, now.content.origin)),
        tuple((one[at], other[at]) for at in common),
        (len(one) - len(common), len(other) - len(common)),
    )


class _Side:
    """One of two sweeps."""

    def __init__(self, folder: str | Path) -> None:
        store = Store(folder)
        self.folder, self.content, self._rows = folder, store.content, store.table().to_pylist()

    def values(self, key: str) -> set[object]:
        """Return the values that rows have of a key; None: they have none."""
        return {row.get(key) for row in self._rows}

    def by(self, keys: Sequence[str]) -> dict[tuple[object, ...], Row]:
        """Return the rows by their values of keys, which must tell them apart."""
        found: dict[tuple[object, ...], Row] = {}
        for row in self._rows:
            other = found.setdefault(tuple(row[key] for key in keys), row)
            if other is not row:
                raise InputError(
                    f"{self.folder}: rows {other['index']} and {row['index']} have the same values "
                    f"of {', '.join(keys) or 'all keys'}; must differ, to be paired"
                )
        return found
