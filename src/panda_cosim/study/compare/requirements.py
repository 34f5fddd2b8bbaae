"""Which requirements a suite proves: by a criterion that states them, or by a whole scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ...task.scenario import Scenario
from .outcome import Outcome

WHOLE = "all that is judged"


class Proof(NamedTuple):
    """What one criterion of one scenario says of a requirement."""

    requirement: str
    criterion: str
    scenario: str
    verdict: str  # of the criterion: ok, missed or not measured; or of the scenario
    ok: bool


def of_outcome(outcome: Outcome) -> Iterator[Proof]:
    """Yield what an outcome says of its scenario's requirements; a failed run proves nothing."""
    scenario = outcome.scenario
    if not isinstance(scenario, Scenario):
        return
    for name in scenario.requirements:
        yield Proof(name, WHOLE, outcome.name, outcome.verdict, outcome.ok)
    judged = {criterion.name: criterion for criterion in outcome.criteria}
    for criterion, names in scenario.success.required.items():
        found = judged.get(criterion)
        for name in names:
            word, ok = (found.word, found.ok) if found else (outcome.verdict, False)
            yield Proof(name, criterion, outcome.name, word, ok)
