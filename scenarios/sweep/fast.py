"""Runs our own plant and controller many times over, without writing anything.

What `run_scenario` repeats for each run is done once: the FMUs' files are read, and no folder is
needed. FMUs, start values, master and metrics are the same, and so are the bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...fmus.master.fmu_file import Fmu
from ...fmus.master.realtime import RunStatistics
from ...fmus.master.system import OpenSystem, open_system, panda_system
from ..definition.scenario import Scenario
from ..recording import MemoryRecorder
from ..running.external import ScenarioInputs
from ..running.run import Run
from ..running.run_files import columns_of
from ..running.start import start_values
from ..running.stopping import StopRequest
from ..running.summary import summarize


class FastPath:
    """Runs scenarios without FMUs of their own.

    Args:
        fmus: The project's FMU files by instance; they must not change.
    """

    def __init__(self, fmus: Mapping[str, Path]) -> None:
        self._files = fmus
        self._read = {name: Fmu(path) for name, path in fmus.items()}

    def run(self, scenario: Scenario, time_limit: float | None = None) -> Run:
        """Run a scenario.

        Args:
            scenario: The scenario.
            time_limit: Wall time after which it is stopped [s]; None: unlimited.

        Returns:
            The run, with its recording in memory.

        Raises:
            InputError: Something in the scenario cannot be used.
            SimulationError: An FMU fails.
        """
        values = start_values(scenario)
        external = ScenarioInputs(scenario, values)
        system = panda_system(pushed=scenario.pushed, fmus=self._files, asked=scenario.asked)
        with open_system(
            replace(system, refuses_non_finite=True),  # they are our own
            values,
            stop=scenario.duration,
            coupling=scenario.coupling,
            fmus=self._read,
        ) as opened:
            recorder = MemoryRecorder(Path(), columns_of(opened.master), {})
            statistics = self._step(opened, scenario.ticks, external, recorder, time_limit)
        recording = recorder.recording()
        return Run(Path(), summarize(recording, scenario, statistics), in_memory=recording)

    def _step(
        self,
        opened: OpenSystem,
        ticks: int,
        external: ScenarioInputs,
        recorder: MemoryRecorder,
        time_limit: float | None,
    ) -> RunStatistics:
        stop = StopRequest()
        stop.watch(opened.master, time_limit)
        statistics = opened.master.run(
            ticks, external, recorder.append, progress=lambda _: stop.poll()
        )
        reason = None if statistics.steps == ticks else f"stopped by {stop.reason}"
        recorder.close(complete=reason is None, reason=reason)
        return statistics


__all__ = ["FastPath"]
