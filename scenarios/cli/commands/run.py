"""`panda-cosim run`."""

from __future__ import annotations

import signal
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.errors import CosimError, InputError, SimulationError
from ....fmus.packaging.build import Target
from ...definition.scenario import Scenario
from ...judging.criterion import missed_text, unmeasured_text
from ...pictures.gl import RenderError
from ...regression.junit import Case, write_cases
from ...running.assembly import instances
from ...running.folders import claimed_folder
from ...running.options import Options
from ...running.prepare import Prepared, prepare
from ...running.replay import read_session, replay
from ...running.result import Run
from ...running.run import run_prepared
from ...running.settings import TOP, split_settings, with_values
from ...running.system_run import system_scenario
from ..console import progress, show, show_json, warn
from ..drawing import PLOT_FILE, can_be_drawn, draw_plot, draw_sheet, draw_video, draw_view
from ..interrupts import INTERRUPTS
from ..options import (
    DEFAULT_SCENARIO,
    Assignments,
    Json,
    Kind,
    OutRun,
    ScenarioName,
    find_scenario,
    overrides,
)
from ..verdict import NOT_FAILED, outcome_lines, verdict_table
from .build import announce_build

Coupling = Literal["gauss-seidel", "jacobi"]
NOT_A_SUCCESS = 3
SMALL_ERROR = 1e-3  # rad of a joint, with which gains make no difference to be seen


def command(  # noqa: PLR0913 - one for each option
    scenario: ScenarioName = DEFAULT_SCENARIO,
    out: OutRun = None,
    assignments: Assignments = None,
    coupling: Annotated[
        Coupling | None,
        typer.Option(
            "--coupling",
            help="Overrides the scenario's coupling. With jacobi, the controller's output acts one "
            "tick later.",
        ),
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Run in real time, paced by the wall clock.")
    ] = False,
    video: Annotated[
        bool, typer.Option("--video/--no-video", help="Draw the video and the contact sheet.")
    ] = True,
    plot: Annotated[
        bool | None,
        typer.Option("--plot/--no-plot", help="Draw the plot. Default: as for the video."),
    ] = None,
    view: Annotated[
        bool, typer.Option("--view/--no-view", help="Write the page that shows the run in 3D.")
    ] = True,
    system: Annotated[
        Path | None,
        typer.Option(
            "--system",
            metavar="FILE.ssp",
            help="Run the coupled system in an SSP file. A SCENARIO that has a `system` judges it.",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="SECONDS", help="Simulated time [s], for --system."),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller",
            metavar="FILE",
            help="Replace the controller by LAW.py:CLASS or an .fmu file. Its code runs with your "
            "permissions.",
        ),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(
            "--plant",
            metavar="FILE",
            help="Replace the plant by a MuJoCo model (.xml, .urdf, .mjb) or an .fmu file.",
        ),
    ] = None,
    session: Annotated[
        Path | None,
        typer.Option(
            "--session",
            metavar="FILE_OR_FOLDER",
            help="Repeat a run of `live` or of a Session: its folder, or the journal session.jsonl "
            "in it.",
        ),
    ] = None,
    isolate: Annotated[
        bool,
        typer.Option(
            "--isolate",
            help="Run each FMU in a process of its own, so that a crash ends only that process.",
        ),
    ] = False,
    step_timeout: Annotated[
        float | None,
        typer.Option(
            "--step-timeout",
            metavar="SECONDS",
            help="With --isolate: stop the run if an FMU takes longer for one step.",
        ),
    ] = None,
    kind: Kind = "native",
    junit: Annotated[
        Path | None,
        typer.Option("--junit", metavar="FILE.xml", help="Write the verdict as JUnit XML, for CI."),
    ] = None,
    json: Json = False,
) -> None:
    """Run a scenario, record it and judge it.

    SCENARIO is the name of a shipped scenario (see `panda-cosim list`) or a folder of your own.
    FMUs are built when they are missing or out of date. The run's folder gets recording.parquet,
    summary.json, view.html, plot.png, contact_sheet.png, video.mp4 and a copy of the scenario.

    ```
    panda-cosim run
    panda-cosim run tutorial --no-video
    panda-cosim run --set 'plant.block_pos[1]=0.45' --set controller.kp=6
    panda-cosim run ./my-scenario --no-video --junit result.xml
    panda-cosim run tutorial --controller my_law.py:MyLaw --set controller.gain=3
    panda-cosim run --system Panda.ssp --duration 2
    panda-cosim run --session runs/my-session
    ```
    """
    given: dict[str, str | None] = {"controller": controller, "plant": plant}
    parts = {name: file for name, file in given.items() if file is not None}
    if system is None or session is not None:
        chosen = find_scenario(scenario)
    else:
        refused = given | {"kind": None if kind == Options().kind else kind}
        chosen = _with_system(scenario, system, duration, refused)
    changes, parameters = split_settings(assignments or ())
    options = Options(
        overrides(parameters, instances(chosen), TOP),
        coupling,
        parts=parts,
        realtime=1.0 if realtime else 0.0,
        isolate=isolate,
        step_timeout=step_timeout,
        kind=kind,
    )
    if session is not None:
        given |= {
            "--system": None if system is None else str(system),
            "--set": ",".join(assignments or ()) or None,
        }
        _refuse_beside_session(scenario, options, given)
        chosen, options = read_session(session, options)
    if duration is not None and system is None:
        raise InputError("--duration: only for --system; a scenario's duration is in scenario.toml")
    chosen = with_values(chosen, changes)
    source = prepare(chosen, options) if session is None else session  # refuses bad input
    if junit is not None:
        check_replaceable(junit)
    with claimed_folder(out, chosen.name) as folder:
        if not chosen.is_system:
            announce_build(Target(options.kind))
        done = _simulate(source, chosen, folder, options, junit)
    _warn(done)
    if not json:
        _show_outcome(done, realtime)
        _note_gains(done, options)
    if not done.signal:
        if view and can_be_drawn(done.recording):
            _write_view(done)
        _draw(done, video=video, plot=video if plot is None else plot)
    _end(done, junit, json=json)


