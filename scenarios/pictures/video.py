"""Video of a run, made from its recording alone."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Self

from ...controller.plotting import without_matplotlibrc
from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from .gl import RenderError
from .meshes import Meshes
from .motion import Signals, frame_times, interpolate_qpos, positions, scene_of
from .offscreen import Image, OffscreenRenderer

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the total."""

FPS_RANGE = (1.0, 240.0)  # [1/s]
QUALITY = 18  # x264's constant rate factor; 18 looks lossless, more makes smaller files
# Drawing is slower than any preset. With its index first, a video starts at once in a browser.
FFMPEG_ARGS = ["-crf", str(QUALITY), "-preset", "medium", "-movflags", "+faststart"]
FFMPEG_ARGS += ["-metadata", f"comment={MARK}"]


def render_video(  # noqa: PLR0913 - options, by keyword
    recording: Signals,
    path: str | Path,
    *,
    fps: float = 60.0,
    width: int = 640,
    height: int = 480,
    camera: str = "overview",
    meshes: Meshes = "never",
    progress: Progress | None = None,
) -> Path:
    """Write a video (H.264, yuv420p, mp4) of a run, frame by frame.

    Args:
        recording: The run.
        path: The file to write; it appears when it is complete.
        fps: Frames per second.
        width: Width [px], even.
        height: Height [px], even.
        camera: Name of a camera of the scene.
        meshes: Whether the arm is drawn with Menagerie's meshes.
        progress: Called after every frame.

    Returns:
        The path.

    Raises:
        InputError: An argument is out of bounds, or the file cannot be written.
        RenderError: There is no working OpenGL or ffmpeg.
    """
    path = Path(path)
    _check_video(path, fps, width, height)
    rows = positions(recording)
    qpos = interpolate_qpos(recording.time, rows, frame_times(recording.time, fps))
    with (
        closing(OffscreenRenderer(scene_of(recording), width, height, camera, meshes)) as renderer,
        replacing(path) as temporary,
        _Encoder(temporary, (height, width), fps) as encoder,
    ):
        for done, image in enumerate(renderer.frames(qpos), start=1):
            encoder.add(image)
            if progress is not None:
                progress(done, len(qpos))
    return path


def find_ffmpeg() -> str:
    """Return the ffmpeg to use: that of IMAGEIO_FFMPEG_EXE, or imageio-ffmpeg's.

    Raises:
        RenderError: There is none.
    """
    try:
        import imageio_ffmpeg  # noqa: PLC0415 - only where it is needed

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise RenderError(
            "no video can be written, as there is no ffmpeg: pip install imageio-ffmpeg"
        ) from error


def _check_video(path: Path, fps: float, width: int, height: int) -> None:
    """Check size and frame rate against the limits of H.264 in 4:2:0."""
    if path.suffix != ".mp4":
        raise InputError(f"{path}: a video's name must end in .mp4")
    low, high = FPS_RANGE
    if not (math.isfinite(fps) and low <= fps <= high):
        raise InputError(f"fps: value {fps:g}; must be from {low:g} to {high:g}")
    for name, side in (("width", width), ("height", height)):
        if side < 16 or side % 2:
            raise InputError(f"{name}: value {side} px; must be even, and 16 px or more")


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block SIGINT in this thread, and permanently in processes started here.

    Otherwise Ctrl-C could end ffmpeg first, and be reported as a failure of ffmpeg.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Encoder:
    """A mediapy.VideoWriter whose failures are RenderErrors and hide no other error."""

    def __init__(self, path: Path, shape: tuple[int, int], fps: float) -> None:
        with without_matplotlibrc():
            import mediapy  # noqa: PLC0415 - imports matplotlib and IPython

        mediapy.set_ffmpeg(find_ffmpeg())
        self._writer = mediapy.VideoWriter(
            path, shape, codec="libx264", fps=fps, ffmpeg_args=FFMPEG_ARGS
        )

    def add(self, image: Image) -> None:
        """Encode one more frame."""
        try:
            self._writer.add_image(image)
        except (RuntimeError, OSError) as error:
            raise self._failed(error) from error

    def __enter__(self) -> Self:
        """Start ffmpeg, out of reach of the terminal's Ctrl-C."""
        with _without_interrupts():
            self._writer.__enter__()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """End ffmpeg; ignore its complaints about a truncated video."""
        try:
            self._writer.close()
        except (RuntimeError, OSError) as failure:
            reason = self._failed(failure)
            if error is None:
                raise reason from failure

    def _failed(self, error: BaseException) -> RenderError:
        """Return the error that says why ffmpeg failed."""
        # Only ffmpeg knows why the pipe broke; close reads its messages.
        with suppress(OSError):
            try:
                self._writer.close()
            except RuntimeError as said:
                error = said
        return RenderError(f"no video: {' '.join(str(error).split())}")
