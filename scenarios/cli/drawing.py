"""Drawing with progress, for the commands that draw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...fmus.errors import InputError
from ..pictures.meshes import Meshes
from ..pictures.motion import SHAPES, refuse_without_model
from ..recording import Recording
from ..running.result import Run
from ..view.export import VIEW_FILE, write_view
from .console import progress, tell

VIDEO_FILE = "video.mp4"
SHEET_FILE = "contact_sheet.png"
PLOT_FILE = "plot.png"


@dataclass(frozen=True)
class Look:
    """Options of pictures.

    Attributes:
        camera: Name of a camera of the scene.
        meshes: Whether the arm is drawn with Menagerie's meshes.
        width: Width of the video [px].
        height: Height of the video [px].
        fps: Frames per second of the video.
    """

    camera: str = "overview"
    meshes: Meshes = "never"
    width: int = 640
    height: int = 480
    fps: float = 60.0


def draw_plot(recording: Recording, path: Path) -> Path:
    """Draw the page of curves."""
    from ..pictures.plot import plot_run, plot_signals  # noqa: PLC0415 - slow to import

    tell("Drawing the plot ...")
    draw = plot_run if all(name in recording for name in SHAPES) else plot_signals
    return draw(recording, path)


def can_be_drawn(recording: Recording) -> bool:
    """Whether there is a model that pictures show: the project's own, or the plant's."""
    try:
        refuse_without_model(recording)
    except InputError:
        return False
    return "plant.qpos" in recording


def draw_sheet(recording: Recording, folder: Path, look: Look = Look()) -> Path:
    """Draw the contact sheet into a folder."""
    from ..pictures.sheet import contact_sheet  # noqa: PLC0415 - imports Pillow

    tell("Drawing the contact sheet ...")
    return contact_sheet(recording, folder / SHEET_FILE, camera=look.camera, meshes=look.meshes)


def draw_video(recording: Recording, folder: Path, look: Look = Look()) -> Path:
    """Draw the video into a folder."""
    from ..pictures.video import render_video  # noqa: PLC0415 - slow to import

    with progress("Drawing the video") as update:
        return render_video(
            recording,
            folder / VIDEO_FILE,
            fps=look.fps,
            width=look.width,
            height=look.height,
            camera=look.camera,
            meshes=look.meshes,
            progress=update,
        )


def draw_view(run: Run) -> Path:
    """Write the page that shows a run in 3D to its folder."""
    tell("Writing the view ...")
    return write_view([run.shown()], run.folder / VIEW_FILE)
