"""Drawing with progress, for the commands that draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...fmus.errors import InputError
from ..pictures.motion import SHAPES, refuse_without_model
from ..recording import Recording
from ..running.result import Run
from ..view.export import VIEW_FILE, write_view
from .console import progress, tell

VIDEO_FILE = "video.mp4"
SHEET_FILE = "contact_sheet.png"
PLOT_FILE = "plot.png"


def draw_plot(recording: Recording, path: Path) -> Path:
    """Draw the page of curves."""
    from ..pictures.plot import plot_run  # noqa: PLC0415 - imports matplotlib
    from ..pictures.signals_plot import plot_signals  # noqa: PLC0415 - imports matplotlib

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


def draw_sheet(recording: Recording, folder: Path, **look: Any) -> Path:
    """Draw the contact sheet into a folder; for `look`, see `contact_sheet`."""
    from ..pictures.sheet import contact_sheet  # noqa: PLC0415 - imports Pillow

    tell("Drawing the contact sheet ...")
    return contact_sheet(recording, folder / SHEET_FILE, **look)


def draw_video(recording: Recording, folder: Path, **look: Any) -> Path:
    """Draw the video into a folder; for `look`, see `render_video`."""
    from ..pictures.video import render_video  # noqa: PLC0415 - imports mediapy

    with progress("Drawing the video") as update:
        return render_video(recording, folder / VIDEO_FILE, progress=update, **look)


def draw_view(run: Run) -> Path:
    """Write the page that shows a run in 3D to its folder."""
    tell("Writing the view ...")
    return write_view([run.shown()], run.folder / VIEW_FILE)
