"""A case that runs several times is flaky where verdict or recording are not always the same."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from ...result.recording import Recording
from .engines import difference_of, engine_row
from .outcome import MEANINGS, Member, Outcome


def rows_of(
    groups: Iterable[Sequence[Member]], outcomes: Iterable[Outcome], *, apart: bool
) -> list[list[Outcome]]:
    """Return the outcomes of each scenario's variants: `apart`, or merged as its repeats."""
    ran = iter(outcomes)
    rows = [[next(ran) for _ in group] for group in groups]
    return [engine_row(*row) if apart else [merged(*row)] for row in rows]


def merged(first: Outcome, *others: Outcome) -> Outcome:
    """Return the outcome of a case's runs: the first or, where they differ, the worst as flaky."""
    odd = [o for o in others if (o.verdict, o.recording) != (first.verdict, first.recording)]
    if not odd:
        return first
    how = f"one is {odd[0].verdict!r}, the first {first.verdict!r}"
    if odd[0].verdict == first.verdict:
        one, two = (Recording.open(each.run) for each in (first, odd[0]))
        _, _, where = difference_of(one, one, two, first.read.regression).partition(", ")
        how = f"the recording from {where}"
    worst = min((first, *odd), key=lambda each: list(MEANINGS).index(each.verdict))
    said = f"{len(odd)} of {len(others)} repeats differ from the first run: {how}"
    return replace(worst, scenario=first.scenario, verdict="flaky", error=said)
