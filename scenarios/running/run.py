"""Runs a scenario: FMUs, master, recording, summary."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...fmus.errors import CosimError, InputError, SimulationError
from ...fmus.master.system import OpenSystem
from ..definition.scenario import Scenario, load_scenario
from ..recording import AnyRecorder, MemoryRecorder, Recorder, Recording
from .exits import exit_guard
from .fmu_files import keep_scenario
from .folders import SCENARIO_FOLDER, claimed_folder
from .notebook import SHEET_FILE, Picture, Video, run_html
from .opening import Prepared, make_system, open_fmus, prepare
from .options import Options
from .run_files import columns_of, json_values, metadata_of, write_summary
from .stepping import Stepping, step_and_record
from .stopping import stopping_on_signals
from .summary import Summary, summarize

if TYPE_CHECKING:
    from ..view.inline import Inline
    from ..view.run import Shown


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
        return show_source(self.recording, name, summary=json_values(self.summary.to_dict()))

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
    prepared = prepare(scenario, options)
    scenario = prepared.scenario
    with claimed_folder(out, scenario.name, retry=options.retry) as folder:
        stepping = Stepping(
            scenario.ticks, prepared.inputs, options.realtime, progress, options.time_limit
        )
        return _Execution(prepared, options, folder).make(stepping, stop)


class _Execution:
    """One run, from opening the FMUs to the summary."""

    def __init__(self, prepared: Prepared, options: Options, folder: Path) -> None:
        self.scenario, self.values = prepared.scenario, prepared.values
        self.assembly = assembly = prepared.assembly
        self.options, self.folder = options, folder
        self.system = make_system(self.scenario, assembly, options, self.scenario.pushed)
        self.warnings: list[str] = [] if assembly is None else list(assembly.notes)
        self.memory: MemoryRecorder | None = None

    def make(self, stepping: Stepping, event: threading.Event | None) -> Run:
        """Run to the end or until asked to stop."""
        with (
            stopping_on_signals(event) as stop,
            exit_guard(self.folder, self.summarize_failure) as guard,
        ):
            try:
                with self.open() as opened, self.recorder(opened) as recorder:
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
        return open_fmus(
            self.scenario, self.assembly, self.options, self.system, self.values, self.warnings
        )

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


__all__ = ["Run", "run_scenario"]
