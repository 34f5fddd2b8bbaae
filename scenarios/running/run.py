"""Runs a scenario: FMUs, master, recording, summary."""

from __future__ import annotations

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...assets import STEP_SIZE
from ...fmus.errors import CosimError, InputError, SimulationError
from ...fmus.interface.tables import INTERFACES
from ...fmus.master.algorithm import Coupling, Master
from ...fmus.master.system import Session, check_step_timeout, open_session, panda_system
from ..definition.scenario import SCENARIO_FILE, TABLE_FILE, Scenario, load_scenario
from ..files import replacing, safe_name
from ..recording import Column, Recorder, Recording
from .exits import exit_guard
from .external import External
from .start import Overrides, StartValues, start_values
from .stepping import Plan, provenance, step_and_record
from .stopping import stopping_on_signals
from .summary import Summary, summarize

SUMMARY_FILE = "summary.json"
SCENARIO_FOLDER = "scenario"


@dataclass(frozen=True)
class Options:
    """How a scenario is run, beside what it says itself.

    Attributes:
        overrides: Parameters by instance and name.
        coupling: Instead of the scenario's; None: the scenario's.
        realtime: Speed relative to the wall clock; 0: as fast as it goes.
        fmus: FMU files by instance; None: the project's own.
        isolate: Run each FMU in a process of its own, where a crash ends only that.
        step_timeout: Time that a step of an isolated FMU may take [s wall time]; None: any.

    Raises:
        InputError: A value is out of its bounds, or there is a step_timeout without isolate.
    """

    overrides: Overrides = field(default_factory=dict)
    coupling: Coupling | None = None
    realtime: float = 0.0
    fmus: Mapping[str, Path] | None = None
    isolate: bool = False
    step_timeout: float | None = None

    def __post_init__(self) -> None:
        """Check what may have come from a command line."""
        if not (math.isfinite(self.realtime) and self.realtime >= 0.0):
            raise InputError(f"realtime: value {self.realtime!r}; must be a number of at least 0")
        check_step_timeout(self.step_timeout, isolate=self.isolate)


@dataclass(frozen=True)
class Run:
    """A run that has ended, whether or not it came to its end.

    Attributes:
        folder: Where its files are.
        summary: Metrics and verdict.
        signal: Number of the signal that stopped it, or 0.
        warnings: What the FMUs had to say.
    """

    folder: Path
    summary: Summary
    signal: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def recording(self) -> Recording:
        """What was recorded."""
        return Recording.open(self.folder)

    def plot(self, path: Path | None = None) -> Path:
        """Draw the plot.

        Args:
            path: Where to; None: `plot.png` in the run's folder.
        """
        from ..pictures.plot import plot_run  # noqa: PLC0415 - matplotlib takes its time

        path = path or self.folder / "plot.png"
        plot_run(self.recording, path)
        return path


def run_scenario(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    options: Options | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a scenario and keep all of it in a folder.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it.
        progress: Is told completed and all steps, a few times a second.

    Returns:
        The run.

    Raises:
        InputError: Something given cannot be used; nothing is written then.
        SimulationError: An FMU failed; what was recorded is kept, marked incomplete.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    options = options or Options()
    if options.coupling:
        scenario = replace(scenario, coupling=options.coupling)
    values = start_values(scenario, options.overrides)
    external = External(scenario, values)
    folder = Path(out) if out is not None else default_folder(scenario.name)
    refuse_existing(folder)
    warnings: list[str] = []

    def on_message(instance: str, status: str, text: str) -> None:
        warnings.append(f"{instance} {status.lower()}: {text}")

    def summarize_failure() -> None:
        with suppress(CosimError):  # the failure that is under way says more
            write_summary(folder, summarize(Recording.open(folder), scenario))

    with stopping_on_signals() as stop, exit_guard(folder, summarize_failure) as guard:
        try:
            with _session(scenario, values, options, on_message) as session:
                metadata = _metadata(scenario, values, session)
                with Recorder(folder, _columns(session.master), metadata) as recorder:
                    _copy_scenario(scenario, folder)
                    plan = Plan(scenario.ticks, external, options.realtime, progress)
                    report = step_and_record(session.master, plan, recorder, stop, guard)
        except SimulationError:
            summarize_failure()
            raise
        summary = summarize(Recording.open(folder), scenario, report)
        write_summary(folder, summary)
    return Run(folder, summary, stop.signal, tuple(warnings))


def _session(
    scenario: Scenario,
    values: StartValues,
    options: Options,
    on_message: Callable[[str, str, str], None],
) -> AbstractContextManager[Session]:
    return open_session(
        panda_system(with_push=bool(scenario.push), fmus=options.fmus),
        values,
        stop=scenario.duration,
        coupling=scenario.coupling,
        on_message=on_message,
        isolate=options.isolate,
        step_timeout=options.step_timeout,
    )


def default_folder(name: str) -> Path:
    """Return a new folder's path for a run of a scenario."""
    stem = f"{safe_name(name)}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, count = Path("runs") / stem, 1
    while folder.exists():
        count += 1
        folder = Path("runs") / f"{stem}-{count}"
    return folder


def refuse_existing(folder: Path) -> None:
    """Refuse a folder that holds something, as nothing is written over, or cannot be made.

    Raises:
        InputError: It does, it cannot be made, or it cannot be looked into.
    """
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: exists already; must be a new or an empty folder")
        there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
        if not there.is_dir():
            raise InputError(f"{folder}: cannot be written to: {there} is not a folder")
        if not os.access(there, os.W_OK):
            raise InputError(f"{folder}: cannot be written to: {there} is not yours to write to")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error


def _columns(master: Master) -> list[Column]:
    """Columns of the recording, with their units from the interface tables."""
    scalars = {(instance, s.name): s for instance, i in INTERFACES.items() for s in i.scalars()}
    columns = [Column("time", "s", "Time since the start")]
    for name in master.columns:
        scalar = scalars[name]
        columns.append(Column(".".join(name), scalar.unit, scalar.variable.description))
    return columns


def _metadata(scenario: Scenario, values: StartValues, session: Session) -> dict[str, Any]:
    return {
        "scenario": scenario.name,
        "purpose": scenario.purpose,
        "scene": values["plant"]["scene"],
        "gains": scenario.gains,
        "interpolation": scenario.interpolation,
        "coupling": scenario.coupling,
        "step_size": STEP_SIZE,
        "duration": scenario.duration,
        "row_times": [row.time for row in scenario.table.rows],
        "parameters": values,
        **provenance(session),
    }


def _copy_scenario(scenario: Scenario, folder: Path) -> None:
    """Keep what was run beside what came of it."""
    if scenario.folder is None:
        return
    with suppress(OSError):
        (folder / SCENARIO_FOLDER).mkdir(exist_ok=True)
        for name in (SCENARIO_FILE, TABLE_FILE):
            shutil.copyfile(scenario.folder / name, folder / SCENARIO_FOLDER / name)


def write_summary(folder: Path, summary: Summary) -> None:
    """Write summary.json.

    Raises:
        InputError: The folder cannot be written to.
    """
    text = json.dumps(_json(summary.to_dict()), indent=2, allow_nan=False)
    with replacing(folder / SUMMARY_FILE) as path:
        path.write_text(text + "\n", encoding="utf-8")


def _json(value: Any) -> Any:
    """Put null where a number is not finite, which JSON cannot hold: a run that diverged."""
    if isinstance(value, dict):
        return {key: _json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


__all__ = ["CosimError", "Options", "Run", "default_folder", "run_scenario"]
