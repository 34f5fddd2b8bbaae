"""What `run` and `replay` do: simulate with a progress bar, show the outcome, draw it, and end."""

from __future__ import annotations

import signal
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import typer
from rich.text import Text

from ..fmus.atomic import check_replaceable
from ..fmus.errors import CosimError, InputError, SimulationError
from ..fmus.sources.targets import Kind, Target
from ..result.judging.advice import advise, refusals
from ..result.judging.criterion import cells
from ..result.judging.summary import Summary
from ..result.judging.verdict import Verdict
from ..result.judging.verdicts import FAILED
from ..result.pictures.gl import RenderError
from ..result.pictures.motion import position_columns
from ..result.recording import Recording
from ..run.finished import PLOT_FILE, VIDEO_FILE, Run
from ..run.folder import claimed_folder
from ..task.scenario import Scenario
from . import INTERRUPTS
from .common import announce_build, announce_python
from .console import progress, show, show_file, show_json, table, tell, warn
from .startup import meanwhile

if TYPE_CHECKING:
    from rich.table import Table

    from ..run.execution import Progress

PLOTTING, TILING = "Drawing the plot ...", "Drawing the contact sheet ..."
STYLES = {"wrong": "bold red", "refused": "bold red", "bad": "bold red", "hint": "yellow",
          "warn": "yellow", "good": "green"}  # fmt: skip
LEVELS = {"bad": "bold red", "plain": "bold", "good": "bold green"}  # of a verdict


@dataclass(frozen=True)
class Output:
    """What is made of a run."""

    out: Path | None  # folder; None: a new one in runs/
    video: bool
    plot: bool | None  # None: as the video
    view: bool
    junit: Path | None
    json: bool  # instead of tables
    fps: float = 30.0  # of the video
    realtime: bool = False  # late steps are told
    is_alone: bool = False  # nothing else is done meanwhile


def perform(
    scenario: Scenario,
    kind: Kind,
    output: Output,
    run: Callable[[Path, Progress], Run],
    values: Mapping[str, object] | None = None,
) -> None:
    """Run in a new folder, show the outcome, draw it, and exit with its exit code.

    Modules that are needed afterwards are imported while the FMUs step, and the scene of these
    parameters, by FMU, is described.
    """
    check_replaceable(output.junit)
    # No warning: an overflow leads to a value that is not finite, which is an error.
    warnings.simplefilter("ignore", RuntimeWarning)
    began = time.monotonic()
    get_ready = cache(partial(meanwhile, partial(_get_ready, output.view, values)))
    with claimed_folder(output.out, scenario.name) as folder:
        if not scenario.is_system:
            announce_build(Target(kind))
        try:
            with progress(f"Simulating {scenario.name}") as update:

                def hear(done: int, total: int) -> None:
                    update(done, total)
                    if not output.is_alone:
                        get_ready()

                done = run(folder, hear)
        except SimulationError as error:
            announce_python(kind)
            seconds = time.monotonic() - began
            write_case(output.junit, "run", scenario.name, seconds, FAILED, str(error))
            kept = any(folder.glob("recording.*"))
            where = f"; the recording up to then is in {folder}" if kept else ""
            raise CosimError(f"{error}{where}") from error
    conclude(done, output, ours=not scenario.has_own_parts)


def _get_ready(view: bool, values: Mapping[str, object] | None) -> None:
    """Import what closes and draws a run, and describe the scene that it shows."""
    import_module("rich.table")
    import_module("pyarrow.parquet")
    if view:
        page = import_module("..result.view.page", __package__)
        if values is not None:
            page.plant_model({"parameters": values})


def conclude(done: Run, output: Output, *, ours: bool) -> None:
    """Show a finished run, draw its pictures, and exit with its exit code; `ours`: all FMUs are."""
    told = list(dict.fromkeys(done.warnings))
    for message in told:
        warn(message)
    summary = done.summary
    seconds = summary.timing.get("wall_s") or 0.0
    write_case(output.junit, "run", summary.scenario, seconds, summary.verdict, summary.detail)
    if done.signal:
        name, end = signal.Signals(done.signal).name, summary.timing["simulated_s"]
        warn(f"stopped by {name} at t = {end:.3f} s; the recording up to then is in {done.folder}")
    else:
        if not output.json:
            _show_verdict(done, realtime=output.realtime, ours=ours)
        draw_view(output, done)
        for path in chain(_files(done), _draw(done, output)):
            if not output.json:
                show_file(path)
    if output.json:
        files = [path.name for path in _files(done)]
        about = {"folder": done.folder, "files": files, "exit_code": done.exit_code}
        show_json({**about, "warnings": told, "summary": done.summary.to_dict()})
    if done.exit_code:
        raise typer.Exit(done.exit_code)


