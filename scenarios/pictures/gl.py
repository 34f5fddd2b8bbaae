"""Which OpenGL backend draws the pictures, and what to install where none works.

MuJoCo's own choice is made once, when `mujoco` is first imported, and a backend whose library is
missing can raise there or crash. So each candidate is tried in a child process first, and the
context is then made from the backend's class directly: it does not matter who imported `mujoco`
before, nor what MUJOCO_GL was then.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from ctypes.util import find_library
from dataclasses import dataclass
from functools import cache
from typing import Protocol, cast

from ...fmus.errors import CosimError

LIBRARIES = {
    "egl": {"EGL": "libegl1", "GL": "libgl1"},
    "osmesa": {"OSMesa": "libosmesa6"},
    "glfw": {"GL": "libgl1"},
}
"""Libraries that a backend loads and their Debian packages, tried on a minimal Debian 12: libgl1
also brings Mesa's software driver, without which libegl1 alone finds no device."""

PROBE_SECONDS = 30.0
"""A probe takes half a second; a driver that hangs is given up after this time."""

OFF = ("disable", "disabled", "off", "false", "0")
ANY = ("", "enable", "enabled", "on", "true", "1")
"""What MuJoCo takes MUJOCO_GL to mean beside a backend's name."""

# Draws one frame and prints the name of the device that drew it. MUJOCO_GL must be switched off
# there, or importing mujoco would already load a backend.
PROBE = """
import importlib, sys
import mujoco
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
model = mujoco.MjModel.from_xml_string("<mujoco/>")
renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, renderer)
mujoco.mjr_render(mujoco.MjrRect(0, 0, 16, 16), mujoco.MjvScene(model, 1), renderer)
name = "unknown device"
try:
    from OpenGL import GL
    name = GL.glGetString(GL.GL_RENDERER).decode()
except Exception:
    pass
print("drawn by " + name, flush=True)
renderer.free()
context.free()
"""


class RenderError(CosimError):
    """No picture can be made; everything that needs none is unaffected."""


class GLContext(Protocol):
    """An OpenGL context as MuJoCo's backends make it."""

    def make_current(self) -> None:
        """Make it the calling thread's context."""

    def free(self) -> None:
        """Release it."""


@dataclass(frozen=True)
class Probe:
    """Outcome of trying one backend in a child process.

    Attributes:
        backend: Name of the backend.
        works: Whether it drew a frame.
        detail: Name of the device that drew it, or the reason why none did.
    """

    backend: str
    works: bool
    detail: str


@dataclass(frozen=True)
class GLReport:
    """What `doctor` says about drawing.

    Attributes:
        backend: The backend that is used, or None where none works.
        detail: Name of the device, or the one-line message that says what to install.
        probes: Every backend that was tried, in this order.
    """

    backend: str | None
    detail: str
    probes: tuple[Probe, ...]


def candidates() -> tuple[str, ...]:
    """Return the backends to try, best first: MUJOCO_GL alone where that names one.

    Raises:
        RenderError: If MUJOCO_GL switches drawing off or holds a value that MuJoCo refuses.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in OFF:
        raise RenderError(f"MUJOCO_GL={asked} switches drawing off; unset it to get pictures")
    known = _known_backends()
    if asked in ANY:
        return known
    asked = "glfw" if asked in ("glx", "wgl") else asked
    if asked not in (*known, "glfw"):
        names = ", ".join(known)
        raise RenderError(f"MUJOCO_GL={asked}: must be one of {names}; or unset it")
    return (asked,)


def choose_backend() -> str:
    """Return the first backend that works.

    Raises:
        RenderError: If none does; the message names what to install.
    """
    report = _try_all(candidates())
    if report.backend is None:
        raise RenderError(report.detail)
    return report.backend


def create_context(width: int, height: int) -> GLContext:
    """Make an off-screen context on the backend that works.

    Args:
        width: Width of the largest picture [px].
        height: Height of the largest picture [px].

    Raises:
        RenderError: If no backend works.
    """
    backend = choose_backend()
    try:
        module = importlib.import_module(f"mujoco.{backend}")
        return cast(GLContext, module.GLContext(width, height))
    # Whatever a driver or PyOpenGL raises here, the answer to the user is the same.
    except Exception as error:
        raise RenderError(f"the {backend} backend of OpenGL failed: {_one_line(error)}") from error


def describe_gl() -> GLReport:
    """Try the backends and report; never raises for a backend that is missing."""
    try:
        return _try_all(candidates())
    except RenderError as error:
        return GLReport(None, str(error), ())


def _known_backends() -> tuple[str, ...]:
    """Return the backends of this operating system, best first."""
    if sys.platform == "darwin":
        return ("cgl", "glfw")
    if sys.platform == "win32":
        return ("glfw",)
    return ("glfw", "egl", "osmesa") if _has_screen() else ("egl", "osmesa")


def _has_screen() -> bool:
    """Return whether a display server is named, without which glfw is not worth a try."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@cache
def _try_all(backends: tuple[str, ...]) -> GLReport:
    """Try backends until one works."""
    probes: list[Probe] = []
    for backend in backends:
        probes.append(_probe(backend))
        if probes[-1].works:
            return GLReport(backend, probes[-1].detail, tuple(probes))
    return GLReport(None, _what_to_install(probes), tuple(probes))


def _probe(backend: str) -> Probe:
    """Draw a frame in a child process, which may crash or hang without harm."""
    command = [sys.executable, "-P", "-c", PROBE, backend]
    environment = {**os.environ, "MUJOCO_GL": "disable"}
    try:
        done = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Probe(backend, False, _one_line(error))
    said = [line for line in done.stdout.splitlines() if line.startswith("drawn by ")]
    if said:  # What happens when the child tears its context down is no matter.
        return Probe(backend, True, said[0].removeprefix("drawn by "))
    last = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
    return Probe(backend, False, last)


def _what_to_install(probes: list[Probe]) -> str:
    """Return the one line that says how to get a working backend."""
    tried = ", ".join(probe.backend for probe in probes)
    message = f"no picture can be drawn, as no OpenGL backend works (tried {tried})"
    # EGL needs neither a screen nor much disk space: it is the one to have.
    wanted = next((probe for probe in probes if probe.backend == "egl"), probes[0])
    if "PYOPENGL_PLATFORM" in wanted.detail:
        value = os.environ.get("PYOPENGL_PLATFORM")
        return f"{message}: unset PYOPENGL_PLATFORM, which is {value!r}"
    if sys.platform != "linux":
        return f"{message}: {wanted.detail}"
    if wanted.backend == "glfw" and not _has_screen():
        return f"{message}: glfw needs a screen, and DISPLAY is not set{_pinned()}"
    needed = LIBRARIES[wanted.backend]
    missing = [package for library, package in needed.items() if not find_library(library)]
    if missing:
        return f"{message}: on Debian or Ubuntu, apt-get install {' '.join(missing)}{_pinned()}"
    return f"{message}: {wanted.backend} is installed but says {wanted.detail!r}{_pinned()}"


def _pinned() -> str:
    """Return a remark for the case that MUJOCO_GL leaves one backend only."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    return "" if asked in ANY else f" (or unset MUJOCO_GL, which asks for {asked} alone)"


def _one_line(error: BaseException) -> str:
    """Return the error's kind and the first line of its message."""
    lines = str(error).strip().splitlines() or [""]
    return f"{type(error).__name__}: {lines[0]}".removesuffix(": ")
