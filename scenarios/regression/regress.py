"""Runs a suite of scenarios, each in a process of its own, and compares it with its references."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from ...fmus.errors import CosimError, InputError
from ...fmus.messages import did_you_mean, excerpt
from ..definition.scenario import SCENARIO_FILE, Scenario, shipped_scenarios
from ..recording import Recording
from ..running.run import SUMMARY_FILE
from ..running.start import Overrides, start_values
from .compare import Comparison, compare
from .reference import Reference, reference_path
from .worker import ERROR_FILE

Verdict = Literal["same", "differs", "failed", "no reference"]

TIMEOUT: Final = 600.0  # [s] wall time of one scenario; a run that hangs shall not hang the suite
_TAIL = 300  # characters of a crashed process's last words


@dataclass(frozen=True)
class Outcome:
    """What came of one scenario.

    Attributes:
        scenario: What was run.
        verdict: `same` as the reference, `differs` from it, `failed` to run, or `no reference`.
        run: Folder of the run.
        seconds: Wall time, with the start of the process [s].
        comparison: With the reference; None: there is none, or the run failed.
        error: Why it failed, or why the reference cannot be used.
    """

    scenario: Scenario
    verdict: Verdict
    run: Path
    seconds: float
    comparison: Comparison | None = None
    error: str = ""

    @property
    def ok(self) -> bool:
        """Whether the run is what it should be."""
        return self.verdict == "same"

    @property
    def reason(self) -> str:
        """What is wrong, in one line; empty where nothing is."""
        if self.comparison is not None and self.comparison.problems:
            return "; ".join(problem.text for problem in self.comparison.problems)
        return self.error

    @property
    def summary(self) -> dict[str, Any]:
        """What `summary.json` of the run holds."""
        return read_summary(self.run)

    @property
    def reference_path(self) -> Path:
        """Where the scenario's reference is, or would be."""
        return reference_path(self.scenario)


@dataclass(frozen=True)
class Suite:
    """What is run, and how.

    Attributes:
        scenarios: What is run.
        out: Folder that the runs are put in.
        overrides: Parameters by instance and name, instead of the scenarios' own.
        exact: Whether each bit has to be the reference's.
        jobs: How many run at the same time.

    Raises:
        InputError: A parameter cannot be used.
    """

    scenarios: Sequence[Scenario]
    out: Path
    overrides: Overrides = field(default_factory=dict)
    exact: bool = False
    jobs: int = 1

    def __post_init__(self) -> None:
        """Check the parameters, before anything runs."""
        for scenario in self.scenarios:
            start_values(scenario, self.overrides)

    def start(self) -> tuple[ThreadPoolExecutor, dict[str, Future[Outcome]]]:
        """Start all, the longest first; return the executor, and what will come, by name.

        Raises:
            InputError: The FMUs cannot be written.
        """
        from ...fmus.packaging.build import build  # noqa: PLC0415 - imports much

        build()  # once, not in each process
        pool = ThreadPoolExecutor(self.jobs)
        longest_first = sorted(self.scenarios, key=lambda s: -s.duration)
        return pool, {s.name: pool.submit(self.run_one, s) for s in longest_first}

    def run_one(self, scenario: Scenario) -> Outcome:
        """Run one scenario and compare it."""
        folder = self.out / scenario.name
        started = time.perf_counter()
        error = run_apart(scenario, folder, self.overrides)
        seconds = time.perf_counter() - started
        if error:
            return Outcome(scenario, "failed", folder, seconds, error=error)
        try:
            return self._judge(scenario, folder, seconds)
        except CosimError as refused:
            return Outcome(scenario, "no reference", folder, seconds, error=str(refused))

    def _judge(self, scenario: Scenario, folder: Path, seconds: float) -> Outcome:
        reference = Reference.read(reference_path(scenario))
        comparison = compare(
            Recording.open(folder),
            read_summary(folder),
            reference,
            scenario.regression,
            exact=self.exact,
        )
        verdict: Verdict = "same" if comparison.ok else "differs"
        return Outcome(scenario, verdict, folder, seconds, comparison)


