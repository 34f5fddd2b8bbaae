"""Contact sheet of a run, made from its recording alone: its key moments side by side."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from .meshes import Meshes
from .motion import (
    Signals,
    describe_run,
    interpolate_qpos,
    key_moments,
    positions,
    scene_of,
)
from .offscreen import OffscreenRenderer

MAX_TILES = 48


def contact_sheet(
    recording: Signals,
    path: str | Path,
    *,
    count: int = 12,
    camera: str = "overview",
    meshes: Meshes = "never",
) -> Path:
    """Write a PNG with the key moments of a run, side by side.

    Args:
        recording: The run.
        path: The file to write.
        count: Number of images, at least 2.
        camera: Name of a camera of the scene.
        meshes: Whether the arm is drawn with Menagerie's meshes.

    Returns:
        The path.

    Raises:
        InputError: An argument is out of bounds, or the file cannot be written.
        RenderError: There is no working OpenGL.
    """
    from PIL.PngImagePlugin import PngInfo  # noqa: PLC0415 - slow to import

    from .sheet_layout import TILE, compose  # noqa: PLC0415 - Pillow

    path = Path(path)
    if not 2 <= count <= MAX_TILES:
        raise InputError(f"count: value {count}; must be from 2 to {MAX_TILES}")
    rows = positions(recording)
    moments = key_moments(recording, count)
    at = np.array([moment.time for moment in moments])
    qpos = interpolate_qpos(recording.time, rows, at)
    with closing(OffscreenRenderer(scene_of(recording), *TILE, camera, meshes)) as renderer:
        tiles = list(renderer.frames(qpos))
    captions = [(f"{moment.time:.2f} s", moment.label) for moment in moments]
    sheet = compose(tiles, captions, describe_run(recording))
    note = PngInfo()
    note.add_text("Comment", MARK)
    with replacing(path) as temporary:
        sheet.save(temporary, format="PNG", optimize=True, pnginfo=note)
    return path
