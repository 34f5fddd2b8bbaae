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

    host: tuple[str, str]  # Python's names of system and machine
    target: str  # ziglang's name of it; for Linux with the oldest supported glibc
    fmi2: str  # folder below `binaries` in FMI 2.0
    fmi3: str  # folder below `binaries` in FMI 3.0
    wheel: str  # pip's name of it for MuJoCo's package
    suffix: str  # of shared libraries
    mujoco: str  # name of MuJoCo's library beside the FMU's
    in_wheel: str  # name of MuJoCo's library in its package, by version
    flags: tuple[str, ...]  # for the linker


_LINUX: Final = (".so", "libmujoco.so", "libmujoco.so.{}",
                 ("-fPIC", "-s", "-Wl,-z,defs", "-Wl,--build-id=none", "-ldl", "-lm"))  # fmt: skip
_WINDOWS: Final = (".dll", "mujoco.dll", "mujoco.dll", ("-s",))
# Without an explicit name, a library on macOS is named by the path where it was linked.
_MACOS: Final = (".dylib", "libmujoco.dylib", "libmujoco.{}.dylib",
                 ("-fPIC", "-Wl,-undefined,error", "-Wl,-install_name,@rpath/fmu.dylib"))  # fmt: skip
PLATFORMS: Final = MappingProxyType({
    "linux64": Platform(("Linux", "x86_64"), "x86_64-linux-gnu.2.17", "linux64", "x86_64-linux",
                        "manylinux_2_28_x86_64", *_LINUX),
    "linux-arm64": Platform(("Linux", "aarch64"), "aarch64-linux-gnu.2.17", "aarch64-linux",
                            "aarch64-linux", "manylinux_2_28_aarch64", *_LINUX),
    "win64": Platform(("Windows", "AMD64"), "x86_64-windows-gnu", "win64", "x86_64-windows",
                      "win_amd64", *_WINDOWS),
    # MuJoCo's library is a universal one.
    "darwin64": Platform(("Darwin", "x86_64"), "x86_64-macos.11.0", "darwin64", "x86_64-darwin",
                         "macosx_11_0_arm64", *_MACOS),
    "darwin-arm64": Platform(("Darwin", "arm64"), "aarch64-macos.11.0", "aarch64-darwin",
                             "aarch64-darwin", "macosx_11_0_arm64", *_MACOS),
})  # fmt: skip


def this_platform() -> str:
    """Key in `PLATFORMS` of this machine."""
    here = (host.system(), host.machine())
    for name, platform in PLATFORMS.items():
        if platform.host == here:
            return name
    raise CosimError(f"cannot build FMUs for {' '.join(here)}; known: {', '.join(PLATFORMS)}")


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
