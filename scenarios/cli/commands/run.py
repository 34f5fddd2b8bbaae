"""`panda-cosim run`."""

from __future__ import annotations

import signal
import warnings
from pathlib import Path
from typing import Annotated, Literal

import typer

from ....fmus.errors import CosimError, InputError, SimulationError
from ...definition.scenario import Scenario, load_scenario
from ...pictures.gl import RenderError
from ...running.folders import claimed_folder
from ...running.run import Options, Run, run_scenario
from ...running.start import start_values
from ...running.system_run import run_system
from ..app import INTERRUPTED
from ..console import progress, show, warn
from ..drawing import draw_plot, draw_sheet, draw_video
from ..options import Assignments, ScenarioName, overrides
from ..verdict import outcome_lines, verdict_table
from .build import announce_build

Coupling = Literal["gauss-seidel", "jacobi"]
NOT_A_SUCCESS = 3
DEFAULT = "pick_and_place"  # scenario


def command(  # noqa: PLR0913 - one for each option
    scenario: ScenarioName = DEFAULT,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="New folder for what comes of the run."),
    ] = None,
    assignments: Assignments = None,
    coupling: Annotated[
        Coupling | None, typer.Option("--coupling", help="Instead of the scenario's.")
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Keep in step with the wall clock.")
    ] = False,
    video: Annotated[
        bool, typer.Option("--video/--no-video", help="Make video and contact sheet.")
    ] = True,
    plot: Annotated[
        bool | None,
        typer.Option("--plot/--no-plot", help="Make the plot; by default where there is a video."),
    ] = None,
    system: Annotated[
        Path | None,
        typer.Option(
            "--system",
            metavar="FILE.ssp",
            help="Run the coupled system of an SSP file instead of a scenario.",
        ),
    ] = None,
    isolate: Annotated[
        bool,
        typer.Option(
            "--isolate", help="Run each FMU in a process of its own, where a crash ends only that."
        ),
    ] = False,
    step_timeout: Annotated[
        float | None,
        typer.Option(
            "--step-timeout",
            metavar="S",
            help="End an isolated FMU whose step takes longer [s of wall time].",
        ),
    ] = None,
) -> None:
    """Run a scenario, record it and judge it.

    A scenario is the name of a shipped one (see `panda-cosim list`) or a folder of your own. FMUs
    are built when they are missing or out of date. The folder of the run holds recording.parquet,
    summary.json, plot.png, contact_sheet.png, video.mp4 and a copy of the scenario.

    ```
    panda-cosim run
    panda-cosim run tutorial --no-video
    panda-cosim run --set 'plant.block_pos[1]=0.45' --set controller.kp=6
    panda-cosim run --system Panda.ssp
    ```
    """
    options = Options(
        overrides(assignments),
        coupling,
        realtime=1.0 if realtime else 0.0,
        isolate=isolate,
        step_timeout=step_timeout,
    )
    if system is not None:
        if scenario != DEFAULT:
            raise InputError(f"SCENARIO {scenario!r}: does not go with --system")
        _run_system(system, out, options)
        return
    chosen = load_scenario(scenario)
    # Slips are told before anything is built.
    start_values(chosen, options.overrides)
    with claimed_folder(out, chosen.name) as folder:
        announce_build()
        done = _simulate(chosen, folder, options)
    _show_outcome(done, realtime)
    if done.signal:
        raise typer.Exit(128 + done.signal)
    _draw(done, video=video, plot=video if plot is None else plot)
    _show_files(done.folder)
    if not done.summary.success:
        raise typer.Exit(NOT_A_SUCCESS)


def _simulate(scenario: Scenario, folder: Path, options: Options) -> Run:
    """Run with a progress bar; say where the recording is if that fails."""
    # What an overflow leads to is an error of its own, once a value is no longer finite.
    warnings.simplefilter("ignore", RuntimeWarning)
    try:
        with progress(f"Simulating {scenario.name}") as update:
            return run_scenario(scenario, folder, options, progress=update)
    except SimulationError as error:
        kept = any(folder.glob("recording.*"))
        where = f"; the recording up to then is in {folder}" if kept else ""
        raise CosimError(f"{error}{where}") from error


def _run_system(path: Path, out: Path | None, options: Options) -> None:
    """Run an SSP file's system: there is a recording, but nothing to judge or draw."""
    if any(options.overrides.values()):
        raise InputError("--set: does not go with --system, whose parameters are in its file")
    with progress(f"Simulating {path.name}") as update:
        done = run_system(path, out, options, progress=update)
    for message in dict.fromkeys(done.warnings):
        warn(message)
    rate = done.simulated / done.report.wall_time if done.report.wall_time else 0.0
    show(
        f"{done.simulated:g} s simulated in {done.report.wall_time:.2f} s ({rate:.1f} x real time)"
    )
    _show_files(done.folder)
    if done.signal:
        raise typer.Exit(128 + done.signal)


def _show_outcome(done: Run, realtime: bool) -> None:
    for message in dict.fromkeys(done.warnings):
        warn(message)
    if done.signal:
        name, end = signal.Signals(done.signal).name, done.summary.timing["simulated_s"]
        warn(f"stopped by {name} at t = {end:.3f} s; the recording up to then is in {done.folder}")
        return
    if done.summary.criteria:
        show(verdict_table(done.summary))
    for text, style in outcome_lines(done.summary, realtime=realtime):
        show(text, style)


def _draw(done: Run, *, video: bool, plot: bool) -> None:
    """Make the pictures; what cannot be drawn is told, and is no failure of the run."""
    try:
        if plot:
            draw_plot(done.recording, done.folder)
        if video:
            draw_sheet(done.recording, done.folder)
            draw_video(done.recording, done.folder)
    except RenderError as error:
        warn(f"{error}; then `panda-cosim render {done.folder}` makes the pictures")
    except KeyboardInterrupt:
        warn(f"interrupted while drawing; recording and summary are in {done.folder}")
        raise typer.Exit(INTERRUPTED) from None


def _show_files(folder: Path) -> None:
    files = sorted(path for path in folder.iterdir() if path.is_file())
    show(f"{folder}{'/' if not str(folder).endswith('/') else ''}")
    for path in files:
        show(f"  {path.name:<18} {path.stat().st_size / 1e6:8.3f} MB")
