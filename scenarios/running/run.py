"""Runs a scenario: FMUs, master, recording, summary."""

from __future__ import annotations

import json
import math
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...fmus.errors import CosimError, InputError, SimulationError
from ...fmus.interface.tables import INTERFACES
from ...fmus.master.master import Master
from ...fmus.master.step import Coupling
from ...fmus.master.system import OpenSystem, check_step_timeout, open_system, panda_system
from ...fmus.packaging.build import Kind
from ..definition.scenario import Scenario, is_shipped, load_scenario
from ..fields import Quantity
from ..files import replacing
from ..recording import AnyRecorder, Column, MemoryRecorder, Recorder, Recording
from .assembly import Assembly, assemble
from .exits import exit_guard
from .external import ScenarioInputs
from .fmu_files import keep_scenario, taken
from .folders import SCENARIO_FOLDER, SUMMARY_FILE, claimed_folder
from .notebook import SHEET_FILE, Picture, Video, run_html
from .start import Overrides, StartValues, check_criteria, start_values
from .stepping import Stepping, provenance, step_and_record
from .stopping import stopping_on_signals
from .summary import Summary, summarize

if TYPE_CHECKING:
    from ..view.inline import Inline
    from ..view.run import Shown

MAX_TIME_LIMIT = 1e9  # [s]


@dataclass(frozen=True)
class Options:
    """Options of a run, besides the scenario's own settings.

    Attributes:
        overrides: Parameters by instance and name.
        coupling: Coupling, instead of the scenario's; None: the scenario's.
        realtime: Speed relative to the wall clock; 0: as fast as possible.
        fmus: FMU files by instance; None: the project's own.
        kind: Kind of the project's own: "native" or "python".
        isolate: Run each FMU in a separate process, so that a crash ends only that process.
        step_timeout: Wall time that a step of an isolated FMU may take [s]; None: unlimited.
        time_limit: Wall time that all steps may take [s]; None: unlimited. Checked between
            steps; for an FMU that hangs in a step, use `isolate` and `step_timeout`.
        keep_recording: False: the recording stays in memory, and only the summary is kept.
        retry: Replace the files of a killed or failed run in the folder.
        parts: FMUs by instance, instead of the scenario's [fmus]; paths are relative to the
            working directory.

    Raises:
        InputError: A value is out of bounds, or step_timeout is given without isolate.
    """

    overrides: Overrides = field(default_factory=dict)
    coupling: Coupling | None = None
    realtime: float = 0.0
    fmus: Mapping[str, Path] | None = None
    kind: Kind = "native"
    isolate: bool = False
    step_timeout: float | None = None
    time_limit: float | None = None
    keep_recording: bool = True
    retry: bool = False
    parts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check values that may come from a command line."""
        if not (math.isfinite(self.realtime) and self.realtime >= 0.0):
            raise InputError(f"realtime: value {self.realtime!r}; must be a number of at least 0")
        check_step_timeout(self.step_timeout, isolate=self.isolate)
        if self.time_limit is not None:
            Quantity(0.0, MAX_TIME_LIMIT, "s").check("time_limit", self.time_limit)


@dataclass(frozen=True)
class Run:
    """A finished run, complete or not.

    Attributes:
        folder: The folder with its files.
        summary: Metrics and verdict.
        signal: Number of the signal that stopped it, or 0.
        warnings: Messages of the FMUs.
        in_memory: The recording, if it was not kept in the folder.
    """

    folder: Path
    summary: Summary
    signal: int = 0
    warnings: tuple[str, ...] = ()
    in_memory: Recording | None = None

    @property
    def recording(self) -> Recording:
        """The recording."""
        return Recording.open(self.folder) if self.in_memory is None else self.in_memory

    def plot(self, path: Path | None = None) -> Picture:
        """Draw the plot; a notebook shows it.

        Args:
            path: Where to; None: `plot.png` in the run's folder.
        """
        from ..pictures.plot import plot_run  # noqa: PLC0415 - matplotlib takes its time

        return Picture(plot_run(self.recording, path or self.folder / "plot.png"))

    def render(self, path: Path | None = None, *, camera: str = "overview") -> Video:
        """Draw the video; a notebook shows it.

        Args:
            path: Where to; None: `video.mp4` in the run's folder.
            camera: Name of a camera of the scene.
        """
        from ..pictures.video import render_video  # noqa: PLC0415 - slow to import

        path = path or self.folder / "video.mp4"
        return Video(render_video(self.recording, path, camera=camera))

    def sheet(self, path: Path | None = None) -> Picture:
        """Draw the contact sheet; a notebook shows it, also with the run's table.

        Args:
            path: Where to; None: `contact_sheet.png` in the run's folder.
        """
        from ..pictures.sheet import contact_sheet  # noqa: PLC0415 - slow to import

        return Picture(contact_sheet(self.recording, path or self.folder / SHEET_FILE))

    def _repr_html_(self) -> str:
        """Return the verdict's table and the contact sheet, for a notebook."""
        return run_html(self)

    def shown(self, name: str | None = None) -> Shown:
        """Return the run for the view.

        Args:
            name: Its name on the page; None: the folder's.
        """
        from ..view.export import show_source  # noqa: PLC0415 - slow to import

        name = name or self.folder.resolve().name
        return show_source(self.recording, name, summary=_json(self.summary.to_dict()))

    def view(self, against: Run | None = None, *, height: int = 640) -> Inline:
        """Show the run in 3D: in a notebook the result is the page, inline.

        Args:
            against: Another run, shown as a ghost.
            height: Of the page in the notebook [px].
        """
        from ..view.export import view_page  # noqa: PLC0415 - slow to import
        from ..view.inline import Inline  # noqa: PLC0415 - see above

        runs = [self.shown("run" if against else None)]
        if against is not None:
            runs.append(against.shown("other run"))
        return Inline(view_page(runs), height)


