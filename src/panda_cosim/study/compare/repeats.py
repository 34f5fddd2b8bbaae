"""A case that runs several times is flaky where verdict or recording are not always the same."""

from __future__ import annotations

from dataclasses import replace

from ...result.recording import Recording
from .engines import difference_of
from .outcome import MEANINGS, Outcome


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
