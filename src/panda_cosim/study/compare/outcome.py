"""The outcome of one scenario of a suite, and what readers make of its verdict."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from ...fmus.errors import InputError
from ...result.judging.criterion import Criterion
from ...result.judging.summary import Summary
from ...task.scenario import Scenario
from .against_reference import Comparison, Deviation
from .causes import GIVEN, named
from .reference import REFERENCE_FILE

if TYPE_CHECKING:
    from ..sweep.suite import SuiteSweep
    from .history import Night

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
Verdict = Literal[
    "same", "differs", "failed", "holds", "missed", "no reference", "skipped", "flaky"
]


@dataclass(frozen=True)
class Meaning:
    """What readers make of a verdict of a suite."""

    level: Literal["good", "warn", "bad"]  # its colour; only a good one passes
    exit_code: int = 0  # of `regress`
    fault: Literal["failure", "error", "skipped"] | None = None  # in JUnit


MEANINGS: Final = {verdict: Meaning(**row) for verdict, row in _TABLES.items()}


@dataclass(frozen=True)
class Unusable:
    """A scenario's folder that cannot be read: it alone fails, the rest of the suite runs."""

    name: str  # of the folder, or its path in the suite
    folder: Path
    error: str  # the problem in one line
    purpose: str = ""
    duration: float = 0.0


Member = Scenario | Unusable  # of a suite


@dataclass(frozen=True)
class Outcome:
    """The outcome of one scenario, or of a sweep, which has no reference.

    `start` makes it in a process of its own, and `SuiteSweep.judge` of a sweep; command line,
    page, JUnit and pytest read it. It opens files of the run only when they are asked for.

    The verdict is `same` as the reference, `differs` from it, or `failed` to run. Without a
    reference it is `holds` or `missed` by the criteria; `no reference` if there are none of these,
    or the reference is damaged. It is `skipped` if the client needs a package that is not there,
    and `flaky` if it ran several times with different verdicts or recordings.
    """

    scenario: Member | SuiteSweep
    verdict: Verdict
    run: Path  # folder of the run
    seconds: float  # wall time of the run [s]
    comparison: Comparison | None = None  # with the reference; None: there is none, or it failed
    error: str = ""  # why it failed, missed or was skipped, or the reference cannot be used
    criteria: tuple[Criterion, ...] = ()  # as judged; empty without a summary
    recording: str = ""  # digest of all values that it recorded
    noisy: Path | None = None  # the same run with rounded inputs, if it was asked for
    nights: tuple[Night, ...] = ()  # of its history, the last one is this
    difference: str = ""  # from the run with the scenario's own MuJoCo, if it is another's

    @property
    def ok(self) -> bool:
        """Whether the run matches its reference, or its verdict is as expected without one."""
        return self.meaning.level == "good"

    @property
    def meaning(self) -> Meaning:
        """What readers make of the verdict."""
        return MEANINGS[self.verdict]

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.scenario.name

    @property
    def read(self) -> Scenario:
        """The scenario, where there is a run of one."""
        assert isinstance(self.scenario, Scenario)
        return self.scenario

    @property
    def reason(self) -> str:
        """The cause and the problems in one line; empty if there are none."""
        return "; ".join(self.problems)

    @property
    def problems(self) -> Sequence[str]:
        """What is wrong, one line each: the cause, if it is known, then the most important."""
        found = self.comparison.problems if self.comparison else ()
        lines = [self.error, *([self.cause, *found] if found else ())]
        return tuple(filter(None, lines))

    @property
    def flaky(self) -> str:
        """What has changed over nights with the code and scenario of the last; "": nothing."""
        same = [night for night in self.nights if night.made == self.nights[-1].made != ""]
        found = len({(night.verdict, night.recording) for night in same})
        told = f"flaky: {found} results in {len(same)} nights of the same code and scenario"
        return told if found > 1 else ""

    @property
    def worst(self) -> Deviation | None:
        """The column that is furthest from its reference."""
        return self.comparison.worst if self.comparison else None

    @property
    def cause(self) -> str:
        """What the run was made with differently than its reference, in one line; "": nothing.

        Of a run that matches, only bounds, parameters and what another MuJoCo compiles are told.
        """
        if self.comparison is None:
            return ""
        match = self.comparison.ok
        whole = not match or self.difference  # another engine's fields, also where results match
        told = [c for c in self.comparison.causes if whole or c.name.startswith(GIVEN)]
        return f"changed: {named(told)}{'; results match' * match}" if told else ""

    @property
    def summary(self) -> Summary:
        """The run's summary."""
        return Summary.open(self.run)

    @property
    def reference_path(self) -> Path:
        """Path of the scenario's reference, which need not exist."""
        assert self.read.folder is not None  # as each scenario of a suite
        return self.read.folder / REFERENCE_FILE


def headline(outcomes: Sequence[Outcome]) -> str:
    """Say in one line how many scenarios pass, and how many were skipped."""
    is_judged = any(outcome.verdict in ("holds", "missed") for outcome in outcomes)
    words = "pass" if is_judged else "match their references"
    alone = all(isinstance(outcome.scenario, Scenario | Unusable) for outcome in outcomes)
    what = "scenarios" if alone else "scenarios and sweeps"
    skipped = sum(outcome.verdict == "skipped" for outcome in outcomes)
    left_out = f"; {skipped} skipped" if skipped else ""
    return f"{sum(outcome.ok for outcome in outcomes)} of {len(outcomes)} {what} {words}{left_out}"


def exit_code(outcomes: Iterable[Outcome]) -> int:
    """Return 0 if all pass, 1 if one does not, 2 if one has neither reference nor criteria.

    Skipped ones do not count, but if all are, nothing was compared, which is 2.
    """
    judged = {outcome.verdict for outcome in outcomes}
    if judged == {"skipped"}:
        return InputError.exit_code
    return next(meaning.exit_code for each, meaning in MEANINGS.items() if each in judged)
