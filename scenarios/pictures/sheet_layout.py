"""Lays out the images of a contact sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence

from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from .offscreen import Image

TILE = (480, 360)  # [px] width and height of an image
COLUMNS = 4
GAP = 14  # [px] between images
MARGIN = 36  # [px] around all
HEADER = 74  # [px] for the title
CAPTION = 34  # [px] under an image

PAPER = (255, 255, 255)
INK = (32, 36, 42)
GREY = (110, 116, 124)


def compose(
    tiles: Sequence[Image], captions: Sequence[tuple[str, str]], title: tuple[str, str]
) -> Pillow.Image:
    """Put images on a page, row by row, with a title above and a caption under each.

    Args:
        tiles: Images (360, 480, 3).
        captions: Time and event of each image.
        title: Title and subtitle of the page.

    Returns:
        The page.
    """
    width, height = TILE
    columns = min(COLUMNS, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    step_x, step_y = width + GAP, height + CAPTION + GAP
    size = (2 * MARGIN - GAP + columns * step_x, 2 * MARGIN - GAP + HEADER + rows * step_y)
    page = Pillow.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(page)
    _write_title(draw, title)
    for index, (tile, caption) in enumerate(zip(tiles, captions, strict=True)):
        row, column = divmod(index, columns)
        corner = (MARGIN + column * step_x, MARGIN + HEADER + row * step_y)
        page.paste(Pillow.fromarray(tile), corner)
        _write_caption(draw, (corner[0], corner[1] + height), caption)
    return page


def _write_title(draw: ImageDraw.ImageDraw, title: tuple[str, str]) -> None:
    """Write title and subtitle, one line each."""
    draw.text((MARGIN, MARGIN), title[0], INK, ImageFont.load_default(30), anchor="lt")
    draw.text((MARGIN, MARGIN + 40), title[1], GREY, ImageFont.load_default(18), anchor="lt")


def _write_caption(
    draw: ImageDraw.ImageDraw, corner: tuple[int, int], caption: tuple[str, str]
) -> None:
    """Write a time and, beside it, the event."""
    font = ImageFont.load_default(20)
    base = (corner[0] + 2, corner[1] + 25)
    draw.text(base, caption[0], INK, font, anchor="ls")
    after = base[0] + draw.textlength(caption[0], font) + 12
    draw.text((after, base[1]), caption[1], GREY, font, anchor="ls")
