"""The drawing process; started only by `offscreen.OffscreenRenderer`, with MUJOCO_GL set.

It first writes a line of JSON that says whether it can draw. Then it reads a number of rows
(int64) and their qpos (float64) from standard input and writes one RGB image for each row, until
standard input is closed.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from ...fmus.errors import InputError
from ...fmus.messages import one_line
from ..fields import check_choice
from .meshes import Meshes, load_model

Draw = Callable[[Any], bytes]
"""From positions qpos (nq,) to an image (height, width, 3)."""


def open_scene(
    scene: str, width: int, height: int, camera: str, meshes: Meshes
) -> tuple[int, Draw]:
    """Return a scene's number of positions and a function that draws it.

    The arguments are those of `OffscreenRenderer`.
    """
    import mujoco  # noqa: PLC0415 - fails where the backend's library is missing

    model = load_model(scene, meshes)
    names = [model.cam(index).name for index in range(model.ncam)]
    view: str | int = camera
    if scene.endswith(".mjb") and camera == "overview" and camera not in names:
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


def serve(job: list[Any], requests: BinaryIO, replies: BinaryIO) -> None:
    """Report whether drawing works, then draw the requested images."""
    nq, reply = 0, {}
    try:
        nq, draw = open_scene(*job)
        draw(np.zeros(nq))  # a driver may fail, or crash, at the first image
        reply = {"device": _device()}
    except InputError as error:
        reply = {"refused": str(error)}
    except Exception as error:  # whatever a driver raises, the caller tries another backend
        reply = {"failed": f"{type(error).__name__}: {one_line(error)}"}
    replies.write(json.dumps(reply).encode() + b"\n")
    replies.flush()
    while count := requests.read(8):
        size = 8 * nq * int.from_bytes(count, "little")
        for qpos in np.frombuffer(requests.read(size), "<f8").reshape(-1, nq):
            replies.write(draw(qpos))
            replies.flush()


def _device() -> str:
    """Return OpenGL's name of the device; MuJoCo's backends for a screen have no PyOpenGL."""
    try:
        from OpenGL import GL  # noqa: PLC0415 - reads the environment when imported

        return str(GL.glGetString(GL.GL_RENDERER).decode())
    except Exception:  # the name is only informative
        return "unknown device"


if __name__ == "__main__":
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # drivers print to standard output, too
    with suppress(BrokenPipeError):  # the parent has ended
        serve(json.loads(sys.argv[1]), sys.stdin.buffer, answers)
    os._exit(0)  # without OpenGL's clean-up, in which drivers tend to crash
