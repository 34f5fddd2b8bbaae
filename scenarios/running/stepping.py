"""What every run has in common: the master steps, the recorder writes, a signal stops both."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from ...fmus.master.algorithm import Master, Report
from ...fmus.master.rows import Given
from ...fmus.master.system import Session
from ..recording import AnyRecorder
from .exits import ExitGuard
from .stopping import StopRequest

PACKAGES = ("panda-cosim", "fmpy", "mujoco", "numpy", "pythonfmu")


@dataclass(frozen=True)
class Plan:
    """How a session is stepped.

    Attributes:
        steps: Number of communication steps.
        external: External inputs at each instant, as `Master.run` takes them.
        realtime: Speed relative to the wall clock; 0: as fast as it goes.
        progress: Is told completed and all steps, a few times a second; None: nobody is.
        time_limit: Wall time after which the run is stopped [s]; None: any.
    """

    steps: int
    external: Given
    realtime: float = 0.0
    progress: Callable[[int, int], None] | None = None
    time_limit: float | None = None


def step_and_record(
    master: Master, plan: Plan, recorder: AnyRecorder, stop: StopRequest, guard: ExitGuard
) -> Report:
    """Step to the end or until asked to stop, and close the recording with what became of it.

    Args:
        master: What steps.
        plan: How far and how fast.
        recorder: Where the rows go.
        stop: What may ask to stop.
        guard: What saves the run if an FMU ends the process.

    Raises:
        SimulationError: An FMU fails, or the disk is full.
    """
    stop.watch(master, plan.time_limit)
    guard.watch(master, recorder)

    def look(done: int) -> None:
        stop.poll()
        if plan.progress is not None:
            plan.progress(done, plan.steps)

    report = master.run(
        plan.steps,
        plan.external,
        recorder.append,
        realtime=plan.realtime,
        progress=look,
    )
    guard.check()
    finished = report.steps == plan.steps
    reason = None if finished else f"stopped by {stop.reason or 'request'}"
    recorder.close(complete=finished, reason=reason)
    return report


def provenance(session: Session) -> dict[str, Any]:
    """What made a recording: FMUs, versions and platform, for its metadata."""
    return {
        "fmus": {
            name: {"guid": fmu.guid, "sha256": fmu.sha256, "model": fmu.description.modelName}
            for name, fmu in session.fmus.items()
        },
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
        "platform": f"{sys.platform} {platform.machine()}",
    }
