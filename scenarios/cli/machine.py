"""Examines this machine for `doctor`: what is installed, what is missing, and how to get it."""

from __future__ import annotations

import platform
import re
import shutil
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from ...fmus.atomic import cache_folder
from ...fmus.errors import CosimError, InputError
from ...fmus.master.archive import is_noexec
from ...fmus.packaging.compile import BACKENDS, PLATFORMS, can_compile, this_platform
from ...fmus.packaging.libraries import is_prebuilt

State = Literal["ok", "optional", "needed"]

PICTURES = ("imageio-ffmpeg", "matplotlib", "mediapy", "pillow")  # packages only for pictures
ANALYSIS = ("control", "scipy")  # packages only for `analyze`


@dataclass(frozen=True)
class Finding:
    """The state of one prerequisite.

    Attributes:
        what: Its name.
        state: "ok", or missing and "optional" or "needed" to run scenarios.
        detail: What was found, in one line.
        remedy: How to get it; "" if nothing is missing.
    """

    what: str
    state: State
    detail: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Examine all prerequisites; a missing one raises no error."""
    looks: tuple[Callable[[], Iterator[Finding]], ...] = (
        _python,
        _packages,
        _fmu_libraries,
        _cache,
        _opengl,
        _ffmpeg,
        _menagerie,
        _shared_library,
        _compiler,
    )
    return list(dict.fromkeys(finding for look in looks for finding in _findings(look)))


def _findings(look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """Yield the findings of one examination, or the package that it cannot be made without."""
    try:
        yield from look()
    except ModuleNotFoundError as error:
        name = error.name or str(error)
        state: State = "optional" if name in (*PICTURES, *ANALYSIS) else "needed"
        yield Finding(name, state, "cannot be imported", f"pip install {name}")


def _python() -> Iterator[Finding]:
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    yield Finding("Python", "ok", found)  # an older one would not install the package


def _packages() -> Iterator[Finding]:
    try:
        listed = requires("panda-cosim") or []
    except PackageNotFoundError:
        remedy = "pip install -e . in the project's folder"
        yield Finding("panda-cosim", "needed", "not installed as a package", remedy)
        return
    yield Finding("panda-cosim", "ok", version("panda-cosim"))
    for text in listed:
        if "extra ==" not in text and _applies(text):
            yield _package(text)


def _applies(requirement: str) -> bool:
    """Whether a requirement applies to this platform; understands only our kind of marker."""
    match = re.search(r"sys_platform\s*==\s*[\"'](\w+)[\"']", requirement)
    return match is None or match[1] == sys.platform


def _package(requirement: str) -> Finding:
    bare = requirement.partition(";")[0].strip()
    name = (re.match(r"[\w.-]+", bare) or [bare])[0]
    only = "pictures" if name in PICTURES else "analyze" if name in ANALYSIS else ""
    what = f"{name} (for {only})" if only else name
    state: State = "optional" if only else "needed"
    try:
        found = version(name)
    except PackageNotFoundError:
        return Finding(what, state, "not installed", f"pip install '{bare}'")
    bound = re.search(r">=\s*([\d.]+)", bare)
    if bound and _numbers(found) < _numbers(bound[1]):
        return Finding(what, state, f"{found} is too old", f"pip install '{bare}'")
    return Finding(what, "ok", found)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:3])


def _fmu_libraries() -> Iterator[Finding]:
    """The FMUs' libraries are part of the package, or are compiled when FMUs are built."""
    what = "libraries of the FMUs"
    try:
        name = this_platform()
        missing = [backend for backend in BACKENDS if not is_prebuilt(backend, name)]
    except CosimError as error:
        yield Finding(what, "needed", str(error), f"use {', '.join(PLATFORMS)}")
        return
    if not missing:
        yield Finding(what, "ok", f"{name}, compiled with the package")
    elif can_compile(name):
        yield Finding(what, "ok", f"{name}, compiled when they are needed")
    else:
        remedy = "pip install 'panda-cosim[cross]', or a compiler named cc, gcc or clang"
        yield Finding(what, "needed", f"{', '.join(missing)}: no library, no compiler", remedy)


def _cache() -> Iterator[Finding]:
    try:
        folder = _usable_cache()
    except CosimError as error:
        remedy = "set PANDA_COSIM_CACHE to a folder that is yours alone"
        yield Finding("FMU cache", "needed", str(error).partition("; ")[0], remedy)
        return
    from ...fmus.packaging.build import outdated  # noqa: PLC0415 - may be missing

    try:
        state = "the next run builds the FMUs" if outdated() else "the FMUs are built"
    except CosimError as error:
        state = str(error)
    yield Finding("FMU cache", "ok", f"{folder}: {state}")


def _usable_cache() -> Path:
    """Return the cache.

    Raises:
        InputError: FMUs cannot be written to it, or must not be loaded from it.
    """
    folder = cache_folder()
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
        if is_noexec(folder):
            raise InputError(f"{folder}: mounted noexec, so that no library can be loaded from it")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error
    return folder


def _opengl() -> Iterator[Finding]:
    from ..pictures.offscreen import describe_gl  # noqa: PLC0415 - may be missing

    what = "OpenGL (for pictures)"
    backend, detail = describe_gl()
    if backend is None:
        yield Finding(what, "optional", *_split(detail))
    else:
        yield Finding(what, "ok", f"{backend}: {detail}")


def _ffmpeg() -> Iterator[Finding]:
    from ..pictures.gl import RenderError  # noqa: PLC0415 - may be missing
    from ..pictures.video import find_ffmpeg  # noqa: PLC0415 - may be missing

    what = "ffmpeg (for the video)"
    try:
        yield Finding(what, "ok", find_ffmpeg())
    except RenderError as error:
        yield Finding(what, "optional", *_split(str(error)))


def _split(message: str) -> tuple[str, str]:
    """Split a message at the first : or ; into the fault and the remedy."""
    parts = re.split(r"[:;] ", message, maxsplit=1)
    return parts[0], parts[-1]


def _menagerie() -> Iterator[Finding]:
    from ..pictures.meshes import find_menagerie  # noqa: PLC0415 - may be missing

    folder = find_menagerie()
    what = "Menagerie's meshes (for looks)"
    if folder is None:
        remedy = "set MENAGERIE_ROOT to a checkout of MuJoCo Menagerie"
        yield Finding(what, "optional", "not found; the arm is drawn in plain shapes", remedy)
    else:
        yield Finding(what, "ok", str(folder))


def _shared_library() -> Iterator[Finding]:
    """The library that hosts other than Python load for FMUs of the Python kind."""
    what = "Python as shared library (for FMUs in Python in other hosts)"
    folder, name = (sysconfig.get_config_var(key) for key in ("LIBDIR", "INSTSONAME"))
    path = Path(folder or "/", name or "")
    if sys.platform == "win32":
        yield Finding(what, "ok", f"{sys.base_prefix}")
    elif sysconfig.get_config_var("Py_ENABLE_SHARED") and path.exists():
        yield Finding(what, "ok", str(path))
    else:
        remedy = (
            "use a Python with a shared library: Debian's python3 with libpython3-dev, or "
            "PYTHON_CONFIGURE_OPTS=--enable-shared pyenv install 3.12"
        )
        yield Finding(what, "optional", "this Python has none", remedy)


def _compiler() -> Iterator[Finding]:
    what = "C compiler (for the tests)"
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if found:
        yield Finding(what, "ok", found)
    else:
        yield Finding(what, "optional", "not found", "on Debian or Ubuntu, apt-get install gcc")
