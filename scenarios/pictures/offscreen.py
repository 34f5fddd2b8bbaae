"""Draws a scene off screen in a separate process: MUJOCO_GL must be set before importing MuJoCo."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from threading import Timer
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.processes import SAFE_PATH
from .gl import RenderError, backends, what_to_install
from .meshes import Meshes
from .motion import FloatArray

Image = NDArray[np.uint8]

MAX_SIDE: Final = 8192  # [px] more than any video needs, less than graphics drivers refuse
SECONDS: Final = 60.0  # [s] for a start, which takes 1 s, and for a picture: a driver may hang
PROCESS: Final = "panda_cosim.scenarios.pictures.offscreen_process"


class OffscreenRenderer:
    """Draws a scene with `mujoco.Renderer` in another process. Must be closed.

    Args:
        scene: Name of the scene.
        width: Width of the images [px].
        height: Height of the images [px].
        camera: Name of a camera of the scene.
        meshes: Whether the arm is drawn with Menagerie's meshes.

    Attributes:
        backend: The OpenGL backend.
        device: Name of the rendering device.

    Raises:
        InputError: The scene or camera is unknown, or the size is out of bounds.
        RenderError: No OpenGL backend works.
    """

    def __init__(
        self,
        scene: str,
        width: int,
        height: int,
        camera: str = "overview",
        meshes: Meshes = "never",
    ) -> None:
        for name, side in (("width", width), ("height", height)):
            if not 1 <= side <= MAX_SIDE:
                raise InputError(f"{name}: value {side} px; must be from 1 to {MAX_SIDE} px")
        self._shape = (height, width, 3)
        failures: dict[str, str] = {}
        for backend in backends():
            self._gave_up = False
            self._process = _start(backend, [scene, width, height, camera, meshes])
            try:
                reply = self._first_reply()
            except BaseException:  # Ctrl-C among them
                self.close()
                raise
            if "device" in reply:
                self.backend, self.device = backend, reply["device"]
                return
            self.close()
            if "refused" in reply:
                raise InputError(reply["refused"])
            failures[backend] = reply["failed"]
        raise RenderError(what_to_install(failures))

    def frames(self, qpos: FloatArray) -> Iterator[Image]:
        """Yield the image (height, width, 3) of each row of positions (k, nq); take all of them.

        Raises:
            RenderError: The drawing process has ended.
        """
        rows = np.ascontiguousarray(qpos, dtype="<f8")
        with self._patience(), suppress(OSError):  # ended; the missing reply will show that
            self._process.stdin.write(np.array(len(rows), "<i8").tobytes() + rows.tobytes())
            self._process.stdin.flush()
        size = int(np.prod(self._shape))
        for _ in rows:
            with self._patience():
                content = self._process.stdout.read(size)
            if len(content) < size:
                raise RenderError(f"no picture: the process that draws {self._how_it_ended()}")
            yield np.frombuffer(content, np.uint8).reshape(self._shape)

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):  # of what could not be sent
                pipe.close()

    def _first_reply(self) -> dict[str, str]:
        """Return the reply of the process once it has drawn an image, or has failed to."""
        with self._patience():
            line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            return {"failed": f"its process {self._how_it_ended()}"}
        return dict(json.loads(line))

    @contextmanager
    def _patience(self) -> Iterator[None]:
        """End the process if the block takes too long; reading from it ends then, too."""
        timer = Timer(SECONDS, self._give_up)
        timer.daemon = True  # else a command that is interrupted here would wait for it
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _give_up(self) -> None:
        self._gave_up = True
        self._process.kill()

    def _how_it_ended(self) -> str:
        code = self._process.wait()
        if self._gave_up:
            return f"did not answer for {SECONDS:g} s"
        return f"ended with code {code}"


def _start(backend: str, job: list[Any]) -> Any:
    return subprocess.Popen(
        [sys.executable, "-m", PROCESS, json.dumps(job)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "MUJOCO_GL": backend, **SAFE_PATH},
        process_group=0,  # out of reach of the terminal's Ctrl-C: it ends with its pipes
    )


def describe_gl() -> tuple[str | None, str]:
    """Return the working backend and its device, or None and what to install."""
    try:
        with closing(OffscreenRenderer("tabletop", 16, 16)) as renderer:
            return renderer.backend, renderer.device
    except RenderError as error:
        return None, str(error)
