"""Which OpenGL backends of MuJoCo to try, and what to install if none works.

MuJoCo loads the backend named in MUJOCO_GL when it is imported; the import fails if the backend's
library is missing. Pictures are therefore drawn in a separate process, see `offscreen`, which is
started with one backend after the other until one works. The command line keeps MuJoCo from
loading any backend in its own process.
"""

from __future__ import annotations

import os
import sys
import tomllib
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from pathlib import Path
from typing import Final

from ...fmus.errors import CosimError

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
LIBRARIES: Final[Mapping[str, Mapping[str, str]]] = _TABLES["libraries"]
CHOICE: Final = "PANDA_COSIM_GL"  # the user's MUJOCO_GL, once the command line has set that itself


class RenderError(CosimError):
    """No picture can be drawn; everything else works."""


def load_no_backend() -> None:
    """Keep MuJoCo from loading a backend in this process; the drawing process can still choose."""
    # For programs, not for libraries: it changes the environment.
    os.environ.setdefault(CHOICE, os.environ.get("MUJOCO_GL", ""))
    os.environ["MUJOCO_GL"] = "disable"


def backends() -> Sequence[str]:
    """Return the backends to try, best first; only MUJOCO_GL if it names one."""
    asked = _asked()
    if asked in _TABLES["off"]:
        raise RenderError(f"MUJOCO_GL={asked} switches drawing off; unset it to get pictures")
    return _TABLES["backends"][sys.platform] if asked in _TABLES["any"] else [asked]


def what_to_install(failures: Mapping[str, str]) -> str:
    """Return one line on how to get a backend; `failures` says why each one does not work."""
    message = f"no picture can be drawn, as no OpenGL backend works (tried {', '.join(failures)})"
    backend, reason = next(iter(failures.items()))
    libraries = LIBRARIES.get(backend, {})
    missing = [package for library, package in libraries.items() if not find_library(library)]
    install = f"on Debian or Ubuntu, apt-get install {' '.join(missing)}"
    advice = install if missing else f"{backend} says {reason!r}"
    pinned = f" (or unset MUJOCO_GL, which asks for {_asked()} alone)"
    return f"{message}: {advice}{'' if _asked() in _TABLES['any'] else pinned}"


def _asked() -> str:
    return os.environ.get(CHOICE, os.environ.get("MUJOCO_GL", "")).lower().strip()
