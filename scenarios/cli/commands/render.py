"""`panda-cosim render` and `panda-cosim plot`."""

from __future__ import annotations

import re
from pathlib import Path

from ....fmus.atomic import check_replaceable
from ....fmus.errors import InputError
from ...pictures.motion import position_columns
from ...pictures.plot import plot_recording
from ...pictures.sheet import contact_sheet
from ...pictures.video import check_video
from ...recording import Recording
from ...run.folder import SUMMARY_FILE
from ...run.result import PLOT_FILE, SHEET_FILE, VIDEO_FILE
from ...view.export import read_summary
from ..console import show, tell
from ..options import MESHES, OVERWRITE, RUN, Meshes, option
from ..outcome import PLOTTING, TILING, draw_video


def command(  # noqa: PLR0913 - one for each option
    run: Path = RUN,
    out: Path | None = option(
        "--out -o DIR", "Folder for the pictures. Default: the folder of the run."
    ),
    camera: str = option(
        "--camera NAME",
        "Camera: overview, closeup, front, or another one of the plant's model.",
        "overview",
    ),
    size: str = option("--size WxH", "Size of the video [px]; even numbers.", "640x480"),
    fps: float = option("--fps HZ", "Frames per second.", 60.0),
    meshes: Meshes = MESHES,
    video: bool = option("--video/--no-video", "Draw the video as well.", True),
    overwrite: bool = OVERWRITE,
) -> None:
    """Redraw a run's video and contact sheet.

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
    position_columns(recording)  # refuses one that lacks signals, before anything is drawn
    width, height = _pixels(size)
    check_video(folder / VIDEO_FILE, fps, width, height)
    tell(TILING)
    show(str(contact_sheet(recording, folder / SHEET_FILE, camera=camera, meshes=meshes)))
    if video:
        look = {"fps": fps, "width": width, "height": height, "camera": camera, "meshes": meshes}
        show(str(draw_video(recording, folder, **look)))


def _pixels(text: str) -> tuple[int, int]:
    """Read a size in pixels, such as 1280x720."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip(), re.A)
    if match is None:
        raise InputError(f"--size {text!r}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])


def plot(
    run: Path = RUN,
    out: Path | None = option(
        "--out -o FILE.png|DIR",
        f"File to write, or the folder for {PLOT_FILE}. Default: the run's folder.",
    ),
    overwrite: bool = OVERWRITE,
) -> None:
    """Plot a run's signals on one page.

    The page is plot.png, drawn from the recording.

    ```
    panda-cosim plot runs/first
    ```
    """
    recording = Recording.open(run, in_order=True)
    path = out if out is not None else recording.path.parent
    if path.suffix.lower() != ".png" or path.is_dir():
        path /= PLOT_FILE
    check_replaceable(path, overwrite=overwrite)
    tell(PLOTTING)
    summary = read_summary(recording.path.parent / SUMMARY_FILE)
    show(str(plot_recording(recording, path, summary)))
