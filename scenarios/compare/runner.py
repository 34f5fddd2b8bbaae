"""Runs scenarios, each in a separate process, and compares them with reference recordings."""

from __future__ import annotations

import json
import time
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, Self

from ...fmus.errors import CosimError
from ..judging.criterion import Criterion, unmeasured_text
from ..recording import Recording
from ..run.folders import SUMMARY_FILE
from ..run.options import Options
from ..run.run import run_scenario
from ..run.start import Overrides
from ..scenario.scenario import Scenario
from ..scenario.tolerances import Tolerances
from ..work import Workers
from .compare import Comparison, compare_with_reference
from .guards import unexpected_text
from .reference import Reference, Unusable, how_to_make, reference_path

Verdict = Literal["same", "differs", "failed", "holds", "missed", "no reference"]
PASSED: Final = ("same", "holds")

TIMEOUT: Final = 600.0  # [s] wall time of one scenario; a hanging one must not hang the others


@dataclass(frozen=True)
class Outcome:
    """The outcome of one scenario.

    Attributes:
        scenario: The scenario, or the folder that could not be used.
        verdict: `same` as the reference, `differs` from it, or `failed` to run. Without a
            reference: `holds` or `missed` by its criteria; `no reference` if it has none of these,
            or the reference is damaged.
        run: Folder of the run.
        seconds: Wall time of the run [s].
        comparison: Comparison with the reference; None: there is none, or the run failed.
        error: Why it failed or missed, or why the reference cannot be used.
        criteria: The judged criteria; empty without a summary.
    """

    scenario: Scenario | Unusable
    verdict: Verdict
    run: Path
    seconds: float
    comparison: Comparison | None = None
    error: str = ""
    criteria: tuple[Criterion, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the run matches its reference, or its verdict is as expected without one."""
        return self.verdict in PASSED

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.scenario.name

    @property
    def tolerances(self) -> Tolerances:
        """Tolerances of the comparison."""
        assert isinstance(self.scenario, Scenario)  # an unreadable scenario has no run
        return self.scenario.regression

    @property
    def reason(self) -> str:
        """The problem in one line; empty if there is none."""
        if self.comparison is not None and self.comparison.problems:
            return "; ".join(problem.text for problem in self.comparison.problems)
        return self.error

    @property
    def summary(self) -> dict[str, Any]:
        """Content of the run's `summary.json`."""
        return read_summary(self.run)

    @property
    def reference_path(self) -> Path:
        """Path of the scenario's reference, which need not exist."""
        return reference_path(self.scenario)


class Runner:
    """Runs scenarios in parallel. A context manager: on exit, all runs are ended.

    Args:
        folder: Folder for the runs; each is named after its scenario.
        overrides: Parameters by instance and name, in place of the scenarios' own.
        exact: Whether each bit must match the reference.
        jobs: How many run at the same time.
    """

    def __init__(
        self,
        folder: Path,
        overrides: Overrides | None = None,
        *,
        exact: bool = False,
        jobs: int = 1,
    ) -> None:
        self._folder, self._overrides, self._exact = folder, overrides or {}, exact
        self._workers = Workers(jobs)

    def submit(self, scenario: Scenario, run: Path | None = None) -> Future[Outcome]:
        """Queue a scenario to be run, in a folder or in `folder` / its name, and compared."""
        run = run or self._folder / scenario.name
        failed = partial(_failed, scenario, run, time.perf_counter())
        job = _Job(scenario, run, self._overrides, self._exact)
        return self._workers.submit(_outcome, job, died=failed, late=failed, time_limit=TIMEOUT)

    def close(self) -> None:
        """Kill all running scenarios and start no more; a second call does nothing."""
        self._workers.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill all running scenarios."""
        self.close()


@dataclass(frozen=True)
class _Job:
    """What a process is to run and compare; see `Runner`."""

    scenario: Scenario
    run: Path
    overrides: Overrides
    exact: bool


def _outcome(job: _Job) -> Outcome:
    """Run a scenario in this process, and compare it."""
    began = time.perf_counter()
    try:
        done = run_scenario(job.scenario, job.run, Options(job.overrides))
        error = f"was stopped by signal {done.signal}" if done.signal else _unmeasured(job.run)
    except CosimError as failure:
        error = str(failure)
    seconds = time.perf_counter() - began
    if error:
        return _failed(job.scenario, job.run, began, error)
    return replace(_compared(job, seconds), criteria=_criteria(job.run))


def _failed(scenario: Scenario, run: Path, began: float, error: str) -> Outcome:
    seconds = time.perf_counter() - began
    return Outcome(scenario, "failed", run, seconds, error=error, criteria=_criteria(run))


def _criteria(run: Path) -> tuple[Criterion, ...]:
    return Criterion.read(read_summary(run)) if (run / SUMMARY_FILE).is_file() else ()


def _compared(job: _Job, seconds: float) -> Outcome:
    scenario, run = job.scenario, job.run
    if not reference_path(scenario).is_file():
        return _judged(scenario, run, seconds)
    try:
        reference = Reference.read(reference_path(scenario))
        comparison = compare_with_reference(
            Recording.open(run), read_summary(run), reference, scenario.regression, exact=job.exact
        )
    except CosimError as refused:
        return Outcome(scenario, "no reference", run, seconds, error=str(refused))
    return Outcome(scenario, "same" if comparison.ok else "differs", run, seconds, comparison)


def _unmeasured(run: Path) -> str:
    """Name the criteria that a complete run gave no value for, an error of the scenario; or ""."""
    summary = read_summary(run)
    return unmeasured_text(Criterion.read(summary)) if summary["complete"] else ""


def _judged(scenario: Scenario, run: Path, seconds: float) -> Outcome:
    """Judge a run without a reference by the scenario's criteria."""
    summary = read_summary(run)
    if not summary["criteria"]:
        path = reference_path(scenario)
        error = (
            f"{path}: does not exist; {how_to_make(path)} makes it, or give the scenario a section "
            "[success]"
        )
        return Outcome(scenario, "no reference", run, seconds, error=error)
    if summary["as_expected"]:
        return Outcome(scenario, "holds", run, seconds)
    return Outcome(scenario, "missed", run, seconds, error=unexpected_text(summary))


def read_summary(run: Path) -> dict[str, Any]:
    """Return the content of a run's `summary.json`."""
    summary: dict[str, Any] = json.loads((run / SUMMARY_FILE).read_text(encoding="utf-8"))
    return summary
