"""Compiles the library of a native FMU from `fmus/native`, for this platform or another one."""

from __future__ import annotations

import os
import platform as host
import shutil
import sys
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Final

from ..atomic import cache_folder, temporary_folder
from ..errors import CosimError, InputError
from ..processes import run

SOURCES: Final = Path(__file__).parents[1] / "native"
FMI_LAYER: Final = (
    *("fmi2.c", "fmi3.c", "fmi3_unsupported.c", "instance.c", "values.c", "step.c"),
    *("state.c", "table.c", "resources.c", "log.c"),
)
CONTROLLER_LAW: Final = (
    "controller_law.c", "controller_ik.c", "controller_limits.c", "controller_pid.c",
)  # fmt: skip
STEPPER: Final = "stepper"  # no FMU's library, but the master's
BACKENDS: Final = MappingProxyType({
    "mujoco": ("backend_mujoco.c", "mujoco_sources.c", "mujoco_start.c", "mujoco_fields.c",
               "mujoco_library.c", "library.c"),
    "player": ("backend_player.c",),
    "python": ("backend_python.c", "python_library.c", "library.c"),
    "controller": ("backend_controller.c", *CONTROLLER_LAW, "mujoco_library.c", "library.c"),
    STEPPER: ("stepper.c",),
})  # fmt: skip
FLAGS: Final = (
    *("-std=c11", "-O2", "-g0", "-shared", "-fvisibility=hidden"),
    "-ffp-contract=off",  # a fused multiply-add rounds differently from two operations
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"),
    "-Wno-unused-parameter",  # the standards' functions and the backend's have them
)


@dataclass(frozen=True)
class Platform:
    """A platform that FMUs are built for."""

    target: str  # ziglang's name of it; for Linux with the oldest supported glibc
    suffix: str  # of shared libraries
    fmi2: str  # folder below `binaries` in FMI 2.0
    fmi3: str  # folder below `binaries` in FMI 3.0
    mujoco: str  # name of MuJoCo's library beside the FMU's
    flags: tuple[str, ...]  # for the linker


_LINUX: Final = ("-fPIC", "-s", "-Wl,-z,defs", "-Wl,--build-id=none", "-ldl", "-lm")
# Without an explicit name, a library on macOS is named by the path where it was linked.
_MACOS: Final = ("-fPIC", "-Wl,-undefined,error", "-Wl,-install_name,@rpath/fmu.dylib")
PLATFORMS: Final = MappingProxyType({
    "linux64": Platform("x86_64-linux-gnu.2.17", ".so", "linux64", "x86_64-linux", "libmujoco.so",
                        _LINUX),
    "linux-arm64": Platform("aarch64-linux-gnu.2.17", ".so", "aarch64-linux", "aarch64-linux",
                            "libmujoco.so", _LINUX),
    "win64": Platform("x86_64-windows-gnu", ".dll", "win64", "x86_64-windows", "mujoco.dll",
                      ("-s",)),
    "darwin64": Platform("x86_64-macos.11.0", ".dylib", "darwin64", "x86_64-darwin",
                         "libmujoco.dylib", _MACOS),
    "darwin-arm64": Platform("aarch64-macos.11.0", ".dylib", "aarch64-darwin", "aarch64-darwin",
                             "libmujoco.dylib", _MACOS),
})  # fmt: skip
_HERE: Final = MappingProxyType({
    ("Linux", "x86_64"): "linux64", ("Linux", "aarch64"): "linux-arm64",
    ("Windows", "AMD64"): "win64", ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin-arm64",
})  # fmt: skip


def this_platform() -> str:
    """Key in `PLATFORMS` of this machine."""
    key = (host.system(), host.machine())
    if key not in _HERE:
        raise CosimError(f"cannot build FMUs for {' '.join(key)}; known: {', '.join(PLATFORMS)}")
    return _HERE[key]


def compile_library(
    backend: str | Path, platform: str | None = None, extra_flags: tuple[str, ...] = ()
) -> bytes:
    """Compile the FMI layer and one backend, or the master's stepper."""
    name = platform or this_platform()
    with temporary_folder(cache_folder()) as folder:
        library = folder / f"fmu{PLATFORMS[name].suffix}"
        command = [
            *_compiler(name),
            *FLAGS,
            *("-I.", *(f"-isystem{include}" for include in includes())),
            *extra_flags,
            *(FMI_LAYER if backend != STEPPER else ()),
            *(BACKENDS[backend] if isinstance(backend, str) else (str(backend),)),
            *PLATFORMS[name].flags,
            *("-o", str(library)),
        ]
        # In the folder of the sources, so that no path gets into the library. The compiler's
        # temporary files go with the folder, also if it is killed.
        done = run(command, SOURCES, os.environ | {"TMPDIR": str(folder)})
        if done.returncode:
            raise CosimError(f"the FMU's library cannot be compiled:\n{done.stderr.strip()}")
        return library.read_bytes()


def can_compile(platform: str) -> bool:
    """Whether there is a compiler for a platform."""
    try:
        _compiler(platform)
    except InputError:
        return False
    return True


@cache
def _compiler(platform: str) -> tuple[str, ...]:
    """The system's compiler for this machine, or ziglang's for others or if there is none."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if platform == this_platform() and compiler and sys.platform != "win32":
        return (compiler,)
    if find_spec("ziglang") is None:
        raise InputError(
            f"platform {platform}: no C compiler; install `panda-cosim[cross]`, or, for this "
            f"machine, a compiler named cc, gcc or clang"
        )
    return (sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[platform].target)


@cache
def includes() -> tuple[Path, ...]:
    """Folders of the FMI standard's headers, which FMPy brings, and of MuJoCo's."""
    folders = []
    for package, place in (("fmpy", "c-code"), ("mujoco", "include")):
        spec = find_spec(package)
        if spec is None or not spec.origin:
            raise CosimError(f"the package {package} is missing")
        folders.append(Path(spec.origin).parent / place)
    return tuple(folders)
