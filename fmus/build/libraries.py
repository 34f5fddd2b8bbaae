"""The shared libraries in a native FMU: its own, compiled from `fmus/native`, and MuJoCo's.

Each is for this platform or another one.
"""

from __future__ import annotations

import os
import shutil
import sys
import tomllib
import zipfile
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from ..atomic import cache_folder, cached, temporary_folder
from ..errors import CosimError, InputError
from ..processes import pip, run
from .identity import digest, mujoco_package, mujoco_version
from .platforms import PAGE, PLATFORMS, targets, this_platform

SOURCES: Final = Path(__file__).parents[1] / "native"
_MADE_OF: Final = tomllib.loads((SOURCES / "libraries.toml").read_text(encoding="utf-8"))
FLAGS: Final[list[str]] = _MADE_OF["flags"]
FMI_LAYER: Final[list[str]] = _MADE_OF["fmi_layer"]
BACKENDS: Final[Mapping[str, list[str]]] = _MADE_OF["backends"]
PLACES: Final[Mapping[str, int]] = _MADE_OF["places"]  # of data in a page's memory [B]
STEPPER: Final = "stepper"  # no FMU's library, but the master's
NEED_MUJOCO: Final = ("mujoco", "controller")  # backends that open MuJoCo's library
PREBUILT: Final = SOURCES / "lib"  # libraries that came with the package


def compile_library(backend: str, platform: str) -> bytes:
    """Compile the FMI layer and one backend, or the master's stepper."""
    if not compiler(platform):
        raise InputError(
            f"platform {platform}: no C compiler; install `panda-cosim[cross]`, or, for this "
            f"machine, a compiler named cc, gcc or clang"
        )
    with temporary_folder(cache_folder()) as folder:
        compiled = folder / f"fmu{targets()[platform].suffix}"
        command = [
            *compiler(platform),
            *FLAGS,
            *("-I.", *(f"-isystem{include}" for include in includes())),
            *_files(backend, platform),
            *targets()[platform].flags,
            *([f"-Wl,--global-base={PLACES[backend]}"] if platform == PAGE else ()),
            *("-o", str(compiled)),
        ]
        # In the folder of the sources, so that no path gets into the library. The compiler's
        # temporary files go with the folder, also if it is killed.
        done = run(command, SOURCES, os.environ | {"TMPDIR": str(folder)})
        if done.returncode:
            raise CosimError(f"the FMU's library cannot be compiled:\n{done.stderr.strip()}")
        return compiled.read_bytes()


def _files(backend: str, platform: str) -> list[str]:
    """C files of a library."""
    files = BACKENDS[backend] if backend == STEPPER else [*FMI_LAYER, *BACKENDS[backend]]
    others = _MADE_OF["in_a_page"] if platform == PAGE else {}
    return [others.get(file, file) for file in files]


@cache
def compiler(platform: str) -> tuple[str, ...]:
    """The system's for this machine, or ziglang's for others or if there is none; () without it."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if platform == this_platform() and compiler:
        return (compiler,)
    if find_spec("ziglang") is None:
        return ()
    return (sys.executable, "-m", "ziglang", "cc", "-target", targets()[platform].target)


@cache
def includes() -> tuple[Path, ...]:
    """Folders of the FMI standard's headers, which FMPy brings, and of MuJoCo's."""
    places = {"fmpy": "fmpy/c-code", "mujoco": "mujoco/include"}
    found = (distribution(package).locate_file(place) for package, place in places.items())
    return tuple(Path(str(path)) for path in found)


@cache
def library_name(backend: str, platform: str) -> str:
    """File name of a compiled library, with a hash of what it is compiled from."""
    files = {*_files(backend, platform), *(path.name for path in SOURCES.glob("*.h"))}
    sources = {name: (SOURCES / name).read_bytes() for name in files}
    compiled = repr((FLAGS, PLATFORMS[platform]))
    content = digest(sources, compiled, mujoco_version() if backend in NEED_MUJOCO else "")
    return f"{backend}-{platform}-{content[:16]}.bin"


def library(backend: str, platform: str) -> Path:
    """A library that came with the package, or that is compiled and kept in the cache."""
    name = library_name(backend, platform)
    if is_prebuilt(backend, platform):
        return PREBUILT / name
    return cached(cache_folder() / "libraries" / name, lambda: compile_library(backend, platform))


def is_prebuilt(backend: str, platform: str) -> bool:
    """Whether a library came with the package."""
    return (PREBUILT / library_name(backend, platform)).is_file()


def prebuild() -> list[Path]:
    """Compile all libraries for this platform into the package; returns their paths."""
    platform = this_platform()
    PREBUILT.mkdir(exist_ok=True)
    backends = {PREBUILT / library_name(backend, platform): backend for backend in BACKENDS}
    for old in set(PREBUILT.glob("*.bin")) - backends.keys():
        old.unlink()
    for path, backend in backends.items():
        if not path.is_file():
            path.write_bytes(compile_library(backend, platform))
    return list(backends)


def mujoco_library(platform: str) -> bytes:
    """MuJoCo's library for a platform; for another than this one, from its package there."""
    name = PLATFORMS[platform].in_wheel.format(mujoco_version())
    installed = [f for f in distribution(mujoco_package()).files or [] if f.name == name]
    if platform == this_platform() and installed:
        return Path(str(installed[0].locate())).read_bytes()
    wheel = cached(
        cache_folder() / "wheels" / f"{mujoco_package()}-{mujoco_version()}-{platform}.whl",
        lambda: _download(platform),
    )
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(next(m for m in archive.namelist() if m.endswith(f"/{name}")))


def _download(platform: str) -> bytes:
    """Download MuJoCo's package for another platform, without installing it."""
    with temporary_folder(cache_folder()) as folder:
        package = f"{mujoco_package()}=={mujoco_version()}"
        wheel = ("--platform", PLATFORMS[platform].wheel)
        # For the folder of temporary files see `compile_library`.
        reason = pip("download", package, *wheel, "--dest", str(folder), folder=folder)
        if reason:
            raise CosimError(f"MuJoCo's library for {platform} cannot be downloaded: {reason}")
        return next(folder.glob("*.whl")).read_bytes()


def own_licences() -> dict[str, bytes]:
    """The project's licence and notice, by their names in an FMU."""
    texts = licences("panda-cosim")
    return {"license.txt": texts["LICENSE"], "NOTICE.txt": texts["NOTICE"]}


def licences(package: str) -> dict[str, bytes]:
    """Texts of the licence files that a package was installed with, by names without suffix."""
    files = [file for file in distribution(package).files or [] if "licenses" in file.parts]
    return {file.stem: Path(str(file.locate())).read_bytes() for file in files}
