"""Draws a scene off screen in a separate process: MUJOCO_GL must be set before importing MuJoCo.

The process is this module, started by `OffscreenRenderer`. It first says whether it can draw. Then
it gets rows of qpos, and answers with the bytes of one RGB image for each row.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from subprocess import DEVNULL
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...fmus.errors import InputError, one_line
from ...fmus.processes import Child, listen
from ...plant.parameters import PlantParameters
from ...task.fields import check_choice
from .gl import RenderError, backends, what_to_install

Image = NDArray[np.uint8]
Draw = Callable[[Any], bytes]
"""From positions qpos (nq,) to an image (height, width, 3)."""

PROCESS: Final = "panda_cosim.result.pictures.offscreen"


class OffscreenRenderer:
    """Draws with `mujoco.Renderer` in another process, by the first `backend` that works.

    Video and contact sheet make one each, and close it. Pages draw in the browser, and plots need
    no scene: neither uses it.
    """

    def __init__(self, scene: str, width: int, height: int, camera: str = "overview") -> None:
        self._shape = (height, width, 3)
        job, failures = json.dumps([scene, width, height, camera]), dict[str, str]()
        for backend in backends():
            environment = {"MUJOCO_GL": backend}  # what drivers print is not shown
            self._child = Child("-m", PROCESS, job, output=DEVNULL, environment=environment)
            with ExitStack() as stack:
                stack.callback(self.close)
                reply = self._first_reply()
                if "device" in reply:
                    stack.pop_all()
                    self.backend, self.device = backend, reply["device"]
                    return
            if "refused" in reply:
                raise InputError(reply["refused"])
            failures[backend] = reply["failed"]
        raise RenderError(what_to_install(failures))

    def frames(self, qpos: Array) -> Iterator[Image]:
        """Yield the image (height, width, 3) of each row of positions (k, nq); take all of them."""
        connection = self._child.connection
        with suppress(OSError):  # ended; the missing reply will show that
            connection.send(qpos)
        for _ in qpos:
            try:
                image = connection.recv_bytes()
            except (EOFError, OSError):
                code = self._child.ended()
                text = f"picture missing: the process that draws ended with code {code}"
                raise RenderError(text) from None
            yield np.frombuffer(image, np.uint8).reshape(self._shape)

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._child.end()

    def _first_reply(self) -> dict[str, str]:
        """Return the reply of the process once it has drawn an image, or has failed to."""
        try:
            return dict(self._child.connection.recv())
        except (EOFError, OSError):
            return {"failed": f"its process ended with code {self._child.ended()}"}


def describe_gl() -> str:
    """Return the working backend and its device.

    Raises:
        RenderError: None works; the message says what to install.
    """
    with closing(OffscreenRenderer("tabletop", 16, 16)) as renderer:
        return f"{renderer.backend}: {renderer.device}"


def _open_scene(scene: str, width: int, height: int, camera: str) -> tuple[int, Draw]:
    """Return a scene's number of positions and a function that draws it."""
    import mujoco  # noqa: PLC0415 - fails where the backend's library is missing

    from ...fmus.sources.model_fmu import MODEL_SUFFIX, load  # noqa: PLC0415 - imports MuJoCo
    from ...plant.scene import load_scene  # noqa: PLC0415 - imports MuJoCo

    is_file = scene.endswith(MODEL_SUFFIX)
    model = load(Path(scene)) if is_file else load_scene(PlantParameters(scene=scene), drawn=True)
    names = [model.cam(index).name for index in range(model.ncam)]
    view: str | int = camera
    if is_file and camera == "overview" and camera not in names:
        view = 0 if names else -1  # its first camera, or MuJoCo's free one
    else:
        check_choice("camera", camera, names)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, height, width)

    def draw(qpos: Any) -> bytes:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        renderer.update_scene(data, view)
        return bytes(renderer.render().tobytes())

    return model.nq, draw


def _serve(job: list[Any], connection: Connection) -> None:
    """Report whether drawing works, then draw the requested images."""
    try:
        nq, draw = _open_scene(*job)
        draw(np.zeros(nq))  # a driver may fail, or crash, at the first image
        reply = {"device": _device()}
    except InputError as error:
        reply = {"refused": str(error)}
    except Exception as error:  # whatever a driver raises, the caller tries another backend
        reply = {"failed": f"{type(error).__name__}: {one_line(error)}"}
    connection.send(reply)
    while "device" in reply:
        for qpos in connection.recv():
            connection.send_bytes(draw(qpos))


def _device() -> str:
    """Return OpenGL's name of the device; MuJoCo's backends for a screen have no PyOpenGL."""
    try:
        from OpenGL import GL  # noqa: PLC0415 - reads the environment when imported

        return str(GL.glGetString(GL.GL_RENDERER).decode())
    except Exception:  # the name is only informative
        return "unknown device"


if __name__ == "__main__":
    with suppress(EOFError, OSError):  # the parent needs no more
        _serve(json.loads(sys.argv[1]), listen(*map(int, sys.argv[2:])))
    os._exit(0)  # without OpenGL's clean-up, in which drivers tend to crash
