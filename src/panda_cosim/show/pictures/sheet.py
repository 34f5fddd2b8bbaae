"""Contact sheet of a run: its key moments side by side, drawn from its recording alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from .meshes import Meshes
from .motion import Signals, describe_run, key_moments, poses, scene_of
from .offscreen import Image, OffscreenRenderer

if TYPE_CHECKING:
    from PIL import Image as Pillow

MAX_TILES = 48
TILE = (480, 360)  # [px] width and height of an image
COLUMNS = 4
GAP = 14  # [px] between images
MARGIN = 36  # [px] around all
HEADER = 74  # [px] for the title
CAPTION = 34  # [px] under an image

PAPER = (255, 255, 255)
INK = (32, 36, 42)
GREY = (110, 116, 124)


def contact_sheet(
    recording: Signals,
    path: str | Path,
    *,
    count: int = 12,
    camera: str = "overview",
    meshes: Meshes = "never",
) -> Path:
    """Write a PNG with up to `count` key moments of a run, seen from a camera of the scene."""
    from PIL.PngImagePlugin import PngInfo  # noqa: PLC0415 - slow to import

    path = Path(path)
    if not 2 <= count <= MAX_TILES:
        raise InputError(f"count: value {count}; must be from 2 to {MAX_TILES}")
    moments = key_moments(recording, count)
    at = np.array([moment.time for moment in moments])
    qpos = poses(recording, at)
    with closing(OffscreenRenderer(scene_of(recording), *TILE, camera, meshes)) as renderer:
        tiles = list(renderer.frames(qpos))
    captions = [(f"{moment.time:.2f} s", moment.label) for moment in moments]
    sheet = _compose(tiles, captions, describe_run(recording))
    note = PngInfo()
    note.add_text("Comment", MARK)
    with replacing(path) as temporary:
        sheet.save(temporary, format="PNG", optimize=True, pnginfo=note)
    return path


def _compose(
    tiles: Sequence[Image], captions: Sequence[tuple[str, str]], title: tuple[str, str]
) -> Pillow.Image:
    """Put images (360, 480, 3) on a page, row by row, with time and event under each."""
    from PIL import Image as Pillow  # noqa: PLC0415 - slow to import
    from PIL import ImageDraw, ImageFont  # noqa: PLC0415 - slow to import

    width, height = TILE
    columns = min(COLUMNS, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    step_x, step_y = width + GAP, height + CAPTION + GAP
    size = (2 * MARGIN - GAP + columns * step_x, 2 * MARGIN - GAP + HEADER + rows * step_y)
    page = Pillow.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    draw.text((MARGIN, MARGIN), title[0], INK, ImageFont.load_default(30), anchor="lt")
    draw.text((MARGIN, MARGIN + 40), title[1], GREY, ImageFont.load_default(18), anchor="lt")
    font = ImageFont.load_default(20)
    for index, (tile, (time, event)) in enumerate(zip(tiles, captions, strict=True)):
        row, column = divmod(index, columns)
        x, y = MARGIN + column * step_x, MARGIN + HEADER + row * step_y
        page.paste(Pillow.fromarray(tile), (x, y))
        base = y + height + 25
        draw.text((x + 2, base), time, INK, font, anchor="ls")
        after = x + 14 + draw.textlength(time, font)
        draw.text((after, base), event, GREY, font, anchor="ls")
    return page
