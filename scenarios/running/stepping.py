"""Steps a system and records it until the end or a stop request; shared by all kinds of runs."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from ...fmus.master.master import Master
from ...fmus.master.realtime import RunStatistics
from ...fmus.master.row_buffer import ExternalInputs
from ...fmus.master.system import OpenSystem
from ..recording import AnyRecorder
from .exits import ExitGuard
from .stopping import StopRequest

PACKAGES = ("panda-cosim", "fmpy", "mujoco", "numpy", "pythonfmu")


@dataclass(frozen=True)
class Stepping:
    """Options of stepping an open system.

    Attributes:
        steps: Number of communication steps.
        external: External inputs at each instant, as `Master.run` takes them.
        realtime: Speed relative to the wall clock; 0: as fast as possible.
        progress: Called with the completed and the total steps, a few times a second.
        time_limit: Wall time after which the run is stopped [s]; None: unlimited.
    """

    steps: int
    external: ExternalInputs
    realtime: float = 0.0
    progress: Callable[[int, int], None] | None = None
    time_limit: float | None = None


def step_and_record(
    master: Master, stepping: Stepping, recorder: AnyRecorder, stop: StopRequest, guard: ExitGuard
) -> RunStatistics:
    """Step to the end or until asked to stop, and close the recording.

    Args:
        master: The coupled system.
        stepping: How far and how fast.
        recorder: Takes the rows.
        stop: Stop request to watch.
        guard: Saves the run if an FMU ends the process.

    Raises:
        SimulationError: An FMU fails, or the disk is full.
    """
    stop.watch(master, stepping.time_limit)
    guard.watch(master, recorder)

    def look(done: int) -> None:
        stop.poll()
        if stepping.progress is not None:
            stepping.progress(done, stepping.steps)

    statistics = master.run(
        stepping.steps,
        stepping.external,
        recorder.append,
        realtime=stepping.realtime,
        progress=look,
    )
    guard.check()
    finished = statistics.steps == stepping.steps
    reason = None if finished else f"stopped by {stop.reason or 'request'}"
    recorder.close(complete=finished, reason=reason)
    return statistics


def provenance(opened: OpenSystem) -> dict[str, Any]:
    """FMUs, versions and platform of a recording, for its metadata."""
    return {
        "fmus": {
            name: {"guid": fmu.guid, "sha256": fmu.sha256, "model": fmu.description.modelName}
            for name, fmu in opened.fmus.items()
        },
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
        "platform": f"{sys.platform} {platform.machine()}",
    }
