"""Runs a suite of scenarios and compares each with its reference recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from ...fmus.errors import CosimError, InputError
from ...fmus.messages import did_you_mean, excerpt
from ..recording import Recording
from ..run.start import Overrides, check_criteria, start_values
from ..scenario.scenario import SCENARIO_FILE, Scenario, shipped_scenarios
from .compare import describe
from .metrics import compare_metrics
from .reference import Reference, Unusable
from .runner import Outcome, Runner

SHOWN = 5  # metrics listed
NOTICED = 1e-3  # relative change from which a metric is listed


@dataclass(frozen=True)
class Suite:
    """The scenarios of a suite, and how to run them; refuses parameters that cannot be used."""

    scenarios: Sequence[Scenario | Unusable]
    overrides: Overrides = field(default_factory=dict)  # in place of the scenarios' own
    exact: bool = False  # whether each bit must match the reference
    jobs: int = 1  # how many run at the same time

    def __post_init__(self) -> None:
        """Check the parameters, before anything runs."""
        for scenario in self.usable:
            try:
                start_values(scenario, self.overrides)
            except InputError as error:
                raise InputError(f"{scenario.name}: {error}") from error

    @property
    def usable(self) -> list[Scenario]:
        """The scenarios that can be run."""
        return [scenario for scenario in self.scenarios if isinstance(scenario, Scenario)]


def run_suite(
    suite: Suite, folder: Path, tell: Callable[[Outcome], None] | None = None
) -> list[Outcome]:
    """Run a suite into a folder, the longest scenario first; return outcomes in its order.

    `tell` is called with each outcome as it arrives.
    """
    from ...fmus.sources.targets import build  # noqa: PLC0415 - imports much

    build()  # once, not in each process
    outcomes = {
        s.name: Outcome(s, "failed", folder / s.name, 0.0, error=s.error)
        for s in suite.scenarios
        if isinstance(s, Unusable)
    }
    with Runner(folder, suite.overrides, exact=suite.exact, jobs=suite.jobs) as runner:
        longest_first = sorted(suite.usable, key=lambda s: -s.duration)
        futures = [runner.submit(scenario) for scenario in longest_first]
        for outcome in chain(list(outcomes.values()), map(_result, as_completed(futures))):
            outcomes[outcome.name] = outcome
            if tell is not None:
                tell(outcome)
    return [outcomes[scenario.name] for scenario in suite.scenarios]


def _result(future: Future[Outcome]) -> Outcome:
    return future.result()


def exit_code(outcomes: Iterable[Outcome]) -> int:
    """Return 0 if all pass, 1 if one does not, 2 if one has neither reference nor criteria."""
    verdicts = {outcome.verdict for outcome in outcomes}
    if verdicts & {"differs", "failed", "missed"}:
        return CosimError.exit_code
    return InputError.exit_code if "no reference" in verdicts else 0


def find_scenarios(
    names: Sequence[str] = (), folder: Path | None = None
) -> list[Scenario | Unusable]:
    """Load scenarios by name, or all; an unusable folder becomes an `Unusable`."""
    known = shipped_scenarios() if folder is None else _scenarios_in(folder)
    place = "the shipped ones" if folder is None else str(folder)
    scenarios = [_read(_choose(name, known, place)) for name in names or known]
    for name in (scenario.name for scenario in scenarios):
        if sum(scenario.name == name for scenario in scenarios) > 1:
            raise InputError(f"scenario {name!r}: is given twice")
    unusable = [scenario for scenario in scenarios if isinstance(scenario, Unusable)]
    if len(unusable) == len(scenarios):
        raise InputError(unusable[0].error)
    return scenarios


def _read(folder: Path) -> Scenario | Unusable:
    try:
        scenario = Scenario.read(folder)
    except InputError as error:
        return Unusable(folder, str(error))
    try:
        check_criteria(scenario)
        start_values(scenario)
    except InputError as error:
        return Unusable(folder, f"{folder / SCENARIO_FILE}: {error}")
    return scenario


def _scenarios_in(folder: Path) -> dict[str, Path]:
    if (folder / SCENARIO_FILE).is_file():
        return {folder.resolve().name: folder}
    files = sorted(folder.glob(f"*/{SCENARIO_FILE}"))
    if not files:
        raise InputError(f"{folder}: no scenarios there; must hold folders with {SCENARIO_FILE}")
    return {file.parent.name: file.parent for file in files}


def _choose(name: str, known: Mapping[str, Path], place: str) -> Path:
    if name in known:
        return known[name]
    if (Path(name) / SCENARIO_FILE).is_file():
        return Path(name)
    raise InputError(
        f"scenario {excerpt(name)}: neither one of {place} nor a folder with {SCENARIO_FILE}; "
        f"valid: {', '.join(known)}{did_you_mean(name, known)}"
    )


def candidate(outcome: Outcome) -> Reference:
    """Make a reference from a run."""
    if outcome.verdict == "failed":
        raise InputError(f"the run failed, so it cannot become a reference: {outcome.error}")
    recording = Recording.open(outcome.run)
    return Reference.of(recording, outcome.summary, outcome.tolerances)


def changes(outcome: Outcome, new: Reference) -> list[str]:
    """Describe how the reference made of a run changes, one line each; none: it does not."""
    path = outcome.reference_path
    if not path.is_file():
        return ["is new"]
    try:
        old = Reference.read(path)
    except InputError as error:
        return [f"replaces a reference that cannot be used: {error}"]
    if old.digests == new.digests and old.quanta == new.quanta:
        return []
    lines = [p.text for p in outcome.comparison.problems] if outcome.comparison else []
    if outcome.comparison and not lines:
        worst = outcome.comparison.worst
        near = f"; furthest: {describe(worst)}" if worst is not None and worst.share > 0 else ""
        lines = [f"stays within all tolerances{near}"]
    if old.quanta != new.quanta:
        lines.append("is rounded anew, as its tolerances have changed")
    metrics = compare_metrics(old.summary, new.summary)
    moved = sorted((m for m in metrics if m.relative > NOTICED), key=lambda m: -m.relative)
    lines += [f"{m.name}: {_number(m.before)} -> {_number(m.now)}" for m in moved[:SHOWN]]
    if len(moved) > SHOWN:
        lines.append(f"and {len(moved) - SHOWN} more metrics")
    return lines


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"