def run_scenario(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    options: Options | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    stop: threading.Event | None = None,
) -> Run:
    """Run a scenario and keep the results in a folder.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it.
        progress: Called with the completed and the total steps, a few times a second.
        stop: Set in another thread, it stops the run after the step under way.

    Returns:
        The run.

    Raises:
        InputError: Something given cannot be used; nothing is written then.
        SimulationError: An FMU failed; what was recorded is kept, marked incomplete.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    options = options or Options()
    scenario = with_options(scenario, options)
    check_criteria(scenario)
    values = start_values(scenario)
    assembly = assemble(scenario, options.kind) if scenario.is_foreign else None
    external = ScenarioInputs(
        scenario, values, None if assembly is None else taken(scenario, assembly)
    )
    with claimed_folder(out, scenario.name, retry=options.retry) as folder:
        stepping = Stepping(
            scenario.ticks, external, options.realtime, progress, options.time_limit
        )
        return _Execution(scenario, values, options, folder, assembly).make(stepping, stop)


def with_options(scenario: Scenario, options: Options) -> Scenario:
    """Return the scenario with the overrides and the coupling of the options.

    Raises:
        InputError: An override is unknown, or its value is out of bounds.
    """
    named = {name: _from_here(given) for name, given in options.parts.items()}
    if named:
        if scenario.system:
            raise InputError(
                f"{next(iter(named))}: cannot be combined with system = {scenario.system!r}"
            )
        scenario = replace(scenario, fmus={**scenario.fmus, **named})
    start_values(scenario, options.overrides)
    others = {n: v for n, v in options.overrides.items() if n not in ("plant", "controller")}
    plant, controller = (options.overrides.get(name, {}) for name in ("plant", "controller"))
    is_ours = not scenario.is_system and "plant" not in scenario.fmus
    return replace(
        scenario,
        scene=str(plant.get("scene", scenario.scene)) if is_ours else scenario.scene,
        coupling=options.coupling or scenario.coupling,
        plant=_merged(
            scenario.plant, {n: v for n, v in plant.items() if n != "scene" or not is_ours}
        ),
        controller=_merged(scenario.controller, controller),
        parameters={
            **scenario.parameters,
            **{n: _merged(scenario.parameters.get(n, {}), v) for n, v in others.items()},
        },
    )


def _from_here(given: str) -> str:
    """A part named on the command line, relative to the working directory."""
    file, colon, name = given.rpartition(":")
    whole = colon and file.endswith(".py")
    return f"{os.path.realpath(file)}:{name}" if whole else os.path.realpath(given)


def _merged(section: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Merge both; overrides come last, so that they replace an earlier `kp[3]` or `kp`."""
    return {k: v for k, v in section.items() if k not in overrides} | dict(overrides)


