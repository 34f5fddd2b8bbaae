"""What a suite would notice: each parameter is changed by a step, one at a time.

A change is noticed where a run leaves its reference's tubes, misses a criterion or fails. A change
after which a scenario records the same bits has no effect there, and says nothing of the suite.
"""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from ...fmus.atomic import write_whole
from ...fmus.errors import InputError
from ...result.judging.verdicts import MISSED
from ...run.start import start_values
from ...task.scenario import Scenario
from ...task.tolerances import signal_of
from .causes import TABLES
from .differences import Row
from .junit import Case, write_cases
from .outcome import Outcome
from .page import Page, Part, Section, Table, render
from .regress import Suite, run_suite

STEPS: Final[Mapping[str, float]] = TABLES["steps"]
NO_EFFECT: Final = "no effect"


@dataclass(frozen=True)
class Change:
    """A parameter with all its elements, before and after a step."""

    key: str  # such as `controller.kp`
    before: tuple[float, ...]
    now: tuple[float, ...]

    def __str__(self) -> str:
        """Say what changes: of several elements the first that does."""
        pairs = zip(self.before, self.now, strict=True)
        return str(Row("", next(pair for pair in pairs if pair[0] != pair[1]))).strip()

    def applied(self, scenario: Scenario) -> Scenario:
        """Return a scenario with it."""
        value = self.now[0] if len(self.now) == 1 else list(self.now)
        return scenario.changed({self.key: value})


@dataclass(frozen=True)
class Finding:
    """What a suite makes of a change."""

    key: str
    change: str  # in the first scenario that has it
    noticed: tuple[tuple[str, str], ...]  # scenario and what notices it there, the first signal
    blind: tuple[str, ...]  # scenarios that record something else, and do not notice it

    @property
    def state(self) -> str:
        """Whether it is noticed, is not, or has no effect."""
        return "noticed" if self.noticed else "not noticed" if self.blind else NO_EFFECT

    @property
    def where(self) -> str:
        """What notices it first and in which scenario, or in which it is not noticed."""
        if not self.noticed:
            return f"not by {', '.join(self.blind)}" if self.blind else ""
        scenario, by = self.noticed[0]
        more = f"; {len(self.noticed) - 1} more" if len(self.noticed) > 1 else ""
        return f"{by}, {scenario}{more}"


def changes_of(scenario: Scenario, share: float) -> Iterator[Change]:
    """Yield a change of each number that a scenario's FMUs take, up by a share if that is valid."""
    for instance, values in start_values(scenario).items():
        signals = defaultdict[str, list[float]](list)
        for name, value in values.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                signals[signal_of(name)].append(float(value))
        for name, before in signals.items():
            key, steps = f"{instance}.{name}", [share * value for value in before]
            if not any(before):
                steps = [STEPS.get(key, 0.0)] * len(before)
            ends = (np.add(before, steps), np.subtract(before, steps))
            changes = (Change(key, tuple(before), tuple(now.tolist())) for now in ends)
            yield from islice((change for change in changes if _is_valid(change, scenario)), 1)


def _is_valid(change: Change, scenario: Scenario) -> bool:
    with suppress(InputError):
        start_values(change.applied(scenario))
        return change.now != change.before
    return False


def qualify(
    suite: Suite, folder: Path, share: float, tell: Callable[[Outcome, int], None]
) -> list[Finding]:
    """Run a suite as it is, then with each change; runs in `folder` are removed as they end.

    `tell` is called with each outcome of a change, and the number of changes.

    Raises:
        InputError: A scenario cannot be read, or does not pass as it is.
    """
    recorded: dict[str, str] = {}
    for outcome in run_suite(suite, folder):
        if not outcome.ok:
            raise InputError(f"{outcome.name}: {outcome.verdict}: must pass before it is qualified")
        recorded[outcome.name] = outcome.recording
    trials = {
        f"{scenario.name}-{change.key}": (scenario, change)
        for scenario in suite.scenarios if isinstance(scenario, Scenario)
        for change in changes_of(scenario, share)
    }  # fmt: skip
    seen: dict[str, str] = {}

    def look(outcome: Outcome) -> None:
        tell(outcome, len(trials))
        seen[outcome.name] = noticed_by(outcome)  # a failed run may have no recording
        if outcome.ok and outcome.recording == recorded[trials[outcome.name][0].name]:
            seen[outcome.name] = NO_EFFECT
        shutil.rmtree(outcome.run, ignore_errors=True)

    changed = [replace(each.applied(one), name=name) for name, (one, each) in trials.items()]
    run_suite(replace(suite, scenarios=changed), folder, look)
    found = defaultdict[str, list[tuple[str, str, str]]](list)  # scenario, change, by what
    for name, (scenario, change) in trials.items():
        found[change.key].append((scenario.name, str(change), seen[name]))
    return [
        Finding(
            key,
            runs[0][1],
            noticed=tuple((name, by) for name, _, by in runs if by not in ("", NO_EFFECT)),
            blind=tuple(name for name, _, by in runs if not by),
        )
        for key, runs in found.items()
    ]


def noticed_by(outcome: Outcome) -> str:
    """Return the criterion or the signal that notices a change first; "": none."""
    if outcome.ok:
        return ""
    missed = [criterion.name for criterion in outcome.criteria if not criterion.ok]
    first = outcome.comparison and outcome.comparison.first
    found = [f"{first.name} at {first.first:.3f} s"] if first else []
    found += [f"{MISSED.word} {', '.join(missed)}"] if missed else []
    return ", ".join(found) or outcome.reason


def score(findings: Sequence[Finding]) -> float:
    """Return the share of changes with an effect that are noticed; 0 if none has one."""
    judged = [finding for finding in findings if finding.state != NO_EFFECT]
    return sum(finding.state == "noticed" for finding in judged) / max(len(judged), 1)


def write_findings(findings: Sequence[Finding], page: Path, junit: Path) -> None:
    """Write the page, and a test case for each change: one that is not noticed is a failure."""
    rows = [(f"{each.key} {each.change}", each.state, each.where) for each in findings]
    table = Table(("Change", "State", "By what first, where"), rows)
    title = f"{score(findings):.0%} of the changes that have an effect are noticed"
    sections = [Section("Changes", "", [Part("What notices them", [table])])]
    write_whole(page, render(Page(title, "", "One parameter at a time", (), sections)))
    cases = [
        Case(name, 0.0, ("failure", state) if state == "not noticed" else None, where)
        for name, state, where in rows
    ]
    write_cases("panda-cosim regress --qualify", cases, junit)