def _with_system(
    scenario: str, system: Path, duration: float | None, refused: Mapping[str, str | None]
) -> Scenario:
    """Return what runs a system: by itself, or in place of that of a scenario, which judges it."""
    for name, given in refused.items():
        if given is not None:
            raise InputError(f"--{name}: cannot be combined with --system")
    alone = system_scenario(system, duration)
    if scenario == DEFAULT_SCENARIO:
        return alone
    judging = find_scenario(scenario)
    if not judging.system:
        raise InputError(
            f"SCENARIO {scenario!r}: cannot be combined with --system; must be one with a `system`"
        )
    length = judging.duration if duration is None else duration
    return replace(judging, system=alone.system, folder=alone.folder, duration=length)


def _refuse_beside_session(
    scenario: str, options: Options, given: Mapping[str, str | None]
) -> None:
    """Refuse options that a session's journal sets itself."""
    refused = {
        f"SCENARIO {scenario!r}": scenario != DEFAULT_SCENARIO,
        "--coupling": options.coupling is not None,
        "--realtime": options.realtime > 0.0,
        "--kind": options.kind != Options().kind,
        **{f"--{name.lstrip('-')}": value is not None for name, value in given.items()},
    }
    for name, is_given in refused.items():
        if is_given:
            raise InputError(
                f"{name}: cannot be combined with --session, which repeats the run as it was"
            )


def _simulate(
    source: Prepared | Path,
    scenario: Scenario,
    folder: Path,
    options: Options,
    junit: Path | None,
) -> Run:
    """Run what was prepared, or a session again; an error names the place of the recording."""
    # No warning: an overflow leads to a value that is not finite, which is an error.
    warnings.simplefilter("ignore", RuntimeWarning)
    began = time.monotonic()
    try:
        with progress(f"Simulating {scenario.name}") as update:
            if isinstance(source, Prepared):
                return run_prepared(source, folder, progress=update)
            return replay(source, folder, options, progress=update)
    except SimulationError as error:
        if junit is not None:
            seconds = time.monotonic() - began
            case = Case(scenario.name, seconds, "error", "failed", str(error))
            write_cases("panda-cosim run", [case], junit)
        kept = any(folder.glob("recording.*"))
        where = f"; the recording up to then is in {folder}" if kept else ""
        raise CosimError(f"{error}{where}") from error


