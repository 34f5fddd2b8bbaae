"""Draws a scene at given positions, off screen."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ..fields import check_choice
from .gl import create_context
from .meshes import Meshes, load_look
from .motion import FloatArray

Image = NDArray[np.uint8]

MAX_SIDE = 8192  # [px] more than any video needs, less than what graphics drivers refuse
MAX_SHAPES = 1000  # a scene has about 100, dressed in meshes


class Stage:
    """A scene with a camera in front of it. A context manager, to be used by one thread.

    MuJoCo's own `Renderer` is not used: it takes whatever backend was chosen when `mujoco` was
    first imported, and here that may have been long ago and without a thought of pictures.

    Args:
        scene: Name of the scene.
        width: Width of the images [px].
        height: Height of the images [px].
        camera: Name of a camera of the scene.
        meshes: Whether the arm wears Menagerie's meshes.

    Raises:
        InputError: The scene or camera is unknown, or the size is out of bounds.
        RenderError: No OpenGL backend works.
    """

    def __init__(
        self, scene: str, width: int, height: int, camera: str, meshes: Meshes = "never"
    ) -> None:
        self._context: Any = None
        self._renderer: Any = None
        for name, side in (("width", width), ("height", height)):
            if not 1 <= side <= MAX_SIDE:
                raise InputError(f"{name}: value {side} px; must be from 1 to {MAX_SIDE} px")
        gl_context = create_context(width, height)  # before mujoco: see scenarios.pictures.gl
        try:
            import mujoco  # noqa: PLC0415  # heavy

            self._mj: Any = mujoco
            self._model = load_look(scene, meshes)
            self._camera = self._find_camera(camera)
            self._open(gl_context, width, height)
        except BaseException:
            gl_context.free()
            raise
        self._context = gl_context

    def draw(self, qpos: FloatArray) -> Image:
        """Return the image (height, width, 3) of the scene at the positions qpos (16,).

        The array is overwritten by the next call.
        """
        mj, model, data = self._mj, self._model, self._data
        self._context.make_current()
        data.qpos[:] = qpos
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_camlight(model, data)
        everything = mj.mjtCatBit.mjCAT_ALL.value
        mj.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        mj.mjr_render(self._rect, self._scene, self._renderer)
        mj.mjr_readPixels(self._pixels, None, self._rect, self._renderer)
        self._image[:] = self._pixels[::-1]  # OpenGL's first row is the lowest
        return self._image

    def close(self) -> None:
        """Release the context; a second call does nothing."""
        if self._context is not None:
            self._context.make_current()
            self._renderer.free()
            self._context.free()
            self._context = None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Release the context."""
        self.close()

    def _find_camera(self, name: str) -> Any:
        """Return the camera of that name."""
        names = [self._model.camera(index).name for index in range(self._model.ncam)]
        check_choice("camera", name, names)
        camera = self._mj.MjvCamera()
        camera.type = self._mj.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = names.index(name)
        return camera

    def _open(self, context: Any, width: int, height: int) -> None:
        """Load the model into the graphics device and reserve the images."""
        mj = self._mj
        self._model.vis.global_.offwidth = width
        self._model.vis.global_.offheight = height
        self._data = mj.MjData(self._model)
        self._option = mj.MjvOption()
        self._scene = mj.MjvScene(self._model, MAX_SHAPES)
        self._rect = mj.MjrRect(0, 0, width, height)
        context.make_current()
        self._renderer = mj.MjrContext(self._model, mj.mjtFontScale.mjFONTSCALE_100.value)
        mj.mjr_setBuffer(mj.mjtFramebuffer.mjFB_OFFSCREEN.value, self._renderer)
        self._pixels: Image = np.empty((height, width, 3), np.uint8)
        self._image: Image = np.empty_like(self._pixels)
