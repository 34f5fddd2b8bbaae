"""Video of a run, drawn from its recording alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError, one_line
from ...result.recording import Recording
from ...task.fields import Quantity
from .gl import RenderError
from .motion import frame_times, poses, scene_of
from .offscreen import OffscreenRenderer

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the total."""

MAX_SIDE = 8192  # [px] more than any video needs, less than graphics drivers refuse
FPS_RANGE = (1.0, 240.0)  # [1/s]
FPS = 30.0  # [1/s] by default: without a GPU, each frame costs a tenth of a second
QUALITY = 18  # x264's constant rate factor; 18 looks lossless, more makes smaller files
# Drawing is slower than any preset. With its index first, a video starts at once in a browser.
FFMPEG_ARGS = ["-crf", str(QUALITY), "-preset", "medium", "-movflags", "+faststart"]
FFMPEG_ARGS += ["-metadata", f"comment={MARK}"]


def render_video(  # noqa: PLR0913 - options, by keyword
    recording: Recording,
    path: str | Path,
    *,
    fps: float = FPS,
    width: int = 640,
    height: int = 480,
    camera: str = "overview",
    progress: Progress | None = None,
) -> Path:
    """Write a video (H.264, yuv420p, mp4) of a run; width and height are even [px]."""
    path = Path(path)
    check_video(path, fps, width, height)
    qpos = poses(recording, frame_times(recording.time, fps))
    with (
        closing(OffscreenRenderer(scene_of(recording), width, height, camera)) as renderer,
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
    form: dict[str, Any] = {"codec": "libx264", "fps": fps, "ffmpeg_args": FFMPEG_ARGS}
    try:
        with mediapy.VideoWriter(path, shape, **form) as writer:
            yield writer
    except (RuntimeError, OSError) as error:
        if isinstance(error.__context__, Exception | None):
            raise RenderError(f"no video: {one_line(error)}") from error
        raise error.__context__ from None  # Ctrl-C, which ends ffmpeg, too
