"""`panda-cosim render`."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.errors import InputError
from ...pictures.motion import positions
from ...recording import Recording
from ..console import show
from ..options import Meshes, OutFolder, Overwrite, RunFolder
from ..outcome import SHEET_FILE, VIDEO_FILE, draw_sheet, draw_video


def command(  # noqa: PLR0913 - one for each option
    run: RunFolder,
    out: OutFolder = None,
    camera: Annotated[
        str,
        typer.Option(
            "--camera",
            metavar="NAME",
            help="Camera: overview, closeup, front, or another one of the plant's model.",
        ),
    ] = "overview",
    size: Annotated[
        str,
        typer.Option("--size", metavar="WxH", help="Size of the video [px]; even numbers."),
    ] = "640x480",
    fps: Annotated[float, typer.Option("--fps", metavar="HZ", help="Frames per second.")] = 60.0,
    meshes: Meshes = "never",
    video: Annotated[
        bool, typer.Option("--video/--no-video", help="Draw the video as well.")
    ] = True,
    overwrite: Overwrite = False,
) -> None:
    """Draw a run's video and contact sheet again.

    The files video.mp4 and contact_sheet.png are drawn from the recording, without a simulation.

    ```
    panda-cosim render runs/first --size 1280x720 --camera closeup
    ```
    """
    recording = Recording.open(run, in_order=True)
    folder = out if out is not None else recording.path.parent
    if folder.suffix.lower() in (".mp4", ".png") and not folder.is_dir():
        raise InputError(f"--out {folder}: must be a folder; the files in it have fixed names")
    files = (VIDEO_FILE, SHEET_FILE) if video else (SHEET_FILE,)
    check_replaceable(*(folder / name for name in files), overwrite=overwrite)
    positions(recording)  # refuses a recording that lacks signals, before anything is drawn
    width, height = parse_size(size)
    look = {"camera": camera, "meshes": meshes}
    if video:
        show(str(draw_video(recording, folder, fps=fps, width=width, height=height, **look)))
    show(str(draw_sheet(recording, folder, **look)))


def parse_size(text: str) -> tuple[int, int]:
    """Read a size in pixels, such as 1280x720."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip(), re.A)
    if match is None:
        raise InputError(f"--size {text!r}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])