class _Execution:
    """One run, from opening the FMUs to the summary."""

    def __init__(
        self,
        scenario: Scenario,
        values: StartValues,
        options: Options,
        folder: Path,
        assembly: Assembly | None,
    ) -> None:
        self.scenario, self.values, self.options, self.folder = scenario, values, options, folder
        self.assembly = assembly
        self.system = (
            panda_system(
                pushed=scenario.pushed,
                fmus=options.fmus,
                kind=options.kind,
                asked=scenario.asked,
            )
            if assembly is None
            else assembly.make()
        )
        self.warnings: list[str] = [] if assembly is None else list(assembly.notes)
        self.memory: MemoryRecorder | None = None

    def make(self, stepping: Stepping, event: threading.Event | None) -> Run:
        """Run to the end or until asked to stop."""
        with (
            stopping_on_signals(event) as stop,
            exit_guard(self.folder, self.summarize_failure) as guard,
        ):
            try:
                with (
                    self.open() as opened,
                    self.recorder(opened) as recorder,
                ):
                    with suppress(InputError):  # disk full: the run itself matters more
                        place = self.folder / SCENARIO_FOLDER
                        keep_scenario(self.scenario, self.assembly, self.system, place)
                    statistics = step_and_record(opened.master, stepping, recorder, stop, guard)
            except SimulationError:
                self.summarize_failure()
                raise
            summary = summarize(self.recording(), self.scenario, statistics)
            write_summary(self.folder, summary)
        kept = None if self.memory is None else self.memory.recording()
        return Run(self.folder, summary, stop.signal, tuple(self.warnings), kept)

    def open(self) -> AbstractContextManager[OpenSystem]:
        """Open the FMUs."""
        options, scenario = self.options, self.scenario
        start = 0.0 if self.assembly is None else self.assembly.start_time
        return open_system(
            self.system,
            self.values if self.assembly is None else self.assembly.given(self.values),
            start=start,
            stop=start + scenario.duration,
            step_size=scenario.step,
            coupling=scenario.coupling,
            on_message=self.hear,
            isolate=options.isolate,
            step_timeout=options.step_timeout,
        )

    def hear(self, instance: str, status: str, text: str) -> None:
        """Keep an FMU's message."""
        self.warnings.append(f"{instance} {status.lower()}: {text}")

    def recorder(self, opened: OpenSystem) -> AnyRecorder:
        """Make the recorder."""
        columns = columns_of(opened.master, self.assembly)
        metadata = metadata_of(self.scenario, self.values, opened, self.assembly)
        if self.options.keep_recording:
            return Recorder(self.folder, columns, metadata)
        self.memory = MemoryRecorder(self.folder, columns, metadata)
        return self.memory

    def recording(self) -> Recording:
        """Return what was recorded."""
        return Recording.open(self.folder) if self.memory is None else self.memory.recording()

    def summarize_failure(self) -> None:
        """Write the summary of a failed run, as far as possible."""
        with suppress(CosimError):  # the original error says more
            write_summary(self.folder, summarize(self.recording(), self.scenario))


def columns_of(master: Master, assembly: Assembly | None = None) -> list[Column]:
    """Columns of the recording, with their units from the interface tables."""
    if assembly is not None:
        return [Column(name, unit, text) for name, (unit, text) in assembly.recorded().items()]
    scalars = {(instance, s.name): s for instance, i in INTERFACES.items() for s in i.scalars()}
    columns = [Column("time", "s", "Time since the start")]
    for name in master.columns:
        scalar = scalars[name]
        columns.append(Column(".".join(name), scalar.unit, scalar.variable.description))
    return columns


def metadata_of(
    scenario: Scenario,
    values: StartValues,
    opened: OpenSystem,
    assembly: Assembly | None = None,
) -> dict[str, Any]:
    """Metadata of the recording, as JSON holds it."""
    ours: dict[str, Any] = {}
    if scenario.system and assembly is not None:
        ours |= {"system": Path(scenario.system).name, "start_time": assembly.start_time}
    if "plant" in values and "scene" in values["plant"]:
        ours["scene"] = values["plant"]["scene"]
    if not scenario.is_system:
        ours |= {
            "gains": scenario.gains,
            "interpolation": scenario.interpolation,
            "row_times": [row.time for row in scenario.table.rows],
            "row_names": [row.name for row in scenario.table.rows],
        }
    if scenario.folder is not None and not is_shipped(scenario):
        ours["scenario_folder"] = str(scenario.folder.resolve())  # where its reference is
    return {
        "scenario": scenario.name,
        "purpose": scenario.purpose,
        **ours,
        "coupling": scenario.coupling,
        "step_size": scenario.step,
        "duration": scenario.duration,
        "parameters": values,
        **provenance(opened),
    }


def write_summary(folder: Path, summary: Summary) -> None:
    """Write summary.json.

    Raises:
        InputError: The folder cannot be written to.
    """
    text = json.dumps(_json(summary.to_dict()), indent=2, allow_nan=False)
    with replacing(folder / SUMMARY_FILE) as path:
        path.write_text(text + "\n", encoding="utf-8")


def _json(value: Any) -> Any:
    """Replace numbers that are not finite by null, as JSON cannot hold them."""
    if isinstance(value, dict):
        return {key: _json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


__all__ = ["SUMMARY_FILE", "CosimError", "Options", "Run", "run_scenario", "with_options"]
