"""Results of a run: recording, scenario, journal and summary, or only what is in memory."""

from __future__ import annotations

import json
import os
import platform
import sys
from contextlib import nullcontext, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from ..fmus.atomic import write_whole
from ..fmus.build.identity import package_version
from ..fmus.errors import InputError
from ..fmus.interface.engine import COUNTED, WARNINGS
from ..fmus.master.system import OpenSystem
from ..result.judging.summary import SUMMARY_FILE, Summary
from ..result.judging.verdict import Verdict
from ..result.recording import MemoryRecorder, Recorder, Recording
from ..task.scenario import is_shipped
from .folder import SCENARIO_FOLDER, keep_scenario
from .journal import JOURNAL_FILE, Action, Head, append_action, begin_journal
from .prepare import Prepared
from .start import played_rows
from .summary import summarize

PACKAGES: Final = ("panda-cosim", "fmpy", "mujoco", "numpy", "pythonfmu")


class Output:
    """Takes the rows and actions of a run, and judges it at its end."""

    def __init__(
        self, prepared: Prepared, system: OpenSystem, folder: Path, *, writes: bool, journals: bool
    ) -> None:
        self.system, self._prepared, self._writes = system, prepared, writes
        system.master.timed = prepared.options.profile
        self._place = folder.absolute()  # an FMU may change the working directory
        self._journal = self._place / JOURNAL_FILE if journals else None
        columns = prepared.assembly.recorded(prepared.scenario.coupling)
        self.signals = tuple(column.name for column in columns)
        self.columns: dict[str, list[int]] = {}  # of the master's rows, by signal
        for number, name in enumerate(self.signals):
            self.columns.setdefault(name.partition("[")[0], []).append(number)
        provenance = _provenance(system, prepared.scenario.mujoco) if writes else {}
        code = {name: fmu.code for name, fmu in system.fmus.items()}
        metadata = {**_metadata(prepared), "code": code, **provenance}
        metadata |= {"session": JOURNAL_FILE} if journals else {}
        make = Recorder if writes else MemoryRecorder
        self.recorder: MemoryRecorder = make(folder, columns, metadata)
        self.head = Head(
            format=1,
            scenario=prepared.scenario.name,
            kind=prepared.options.kind,
            fmus=provenance.get("fmus", {}),
        )

    def begin(self) -> None:
        """Write the scenario, and the journal's head."""
        if self._writes:
            # A full disk: the run itself matters more, but a session could not be repeated.
            with nullcontext() if self._journal else suppress(InputError):
                folder = self._place / SCENARIO_FOLDER
                keep_scenario(self._prepared.scenario, self._prepared.assembly, folder)
        if self._journal:
            begin_journal(self._journal, self.head)

    def note(self, action: Action) -> None:
        """Write an action to the journal, if there is one."""
        if self._journal:
            append_action(self._journal, action)

    def mark(self) -> tuple[tuple[int, int], int]:
        """Return how much is recorded and written in the journal, for `go_back`."""
        return self.recorder.mark(), self._journal.stat().st_size if self._journal else 0

    def go_back(self, mark: tuple[tuple[int, int], int]) -> None:
        """Drop what was recorded, and written in the journal, after a mark."""
        self.recorder.go_back(mark[0])
        if self._journal:
            os.truncate(self._journal, mark[1])

    def count_warnings(self) -> None:
        """Keep how often the engines of models have warned, by FMU and kind."""
        engine: dict[str, int] = {}
        for name, fmu in self.system.fmus.items():
            if COUNTED.names()[0] in fmu.variables:
                numbers = zip(WARNINGS, self.system.slaves[name].read(COUNTED.names()), strict=True)
                engine |= {f"{name}.{kind}": int(number) for kind, number in numbers}
        self.recorder.late |= {"engine": engine} if engine else {}

    @property
    def in_memory(self) -> Recording | None:
        """The recording, if memory holds it."""
        return self.recorder.recording()

    def judge(self, end: Verdict) -> Summary:
        """Measure and judge what has been recorded, which ended so, and write the summary."""
        recording = self.in_memory or Recording.open(self._place)
        statistics, fmus = self.system.master.statistics, self.system.fmus.values()
        costs_in_python = any(fmu.code == "python" for fmu in fmus)
        is_iterated = self.system.master.coupling == "iterated"
        if self._prepared.options.profile or (is_iterated and costs_in_python):
            statistics.spent = self.system.master.spent()
        summary = summarize(recording, self._prepared.scenario, statistics, end)
        if self._writes:
            text = json.dumps(summary.to_dict(), indent=2, allow_nan=False)
            write_whole(self._place / SUMMARY_FILE, text + "\n")
        return summary


def _metadata(prepared: Prepared) -> dict[str, object]:
    """Metadata of the recording, as JSON holds it."""
    scenario, values, assembly = prepared.scenario, prepared.values, prepared.assembly
    ours: dict[str, object] = {}
    if scenario.system:
        ours |= {"system": Path(scenario.system).name, "start_time": assembly.start_time}
    scene = values.get("plant", {}).get("scene")
    ours |= {"scene": scene} if isinstance(scene, str) else {}  # in an .ssp file, a number
    ours |= {"mujoco": scenario.mujoco} if scenario.mujoco else {}
    if not scenario.is_system:
        times, names = played_rows(scenario, values)
        ours |= {name: getattr(scenario, name) for name in ("robot", "gains", "interpolation")}
        ours |= {"row_times": times, "row_names": names}
    if scenario.folder is not None and not is_shipped(scenario):
        ours["scenario_folder"] = str(scenario.folder.resolve())  # where its reference is
    return {
        "scenario": scenario.name,
        "purpose": scenario.purpose,
        **ours,
        "coupling": scenario.coupling,
        "order": [*assembly.interfaces],
        "late": assembly.late(scenario.coupling),
        "step_size": scenario.step,
        "duration": scenario.duration,
        "parameters": values,
    }


def _provenance(system: OpenSystem, engine: str) -> dict[str, Any]:
    """FMUs, versions and platform of a recording, for its metadata."""
    return {
        "fmus": {
            name: {"guid": fmu.guid, "sha256": fmu.sha256, "model": fmu.description.modelName}
            for name, fmu in system.fmus.items()
        },
        "versions": versions() | ({"mujoco": engine} if engine else {}),
        "platform": f"{sys.platform} {platform.machine()}",
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that runs use, as far as they are installed."""
    installed = (name for name in PACKAGES if find_spec(name.replace("-", "_")))
    return {"python": platform.python_version()} | {n: package_version(n) for n in installed}
