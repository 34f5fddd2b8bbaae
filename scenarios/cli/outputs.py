"""Commands that make files from a run or a scenario: `render`, `plot`, `export`, `inputs`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from ...fmus.errors import InputError
from .console import show
from .options import Assignments, Overwrite, RunFolder, overrides

OutFolder = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Folder for the pictures; by default the run's."
    ),
]
CsvFile = Annotated[Path, typer.Argument(metavar="FILE.csv", help="The file to write.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    for command in (render, plot, export, inputs):
        app.command()(command)


def render(  # noqa: PLR0913 - one for each option
    run: RunFolder,
    out: OutFolder = None,
    camera: Annotated[
        str, typer.Option("--camera", metavar="NAME", help="A camera of the scene.")
    ] = "overview",
    size: Annotated[
        str, typer.Option("--size", metavar="WxH", help="Of the video, in pixels; even.")
    ] = "640x480",
    fps: Annotated[float, typer.Option("--fps", help="Frames per second of the video.")] = 60.0,
    meshes: Annotated[
        Literal["never", "auto", "always"],
        typer.Option("--meshes", help="Wear the meshes of MuJoCo Menagerie: auto, if at hand."),
    ] = "never",
    video: Annotated[
        bool, typer.Option("--video/--no-video", help="Whether to make the video, too.")
    ] = True,
) -> None:
    """Draw video and contact sheet of a run again, from its recording alone.

    ```
    panda-cosim render runs/first --size 1280x720 --camera overview
    ```
    """
    from ..pictures.motion import PICTURED, take  # noqa: PLC0415
    from ..recording import Recording  # noqa: PLC0415 - after --help
    from .pictures import Look, draw_sheet, draw_video  # noqa: PLC0415

    recording = Recording.open(run)
    take(recording, PICTURED)  # what is missing is told before the video, which takes its time
    folder = out if out is not None else recording.path.parent
    look = Look(camera, meshes, *parse_size(size), fps)
    if video:
        show(str(draw_video(recording, folder, look)))
    show(str(draw_sheet(recording, folder, look)))


def parse_size(text: str) -> tuple[int, int]:
    """Read a size in pixels, as 1280x720.

    Raises:
        InputError: It is not of that form.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip(), re.A)
    if match is None:
        raise InputError(f"--size {text!r}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])


def plot(run: RunFolder, out: OutFolder = None) -> None:
    """Draw the curves of a run on one page, from its recording alone.

    ```
    panda-cosim plot runs/first
    ```
    """
    from ..recording import Recording  # noqa: PLC0415
    from .pictures import draw_plot  # noqa: PLC0415 - after --help

    recording = Recording.open(run)
    show(str(draw_plot(recording, out if out is not None else recording.path.parent)))


def export(run: RunFolder, file: CsvFile, overwrite: Overwrite = False) -> None:
    """Write a recording as CSV (RFC 4180): all signals, one row a tick, exact numbers.

    ```
    panda-cosim export runs/first first.csv
    ```
    """
    from ..recording import Recording  # noqa: PLC0415 - after --help

    recording = Recording.open(run)
    recording.to_csv(file, overwrite=overwrite)
    show(f"{file}: {recording.rows} rows, {len(recording.columns)} columns")


def inputs(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name of a shipped scenario, or a folder.")
    ],
    file: CsvFile,
    assignments: Assignments = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a scenario's commands as an input file for the controller FMU in other tools.

    Columns are time and the controller's command inputs, one row a tick, as `fmpy simulate` and
    other importers read them.

    ```
    panda-cosim inputs tutorial commands.csv
    fmpy simulate PandaController.fmu --input-file commands.csv
    ```
    """
    from ..definition.scenario import load_scenario  # noqa: PLC0415
    from ..recording.export import write_input_csv  # noqa: PLC0415 - after --help
    from ..running.start import instants, resolve, start_values  # noqa: PLC0415

    chosen = load_scenario(scenario)
    times = instants(chosen)
    trajectory = resolve(chosen, start_values(chosen, overrides(assignments)))
    write_input_csv(file, times, trajectory.sample(times), overwrite=overwrite)
    show(f"{file}: {len(times)} rows")