def _show_verdict(done: Run, *, realtime: bool, ours: bool) -> None:
    if done.summary.criteria:
        show(verdict_table(done.summary))
    for text, style in outcome_lines(done.summary, done.recording, realtime=realtime, ours=ours):
        show(text, style)


def _files(done: Run) -> list[Path]:
    return sorted(path for path in done.folder.iterdir() if path.is_file())


def draw_view(output: Output, done: Run) -> None:
    """Write the page of a run, unless it is there; that it cannot be drawn is a warning."""
    if not output.view or done.signal or not _is_drawable(done):
        return
    from ..result.view.page import VIEW_FILE, write_view  # noqa: PLC0415 - slow to import

    path = done.folder / VIEW_FILE
    if not path.exists():
        with _drawing(done):
            try:
                write_view([done.shown()], path)
            except InputError as error:
                warn(f"no view: {error}")


def _is_drawable(done: Run) -> bool:
    try:
        return bool(position_columns(done.recording))
    except InputError:
        return False


def _draw(done: Run, output: Output) -> Iterator[Path]:
    """Draw the pictures, the slowest last, and yield each as soon as it is there."""
    with _drawing(done):
        if output.video if output.plot is None else output.plot:
            tell(PLOTTING)
            done.plot()
            yield done.folder / PLOT_FILE
        if output.video and _is_drawable(done):
            tell(TILING)
            yield done.sheet().path
            yield draw_video(done.recording, done.folder, fps=output.fps)
        elif output.video:
            warn("no pictures: the plant's FMU contains no model; --no-video avoids this warning")


@contextmanager
def _drawing(done: Run) -> Iterator[None]:
    """What cannot be drawn is a warning, since the run is good."""
    try:
        yield
    except RenderError as error:
        warn(f"{error}; later, `panda-cosim render {quote(str(done.folder))}` draws the pictures")
    except INTERRUPTS:
        warn(f"interrupted while drawing; recording and summary are in {done.folder}")
        raise


def write_case(  # noqa: PLR0913 - what the file says
    path: Path | None, command: str, name: str, seconds: float, verdict: Verdict, detail: str
) -> None:
    """Write a command's verdict as JUnit XML, if a file is asked for."""
    if path is not None:
        from ..study.compare.junit import Case, write_cases  # noqa: PLC0415 - rarely asked for

        write_cases(f"panda-cosim {command}", [Case(name, seconds, verdict.fault, detail)], path)


def verdict_table(summary: Summary) -> Table:
    """Return a table with one row per criterion."""
    right = ("measured", "required", "margin")
    rows = []
    for criterion in summary.criteria:
        *texts, word = cells(criterion)
        rows.append((*texts, Text(word, "green" if criterion.ok else "bold red")))
    return table(("criterion*", *right, "verdict"), rows, right=right)


def outcome_lines(
    summary: Summary, recording: Recording, *, realtime: bool, ours: bool = True
) -> Iterator[tuple[str, str]]:
    """Yield the lines below the table, each with its style; `ours`: all FMUs are."""
    yield summary.headline, LEVELS[summary.verdict.level]
    yield _speed_line(summary), ""
    for end in summary.row_ends:
        at = end["ended_s"]
        how = "never ended early" if at is None else f"ended early, at t = {at:.3f} s"
        yield f"Row {end['row']} ({end['until']}) {how}", "yellow" if at is None else ""
    yield from ((line, "") for line in summary.costs())
    for line in advise(recording, summary, ours=ours):
        yield line, STYLES["hint"]
    for level, text in refusals(summary.preflight, complete=summary.complete):
        yield text, STYLES[level]
    if realtime:
        timing = summary.timing
        late = f"{timing['overruns']} of {timing['steps']} steps were late"
        yield f"Real time: {late}, the latest by {timing['worst_lateness_s'] * 1e3:.1f} ms", ""


def _speed_line(summary: Summary) -> str:
    timing, tracking = summary.timing, summary.tracking
    factor = timing.get("real_time_factor")
    speed = f" in {timing['wall_s']:.2f} s ({factor:.1f} x real time)" if factor else ""
    simulated = f"{timing['simulated_s']:g} s simulated{speed}"
    if not tracking:
        return simulated
    return f"{simulated}; tracking RMS {tracking['rms_mm']:.4g} mm, max {tracking['max_mm']:.4g} mm"


def draw_video(recording: Recording, folder: Path, **look: Any) -> Path:
    """Draw the video into a folder; for `look`, see `render_video`."""
    from ..result.pictures.video import render_video  # noqa: PLC0415 - imports mediapy

    with progress("Drawing the video (--no-video skips it)") as update:
        return render_video(recording, folder / VIDEO_FILE, progress=update, **look)