def _result(done: Run, code: int) -> dict[str, object]:
    """Return what `--json` prints for every run."""
    return {
        "folder": done.folder,
        "files": [path.name for path in _files(done.folder)],
        "exit_code": code,
        "warnings": list(dict.fromkeys(done.warnings)),
    }


def _warn(done: Run) -> None:
    for message in dict.fromkeys(done.warnings):
        warn(message)
    if done.signal:
        name, end = signal.Signals(done.signal).name, done.summary.timing["simulated_s"]
        warn(f"stopped by {name} at t = {end:.3f} s; the recording up to then is in {done.folder}")


def _show_outcome(done: Run, realtime: bool) -> None:
    if done.signal:
        return
    if done.summary.criteria:
        show(verdict_table(done.summary))
    for text, style in outcome_lines(done.summary, realtime=realtime):
        show(text, style)


def _note_gains(done: Run, options: Options) -> None:
    """Explain why gains that were set have little effect: the joint errors are too small."""
    given = {name.partition("[")[0] for name in options.overrides.get("controller", {})}
    if not given & {"kp", "ki", "kd"} or "controller.dq" not in done.recording:
        return
    error = float(abs(done.recording["controller.dq"]).max(initial=0.0))
    if error < SMALL_ERROR:
        text = (
            f"Gains have little effect here: the joint errors stay below {1e3 * error:.2g} mrad, "
            "since the joint reference is fed forward. In `panda-cosim run tutorial` they matter."
        )
        show(text, "dim")


def _write_view(done: Run) -> None:
    """Write the page; if it cannot show the run, warn, since the run itself is good."""
    try:
        draw_view(done)
    except InputError as error:
        warn(f"no view: {error}")
    except INTERRUPTS:
        warn(f"interrupted while writing the view; recording and summary are in {done.folder}")
        raise


def _draw(done: Run, *, video: bool, plot: bool) -> None:
    """Draw the pictures; one that cannot be drawn is a warning, since the run itself is good."""
    try:
        if plot:
            draw_plot(done.recording, done.folder / PLOT_FILE)
        if video and can_be_drawn(done.recording):
            draw_sheet(done.recording, done.folder)
            draw_video(done.recording, done.folder)
        elif video:
            warn("no pictures: the plant's FMU contains no model; --no-video avoids this warning")
    except RenderError as error:
        warn(f"{error}; then `panda-cosim render {quote(str(done.folder))}` draws the pictures")
    except INTERRUPTS:
        warn(f"interrupted while drawing; recording and summary are in {done.folder}")
        raise


def _end(done: Run, junit: Path | None, *, json: bool) -> None:
    """Print the results and exit with the exit code."""
    code = 128 + done.signal if done.signal else 0 if done.summary.as_expected else NOT_A_SUCCESS
    if junit is not None:
        write_cases("panda-cosim run", [_case(done)], junit)
    if json:
        show_json(_result(done, code) | {"summary": done.summary.to_dict()})
    elif not done.signal:
        _show_files(done.folder)
    if code:
        raise typer.Exit(code)


def _case(done: Run) -> Case:
    name, seconds = done.summary.scenario, done.summary.timing.get("wall_s") or 0.0
    if done.signal:
        return Case(name, seconds, "error", "stopped", str(done.summary.reason))
    if done.summary.as_expected:
        return Case(name, seconds)
    if unmeasured := unmeasured_text(done.summary.criteria):
        return Case(name, seconds, "error", "not measured", unmeasured)
    message = missed_text(done.summary.criteria) or f"{NOT_FAILED}: {done.summary.expect_reason}"
    return Case(name, seconds, "failure", "missed", message)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file())


def _show_files(folder: Path) -> None:
    show(f"{folder}{'/' if not str(folder).endswith('/') else ''}")
    for path in _files(folder):
        show(f"  {path.name:<18} {path.stat().st_size / 1e6:8.3f} MB")
