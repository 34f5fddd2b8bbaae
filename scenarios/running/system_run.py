"""Runs a coupled system from an .ssp file, whatever its FMUs are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...fmus.errors import InputError
from ...fmus.master.algorithm import Report
from ...fmus.master.ssp_reader import CoupledSystem, system_from_ssp
from ...fmus.master.system import OpenSystem, open_system
from ..recording import Column, Recorder
from .exits import exit_guard
from .folders import claimed_folder
from .run import Options
from .stepping import Stepping, provenance, step_and_record
from .stopping import stopping_on_signals

MAX_STEPS = 3_600_000  # an hour at 1 ms, as for scenarios


@dataclass(frozen=True)
class SystemRun:
    """A run of a system that has ended, whether or not it came to its end.

    Attributes:
        folder: Where its recording is.
        report: How the stepping went.
        simulated: Simulated time [s].
        signal: Number of the signal that stopped it, or 0.
        warnings: What the FMUs had to say.
    """

    folder: Path
    report: Report
    simulated: float
    signal: int = 0
    warnings: tuple[str, ...] = ()


def run_system(  # noqa: PLR0913 - a run has this many sides
    path: Path,
    out: Path | None = None,
    options: Options | None = None,
    *,
    stop_time: float | None = None,
    duration: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SystemRun:
    """Run the system of an .ssp file and record all its outputs.

    Args:
        path: The file.
        out: New folder for the recording; None: one named by system and time, in `runs`.
        options: How to run it; its overrides and FMU files do not apply.
        stop_time: When to stop [s]; None: the file's default experiment.
        duration: How long to run [s], in place of a stop time.
        progress: Is told completed and all steps, a few times a second.

    Returns:
        The run.

    Raises:
        InputError: The file or an option cannot be used; nothing is written then.
        SimulationError: An FMU failed; what was recorded is kept, marked incomplete.
    """
    options = options or Options()
    coupled = system_from_ssp(path)
    end = coupled.stop_time if stop_time is None else stop_time
    if duration is not None:
        end = coupled.start_time + duration
    steps = _whole_steps(path, end - coupled.start_time, coupled.step_size)
    warnings = list(coupled.warnings)
    with (
        claimed_folder(out, coupled.name, retry=options.retry) as folder,
        stopping_on_signals() as stop,
        exit_guard(folder) as guard,
        open_system(
            coupled.system,
            coupled.start_values,
            stop=end,
            start=coupled.start_time,
            step_size=coupled.step_size,
            coupling=options.coupling or "gauss-seidel",
            on_message=lambda name, status, text: warnings.append(f"{name} {status}: {text}"),
            isolate=options.isolate,
            step_timeout=options.step_timeout,
        ) as opened,
        Recorder(folder, _columns(opened), _metadata(path, coupled, opened)) as recorder,
    ):
        stepping = Stepping(
            steps, np.zeros((steps + 1, 0)), options.realtime, progress, options.time_limit
        )
        report = step_and_record(opened.master, stepping, recorder, stop, guard)
    return SystemRun(folder, report, report.steps * coupled.step_size, stop.signal, tuple(warnings))


def _whole_steps(path: Path, duration: float, step_size: float) -> int:
    steps = duration / step_size
    count = round(steps) if 0 < steps <= 2 * MAX_STEPS else 0
    off = abs(count * step_size - duration)
    if not 1 <= count <= MAX_STEPS or off > 1e-9 * max(duration, 1.0):
        raise InputError(
            f"{path}: {duration!r} s from start to stop; must be a whole number of steps of "
            f"{step_size:g} s, between {step_size:g} and {MAX_STEPS * step_size:g} s"
        )
    return count


def _columns(opened: OpenSystem) -> list[Column]:
    """Columns of the recording, with units from the model descriptions."""
    columns = [Column("time", "s", "Time since the start")]
    sources: dict[str, tuple[str, str]] = {}
    for instance, name in opened.master.columns:
        variable = opened.fmus[instance].variable(name)
        column = f"{instance}.{name}"
        other = sources.setdefault(column, (instance, name))
        if other != (instance, name):
            raise InputError(
                f"components {other[0]!r} and {instance!r}: {other[1]!r} and {name!r} would both "
                f"be column {column} of the recording; rename one of the components"
            )
        columns.append(Column(column, variable.unit or "", variable.description or ""))
    return columns


def _metadata(path: Path, coupled: CoupledSystem, opened: OpenSystem) -> dict[str, object]:
    return {
        "system": coupled.name,
        "file": path.name,
        "coupling": opened.master.coupling,
        "start_time": coupled.start_time,
        "step_size": coupled.step_size,
        "parameters": {name: dict(values) for name, values in coupled.start_values.items()},
        **provenance(opened),
    }
