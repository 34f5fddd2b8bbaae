"""A study of step sizes: with which order the margins converge as the step goes to 0.

If a margin m(h) = m + c h^p for small steps h, the three smallest of them tell the order p and the
limit m (Richardson). As a margin is its value's distance to a bound, both have the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from .row import MARGIN
from .store import Store

KEY = "step"
ORDERS = (0.05, 16.0)  # that are looked for
FEWEST = 3  # steps


@dataclass(frozen=True)
class Convergence:
    """How the margin of a criterion converges."""

    criterion: str
    finest: float  # margin with the smallest step
    order: float | None  # None: it does not converge by a power of the step, or does not change
    limit: float | None  # margin of a step that goes to 0


def convergence(store: Store) -> Iterator[Convergence]:
    """Yield the convergence of each criterion of a sweep that varies the step alone."""
    if store.content.keys != [KEY] or len(store.content.nominal) > 1:
        return
    names = [name for name in store.content.columns if name.startswith(f"{MARGIN}.")]
    table = store.table(["index", KEY, *names])
    for name in names:
        pairs = zip(table[KEY].to_pylist(), table[name].to_numpy().tolist(), strict=True)
        known = sorted(pair for pair in pairs if np.isfinite(pair[1]))
        if len(known) >= FEWEST:
            yield _fitted(name.removeprefix(f"{MARGIN}."), known)


def _fitted(criterion: str, known: Sequence[tuple[float, float]]) -> Convergence:
    """Fit the margins with the three smallest steps, the smallest first."""
    (h1, m1), (h2, m2), (h3, m3) = known[:3]

    def excess(order: float) -> float:
        return float((m3 - m2) * (h2**order - h1**order) - (m2 - m1) * (h3**order - h2**order))

    low, high = map(excess, ORDERS)
    if not low * high < 0.0:
        return Convergence(criterion, m1, None, m1 if m1 == m2 == m3 else None)
    order = float(scipy.optimize.brentq(excess, *ORDERS))
    return Convergence(criterion, m1, order, m1 - (m2 - m1) * h1**order / (h2**order - h1**order))