def run_suite(suite: Suite, tell: Callable[[Outcome], None] | None = None) -> list[Outcome]:
    """Run a suite to its end.

    Args:
        suite: What to run.
        tell: Is told each outcome as it comes.

    Returns:
        The outcomes, in the suite's order.

    Raises:
        InputError: The FMUs cannot be written.
    """
    pool, futures = suite.start()
    try:
        for future in as_completed(futures.values()):
            if tell is not None:
                tell(future.result())
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
    return [futures[scenario.name].result() for scenario in suite.scenarios]


def exit_code(outcomes: Iterable[Outcome]) -> int:
    """Return 0 where all is the same, 1 where something differs, 2 where a reference lacks."""
    verdicts = {outcome.verdict for outcome in outcomes}
    if verdicts & {"differs", "failed"}:
        return CosimError.exit_code
    return InputError.exit_code if "no reference" in verdicts else 0


def find_scenarios(names: Sequence[str] = (), folder: Path | None = None) -> list[Scenario]:
    """Load scenarios by name, or all of them.

    Args:
        names: Names in `folder`, or folders of scenarios; none: all in `folder`.
        folder: A folder of scenario folders; None: the one that comes with the package.

    Raises:
        InputError: There are none, one cannot be used, or two have one name.
    """
    known = shipped_scenarios() if folder is None else _scenarios_in(folder)
    place = "the shipped ones" if folder is None else str(folder)
    found = [Scenario.read(_choose(name, known, place)) for name in names or known]
    for name in (scenario.name for scenario in found):
        if sum(scenario.name == name for scenario in found) > 1:
            raise InputError(f"scenario {name!r}: is given twice; must be given once")
    return found


def _scenarios_in(folder: Path) -> dict[str, Path]:
    if (folder / SCENARIO_FILE).is_file():
        return {folder.resolve().name: folder}
    found = {file.parent.name: file.parent for file in sorted(folder.glob(f"*/{SCENARIO_FILE}"))}
    if not found:
        raise InputError(f"{folder}: no scenarios there; must hold folders with {SCENARIO_FILE}")
    return found


def _choose(name: str, known: Mapping[str, Path], place: str) -> Path:
    if name in known:
        return known[name]
    if (Path(name) / SCENARIO_FILE).is_file():
        return Path(name)
    raise InputError(
        f"scenario {excerpt(name)}: none of {place}, and no folder with {SCENARIO_FILE}; valid: "
        f"{', '.join(known)}{did_you_mean(name, known)}"
    )


def run_apart(scenario: Scenario, folder: Path, overrides: Overrides) -> str:
    """Run a scenario in a process of its own.

    Returns:
        Why it failed, in one line; empty if it did not.
    """
    job = folder.parent / f".{folder.name}" / "job.json"
    job.parent.mkdir(parents=True, exist_ok=True)
    error_file = job.with_name(ERROR_FILE)
    error_file.unlink(missing_ok=True)
    source = str(scenario.folder)
    job.write_text(json.dumps({"folder": source, "out": str(folder), "overrides": overrides}))
    command = [sys.executable, "-m", "panda_cosim.scenarios.regression.worker", str(job)]
    try:
        child = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT,
            check=False,
            env={**os.environ, **ONE_THREAD},
        )
    except subprocess.TimeoutExpired:
        return f"took more than {TIMEOUT:g} s and was ended"
    if error_file.is_file():
        return str(json.loads(error_file.read_text(encoding="utf-8"))["message"])
    if child.returncode:
        return _last_words(child.returncode, child.stderr or child.stdout)
    return ""


ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Processes share the cores by themselves; and sums in one order give the same bits."""


def _last_words(code: int, text: str) -> str:
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    said = " ".join(text[-_TAIL:].split())
    return f"its process ended with {how}{f': {said}' if said else ''}"


def read_summary(run: Path) -> dict[str, Any]:
    """Return what `summary.json` of a run holds."""
    summary: dict[str, Any] = json.loads((run / SUMMARY_FILE).read_text(encoding="utf-8"))
    return summary


__all__ = ["Outcome", "Suite", "exit_code", "find_scenarios", "run_suite"]
