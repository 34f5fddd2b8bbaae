"""Runs a suite of scenarios, each in a process of its own, and compares them with references."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ...fmus.errors import CosimError, InputError, located, refuse
from ...result.judging.summary import Summary
from ...result.judging.verdicts import NO_CRITERIA
from ...result.recording import Recording
from ...run.execution import run_scenario
from ...run.options import Options
from ...run.start import check_criteria, check_tolerances, start_values
from ...run.system.assembly import assemble, with_parameter_set
from ...task.client import MissingPackageError
from ...task.files import scenario_files
from ...task.scenario import SCENARIO_FILE, Scenario, shipped_scenarios
from ..work import Workers
from .against_reference import Comparison, compare_with_reference
from .causes import changed, changed_bounds, models_of
from .outcome import Member, Outcome, Unusable, Verdict
from .reference import Reference, how_to_make, kept_metadata
from .tubes import widths_of_noise

if TYPE_CHECKING:
    from ...fmus.sources.targets import Kind
    from ...task.values import Values

# Wall time of a scenario beyond its duration [s]; a hanging one must not hang the others.
TIMEOUT: Final = 600.0


def start(
    workers: Workers,
    scenario: Member,
    run: Path,
    options: Options | None = None,
    *,
    exact: bool = False,
) -> Future[Outcome]:
    """Queue a scenario to be run into a folder and compared; `exact`: bit for bit."""
    failed = partial(_failed, scenario, run, time.perf_counter())
    judge = partial(_outcome, run=run, options=options or Options(), exact=exact)
    limit = TIMEOUT + scenario.duration
    return workers.submit(judge, scenario, died=failed, late=failed, time_limit=limit)


def _outcome(scenario: Member, *, run: Path, options: Options, exact: bool) -> Outcome:
    """Run a scenario in this process; compare it or, without a reference, judge its criteria."""
    if isinstance(scenario, Unusable):
        return Outcome(scenario, "failed", run, 0.0, error=scenario.error)
    began = time.perf_counter()
    try:
        done = run_scenario(scenario, run, options)
    except MissingPackageError as error:
        return replace(_failed(scenario, run, began, str(error)), verdict="skipped")
    except CosimError as error:
        return _failed(scenario, run, began, str(error))
    judged = Outcome(
        scenario,
        done.verdict.suite,  # "failed" also if the scenario asks for what is not there
        run,
        time.perf_counter() - began,
        error="" if done.summary.as_expected else done.summary.detail,
        criteria=done.summary.criteria,
        recording=done.recording.sha256(),
    )
    return judged if judged.verdict == "failed" else _compared(judged, done.summary, exact)


def _compared(judged: Outcome, summary: Summary, exact: bool) -> Outcome:
    """Compare a run with its reference; without one, it stays as it was judged by its criteria."""
    path = judged.reference_path
    if not path.is_file():
        if summary.verdict is not NO_CRITERIA:
            return judged
        advice = f"{how_to_make(path)} makes it, or give the scenario a section [success]"
        missing = f"{path}: does not exist; {advice}"
        return replace(judged, verdict="no reference", error=missing)
    try:
        comparison = _comparison(judged, summary, exact)
    except CosimError as refused:
        return replace(judged, verdict="no reference", error=str(refused))
    verdict: Verdict = "same" if comparison.ok else "differs"
    return replace(judged, verdict=verdict, comparison=comparison, error="")


def _comparison(judged: Outcome, summary: Summary, exact: bool) -> Comparison:
    """Compare a run with its reference, and models where they may be the cause."""
    recording, reference = Recording.open(judged.run), Reference.read(judged.reference_path)
    scenario = judged.read
    found = compare_with_reference(recording, summary, reference, scenario.regression, exact=exact)
    models = {} if found.ok and not scenario.mujoco else models_of(scenario, recording)
    known = {name: reference.models[name] for name in models if name in reference.models}
    before = {**reference.metadata, "models": known}
    now = {**kept_metadata(recording), "models": {name: models[name] for name in known}}
    bounds = changed_bounds(reference.summary, summary)
    return replace(found, causes=(*bounds, *changed(before, now)))


def _failed(scenario: Member, run: Path, began: float, error: str) -> Outcome:
    seconds = time.perf_counter() - began
    criteria = Summary.open(run).criteria
    return Outcome(scenario, "failed", run, seconds, None, error, criteria)


@dataclass(frozen=True)
class Suite:
    """The scenarios of a suite, and how to run them."""

    scenarios: Sequence[Member]
    exact: bool = False  # whether each bit must match the reference
    jobs: int = 1  # how many run at the same time
    kind: Kind = "auto"  # of the project's own FMUs


def with_values(
    scenarios: Iterable[Member], values: Values, ssv: Path | None = None
) -> Iterator[Member]:
    """Yield the scenarios with values changed by key, or by a parameter set of SSP; checks them."""
    for scenario in scenarios:
        if isinstance(scenario, Unusable):
            yield scenario
            continue
        with located(scenario.name):
            changed = with_parameter_set(scenario, ssv, values)
            start_values(changed)
        yield changed


def run_suite(
    suite: Suite, folder: Path, tell: Callable[[Outcome], None] = lambda _: None
) -> list[Outcome]:
    """Run a suite into a folder, the longest first; `tell` is called with each outcome."""
    from ...fmus.sources.targets import Target, build  # noqa: PLC0415 - imports much

    usable = (each for each in suite.scenarios if isinstance(each, Scenario))
    for engine in dict.fromkeys(scenario.mujoco for scenario in usable):
        build(target=Target(suite.kind, mujoco=engine))  # once, not in each process
    outcomes, options = {}, Options(kind=suite.kind)
    with Workers(suite.jobs) as workers:
        ordered = sorted(suite.scenarios, key=lambda each: -each.duration)
        futures = [start(workers, s, folder / s.name, options, exact=suite.exact) for s in ordered]
        for future in as_completed(futures):
            outcome = future.result()
            outcomes[outcome.name] = outcome
            tell(outcome)
    return [outcomes[scenario.name] for scenario in suite.scenarios]


def find_scenarios(names: Sequence[str] = (), folder: Path | None = None) -> list[Member]:
    """Load scenarios by name, or all; an unusable folder becomes an `Unusable`."""
    known = shipped_scenarios() if folder is None else _scenarios_in(folder)
    place = "the shipped ones" if folder is None else str(folder)
    scenarios = [_named(name, known, place) for name in names or known]
    name, count = Counter(scenario.name for scenario in scenarios).most_common(1)[0]
    if count > 1:
        raise InputError(f"scenario {name!r}: is listed twice")
    errors = [scenario.error for scenario in scenarios if isinstance(scenario, Unusable)]
    if len(errors) == len(scenarios):
        raise InputError(errors[0])
    return scenarios


def _named(name: str, known: Mapping[str, Path], place: str) -> Member:
    if name in known:
        return read_scenario(known[name], name)
    if not (Path(name) / SCENARIO_FILE).is_file():
        must = f"must be a folder with {SCENARIO_FILE}, or one of {place}: {', '.join(known)}"
        refuse("scenario", name, must, known)
    return read_scenario(Path(name))


def read_scenario(folder: Path, name: str = "") -> Member:
    """Read a scenario of a suite, in which it has this name; "": that of its folder."""
    name = name or folder.resolve().name
    try:
        scenario = replace(Scenario.read(folder), name=name)
        with located(folder / SCENARIO_FILE):
            assembly = assemble(scenario)
            check_criteria(scenario, assembly)
            start_values(scenario, assembly)
            check_tolerances(scenario, assembly)
    except InputError as error:
        return Unusable(name, folder, str(error))
    return scenario


def _scenarios_in(folder: Path) -> dict[str, Path]:
    if (folder / SCENARIO_FILE).is_file():
        return {folder.resolve().name: folder}
    folders = [file.parent for file in scenario_files(folder)]
    if not folders:
        raise InputError(f"{folder}: no scenarios there; must hold folders with {SCENARIO_FILE}")
    counts = Counter(each.name for each in folders)  # those of one name are told by their paths
    return {
        each.name if counts[each.name] == 1 else each.relative_to(folder).as_posix(): each
        for each in folders
    }


def candidate(outcome: Outcome) -> Reference:
    """Make a reference from a run."""
    if outcome.verdict in ("failed", "skipped"):
        raise InputError(f"{outcome.verdict}, so it cannot become a reference: {outcome.error}")
    recording = Recording.open(outcome.run)
    models, tolerances = models_of(outcome.read, recording), outcome.read.regression
    noisy = outcome.noisy and Recording.open(outcome.noisy)
    noise = widths_of_noise(recording, noisy, tolerances) if noisy else None
    return Reference.of(recording, outcome.summary, tolerances, models, noise)


def changes(outcome: Outcome, new: Reference) -> list[str]:
    """Describe how the reference made of a run changes, one line each; none: it does not."""
    path = outcome.reference_path
    if not path.is_file():
        return ["is new"]
    try:
        old = Reference.read(path)
    except InputError as error:
        return [f"replaces a reference that cannot be used: {error}"]
    made = [(it.metadata["parameters"], it.models) for it in (old, new)]
    found = {
        "was made with other parameters or models": made[0] != made[1],
        "was judged by other criteria": bool(changed_bounds(old.summary, new.summary)),
        "is rounded anew, as its tolerances have changed": old.quanta != new.quanta,
    }
    others = [line for line, is_so in found.items() if is_so]
    if old.digests == new.digests and not others:
        return []
    worst = outcome.worst
    near = f"; furthest: {worst.described}" if worst and worst.share > 0 else ""
    return [*(outcome.problems or [f"stays within all tolerances{near}"]), *others]
