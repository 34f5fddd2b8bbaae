"""Contact sheet of a run: its key moments side by side, drawn from its recording alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...result.recording import Recording
from .motion import describe_run, key_moments, poses, scene_of
from .offscreen import Image, OffscreenRenderer
from .panels import DPI, GREY, INK
from .plot import own_style, save

if TYPE_CHECKING:
    from .canvas import ShownFigure

MAX_TILES = 12
TILE = (480, 360)  # [px] width and height of an image
COLUMNS = 4
GAP = 14  # [px] between images
MARGIN = 36  # [px] around all
HEADER = 74  # [px] for the title
CAPTION = 34  # [px] under an image


def contact_sheet(recording: Recording, path: str | Path, *, camera: str = "overview") -> Path:
    """Write a PNG with key moments of a run, seen from a camera of the scene."""
    path = Path(path)
    moments = key_moments(recording, MAX_TILES)
    qpos = poses(recording, np.array([moment.time for moment in moments]))
    with closing(OffscreenRenderer(scene_of(recording), *TILE, camera)) as renderer:
        tiles = list(renderer.frames(qpos))
    captions = [f"{moment.time:.2f} s  {moment.label}" for moment in moments]
    with own_style():
        save(_compose(tiles, captions, describe_run(recording)), path)
    return path


def _compose(
    tiles: Sequence[Image], captions: Sequence[str], title: tuple[str, str]
) -> ShownFigure:
    """Put images (360, 480, 3) on a page, row by row, with a caption under each."""
    from .canvas import ShownFigure  # noqa: PLC0415 - slow to import

    (width, height), columns = TILE, min(COLUMNS, len(tiles))
    step_x, step_y = width + GAP, height + CAPTION + GAP
    right = 2 * MARGIN - GAP + columns * step_x  # [px], and the next from below
    top = 2 * MARGIN - GAP + HEADER + math.ceil(len(tiles) / columns) * step_y
    figure = ShownFigure(figsize=(right / DPI, top / DPI), dpi=DPI, facecolor="white")
    for text, below, size, colour in zip(title, (0, 40), (20, 12), (INK, GREY), strict=True):
        at = MARGIN / right, 1.0 - (MARGIN + below) / top
        figure.text(*at, text, fontsize=size, color=colour, va="top")
    for index, (tile, caption) in enumerate(zip(tiles, captions, strict=True)):
        row, column = divmod(index, columns)
        x, y = MARGIN + column * step_x, top - MARGIN - HEADER - row * step_y - height
        figure.figimage(tile, x, y)
        figure.text((x + 2) / right, (y - 25) / top, caption, fontsize=13)
    return figure
