"""Runs scenarios, each in a separate process, and compares them with reference recordings."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from threading import Lock
from typing import IO, Any, Final, Literal, Self

from ...fmus.errors import CosimError
from ...fmus.processes import SAFE_PATH
from ..definition.scenario import Scenario
from ..definition.tolerances import Tolerances
from ..judging.criterion import Criterion, unmeasured_text
from ..recording import Recording
from ..running.folders import SUMMARY_FILE
from ..running.start import Overrides
from .compare import Comparison, compare_with_reference
from .guards import unexpected_text
from .reference import Reference, Unusable, how_to_make, reference_path

Verdict = Literal["same", "differs", "failed", "holds", "missed", "no reference"]
PASSED: Final = ("same", "holds")

TIMEOUT: Final = 600.0  # [s] wall time of one scenario; a hanging one must not hang the others
WORKER: Final = "panda_cosim.scenarios.regression.worker"
# The processes already share the cores, and a fixed order of sums gives the same bits.
ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_TAIL = 300  # characters kept of a crashed process's last output


@dataclass(frozen=True)
class Outcome:
    """The outcome of one scenario.

    Attributes:
        scenario: The scenario, or the folder that could not be used.
        verdict: `same` as the reference, `differs` from it, or `failed` to run. Without a
            reference: `holds` or `missed` by its criteria; `no reference` if it has none of these,
            or the reference is damaged.
        run: Folder of the run.
        seconds: Wall time, with the start of the process [s].
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
        self._folder = folder
        self._overrides = overrides or {}
        self._exact = exact
        self._pool = ThreadPoolExecutor(jobs)
        self._lock = Lock()  # of the two below
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._closed = False

    def submit(self, scenario: Scenario, run: Path | None = None) -> Future[Outcome]:
        """Queue a scenario to be run and compared.

        Args:
            scenario: The scenario.
            run: Folder of the run; None: `folder` / name of the scenario.
        """
        return self._pool.submit(self._run, scenario, run or self._folder / scenario.name)

    def close(self) -> None:
        """Kill all running scenarios and start no more; a second call does nothing."""
        with self._lock:
            self._closed = True
            for process in self._processes:
                process.kill()
        self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill all running scenarios."""
        self.close()

    def _run(self, scenario: Scenario, run: Path) -> Outcome:
        started = time.perf_counter()
        error = self._run_worker(scenario, run)
        outcome = self._outcome(scenario, run, time.perf_counter() - started, error)
        judged = Criterion.read(read_summary(run)) if (run / SUMMARY_FILE).is_file() else ()
        return replace(outcome, criteria=judged)

    def _outcome(self, scenario: Scenario, run: Path, seconds: float, error: str) -> Outcome:
        if error:
            return Outcome(scenario, "failed", run, seconds, error=error)
        if unmeasured := _unmeasured(run):
            return Outcome(scenario, "failed", run, seconds, error=unmeasured)
        if not reference_path(scenario).is_file():
            return _judged(scenario, run, seconds)
        try:
            reference = Reference.read(reference_path(scenario))
            comparison = compare_with_reference(
                Recording.open(run),
                read_summary(run),
                reference,
                scenario.regression,
                exact=self._exact,
            )
        except CosimError as refused:
            return Outcome(scenario, "no reference", run, seconds, error=str(refused))
        return Outcome(scenario, "same" if comparison.ok else "differs", run, seconds, comparison)

    def _run_worker(self, scenario: Scenario, run: Path) -> str:
        """Run a scenario in a separate process; return why it failed, or ""."""
        run.parent.mkdir(parents=True, exist_ok=True)
        error_file = run.with_name(f"{run.name}.error")
        job = {
            "scenario": str(scenario.folder),
            "out": str(run),
            "overrides": self._overrides,
            "error_file": str(error_file),
            "parent": os.getpid(),
        }
        # Files and not pipes, whose end may never come: an FMU's own processes inherit them.
        with TemporaryFile(dir=run.parent) as output, TemporaryFile(dir=run.parent) as errors:
            with self._lock:
                if self._closed:
                    return "was not started"
                process = _start(job, output, errors)
                self._processes.add(process)
            try:
                code = process.wait(TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                return f"took more than {TIMEOUT:g} s and was killed"
            finally:
                with self._lock:
                    self._processes.discard(process)
            return reason_of(code, error_file, _text(errors) or _text(output))


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


def _start(job: dict[str, Any], output: IO[bytes], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", WORKER, json.dumps(job)],
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=errors,
        env={**os.environ, **ONE_THREAD, **SAFE_PATH},
    )


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


def reason_of(code: int, error_file: Path, said: str) -> str:
    """Return why a process failed, or "". On a full disk, its file is missing or empty."""
    if code and error_file.is_file():
        reason = error_file.read_text(encoding="utf-8", errors="replace")
        return reason or _last_words(code, said)
    return _last_words(code, said) if code else ""


def _last_words(code: int, text: str) -> str:
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    said = " ".join(text[-_TAIL:].split())
    return f"its process ended with {how}{f': {said}' if said else ''}"


def read_summary(run: Path) -> dict[str, Any]:
    """Return the content of a run's `summary.json`."""
    summary: dict[str, Any] = json.loads((run / SUMMARY_FILE).read_text(encoding="utf-8"))
    return summary


__all__ = ["Outcome", "Runner", "Unusable"]
