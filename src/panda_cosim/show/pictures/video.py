"""Video and contact sheet of a run, made from its recording alone.

The sheet shows the run's key moments side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError, one_line
from ...task.fields import Quantity
from .gl import RenderError
from .meshes import Meshes
from .motion import Signals, describe_run, frame_times, key_moments, poses, scene_of
from .offscreen import MAX_SIDE, Image, OffscreenRenderer

if TYPE_CHECKING:
    from PIL import Image as Pillow

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the total."""

FPS_RANGE = (1.0, 240.0)  # [1/s]
FPS = 30.0  # [1/s] by default: without a GPU, each frame costs a tenth of a second
QUALITY = 18  # x264's constant rate factor; 18 looks lossless, more makes smaller files
# Drawing is slower than any preset. With its index first, a video starts at once in a browser.
FFMPEG_ARGS = ["-crf", str(QUALITY), "-preset", "medium", "-movflags", "+faststart"]
FFMPEG_ARGS += ["-metadata", f"comment={MARK}"]


def render_video(  # noqa: PLR0913 - options, by keyword
    recording: Signals,
    path: str | Path,
    *,
    fps: float = FPS,
    width: int = 640,
    height: int = 480,
    camera: str = "overview",
    meshes: Meshes = "never",
    progress: Progress | None = None,
) -> Path:
    """Write a video (H.264, yuv420p, mp4) of a run; width and height are even [px]."""
    path = Path(path)
    check_video(path, fps, width, height)
    qpos = poses(recording, frame_times(recording.time, fps))
    with (
        closing(OffscreenRenderer(scene_of(recording), width, height, camera, meshes)) as renderer,
        replacing(path) as temporary,
        _encoder(temporary, (height, width), fps) as encoder,
    ):
        for done, image in enumerate(renderer.frames(qpos), start=1):
            encoder.add_image(image)
            if progress is not None:
                progress(done, len(qpos))
    return path


def find_ffmpeg() -> str:
    """Return the ffmpeg to use: that of IMAGEIO_FFMPEG_EXE, or imageio-ffmpeg's."""
    try:
        import imageio_ffmpeg  # noqa: PLC0415 - only where it is needed

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise RenderError(
            "no video can be written, as there is no ffmpeg: pip install imageio-ffmpeg"
        ) from error


def check_video(path: Path, fps: float, width: int, height: int) -> None:
    """Check size and frame rate against the limits of H.264 in 4:2:0 and of drawing."""
    if path.suffix != ".mp4":
        raise InputError(f"{path}: a video's name must end in .mp4")
    Quantity(*FPS_RANGE).check("fps", fps)
    for name, side in (("width", width), ("height", height)):
        if side % 2 or not 16 <= side <= MAX_SIDE:
            raise InputError(f"{name}: value {side} px; must be even, from 16 to {MAX_SIDE} px")


@contextmanager
def _encoder(path: Path, shape: tuple[int, int], fps: float) -> Iterator[Any]:
    """Yield a `mediapy.VideoWriter` for images of that height and width [px]; it runs ffmpeg."""
    import mediapy  # noqa: PLC0415 - imports matplotlib and IPython

    mediapy.set_ffmpeg(find_ffmpeg())
    writer = mediapy.VideoWriter(path, shape, codec="libx264", fps=fps, ffmpeg_args=FFMPEG_ARGS)
    writer.__enter__()
    try:
        yield writer
    except (RuntimeError, OSError) as error:
        raise RenderError(f"no video: {one_line(_ending(writer) or error)}") from error
    finally:
        message = _ending(writer)
    if message:
        raise RenderError(f"no video: {one_line(message)}")


def _ending(writer: Any) -> str:
    """End ffmpeg; return what it complained about, or ""."""
    try:
        writer.close()
    except (RuntimeError, OSError) as error:
        return str(error)
    return ""


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
