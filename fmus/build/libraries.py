"""The shared libraries in a native FMU: its own, compiled from `fmus/native`, and MuJoCo's.

Each is for this platform or another one. Another version of MuJoCo is a folder in the cache that a
process of its own imports. The project runs with any of them, so an FMU with another engine is the
one that the project makes where that version is installed: its models are compiled by that
version, byte for byte.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform as host
import re
import shutil
import sys
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Final

from ..atomic import cache_folder, cached, in_cache, temporary_folder
from ..errors import CosimError, InputError, excerpt
from ..processes import SAFE_PATH, run

SOURCES: Final = Path(__file__).parents[1] / "native"
FMI_LAYER: Final = (
    *("fmi2.c", "fmi3.c", "fmi3_unsupported.c", "instance.c", "values.c", "step.c"),
    *("state.c", "table.c", "resources.c", "log.c"),
)
CONTROLLER_LAW: Final = (
    "controller.c", "controller_law.c", "controller_ik.c", "controller_limits.c",
    "controller_pid.c", "controller_touch.c", "controller_impedance.c",
)  # fmt: skip
STEPPER: Final = "stepper"  # no FMU's library, but the master's
BACKENDS: Final = MappingProxyType({
    "mujoco": ("backend_mujoco.c", "mujoco_sources.c", "mujoco_start.c", "mujoco_fields.c",
               "mujoco_library.c", "library.c"),
    "player": ("backend_player.c", "player_guard.c"),
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
                 ("-fPIC", "-Wl,-undefined,error",
                  "-Wl,-install_name,@rpath/fmu.dylib"))  # fmt: skip
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


def compile_library(backend: str | Path, platform: str | None = None) -> bytes:
    """Compile the FMI layer and one backend, or the master's stepper."""
    name = platform or this_platform()
    with temporary_folder(cache_folder()) as folder:
        compiled = folder / f"fmu{PLATFORMS[name].suffix}"
        command = [
            *_compiler(name),
            *FLAGS,
            *("-I.", *(f"-isystem{include}" for include in includes())),
            *(FMI_LAYER if backend != STEPPER else ()),
            *(BACKENDS[backend] if isinstance(backend, str) else (str(backend),)),
            *PLATFORMS[name].flags,
            *("-o", str(compiled)),
        ]
        # In the folder of the sources, so that no path gets into the library. The compiler's
        # temporary files go with the folder, also if it is killed.
        done = run(command, SOURCES, os.environ | {"TMPDIR": str(folder)})
        if done.returncode:
            raise CosimError(f"the FMU's library cannot be compiled:\n{done.stderr.strip()}")
        return compiled.read_bytes()


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
    places = {"fmpy": "c-code", "mujoco": "include"}
    return tuple(
        Path(str(distribution(package).locate_file(f"{package}/{place}")))
        for package, place in places.items()
    )


# From the package, the cache, or another package.


@cache
def package_version(name: str) -> str:
    """Version of a package; `metadata.version` would parse all of its description."""
    package = distribution(name)
    text = package.read_text("METADATA") or ""
    return text.partition("\nVersion: ")[2].partition("\n")[0] or package.version


NEED_MUJOCO: Final = ("mujoco", "controller")  # backends that open MuJoCo's library
PREBUILT: Final = SOURCES / "lib"  # libraries that came with the package
# The package that holds MuJoCo's library and headers.
MUJOCO: Final = "mujoco-core" if int(package_version("mujoco").split(".")[0]) >= 4 else "mujoco"
# What no FMU depends on, as the contracts on imports have it above: all else is hashed.
ABOVE: Final = ("cli", "study", "run", "show", "result", "task", "fmus/master")
_MADE: Final = (".pyc", ".bin")  # made from what is hashed
_NOT_OURS: Final = ("__pycache__", "node_modules")  # folders


def digest(*parts: str | bytes | Mapping[str, bytes]) -> str:
    """Hash of texts, contents, and files by name."""
    content = hashlib.sha256()
    for part in parts:
        for name, data in sorted(part.items()) if isinstance(part, Mapping) else [("", part)]:
            raw = data.encode() if isinstance(data, str) else data
            content.update(f"{name}\0{len(raw)}\0".encode() + raw)
    return content.hexdigest()


@cache
def code_digest(above: tuple[str, ...] = ABOVE) -> str:
    """Hash of all code and data of the package, but of folders above, and of versions."""
    root = SOURCES.parents[1]
    code = {}
    for package in root.glob("*/__init__.py"):
        left = [package.parent.name]
        while left:
            place = left.pop()
            if place in above:
                continue
            for entry in os.scandir(root / place):
                if entry.is_dir():
                    left += [f"{place}/{entry.name}"] * (entry.name not in _NOT_OURS)
                elif not entry.name.endswith(_MADE):
                    code[f"{place}/{entry.name}"] = Path(entry.path).read_bytes()
    return digest(code, package_version("panda-cosim"), mujoco_version())


@cache
def library_name(backend: str, platform: str) -> str:
    """File name of a compiled library, with a hash of its sources, and of MuJoCo's version."""
    files = {*BACKENDS[backend], *(path.name for path in SOURCES.glob("*.h"))}
    files |= set(FMI_LAYER) if backend != STEPPER else set()
    sources = {name: (SOURCES / name).read_bytes() for name in files}
    flags = Path(__file__).read_bytes()
    content = digest(sources, flags, mujoco_version() if backend in NEED_MUJOCO else "")
    return f"{backend}-{platform}-{content[:16]}.bin"


def library(backend: str, platform: str) -> Path:
    """A library that came with the package, or that is compiled and kept in the cache."""
    name = library_name(backend, platform)
    if (PREBUILT / name).is_file():
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


def mujoco_version() -> str:
    """Version of MuJoCo's package."""
    return package_version(MUJOCO)


def mujoco_library(platform: str) -> bytes:
    """MuJoCo's library for a platform; for another than this one, from its package there."""
    name = PLATFORMS[platform].in_wheel.format(mujoco_version())
    installed = [f for f in distribution(MUJOCO).files or [] if f.name == name]
    if platform == this_platform() and installed:
        return Path(str(installed[0].locate())).read_bytes()
    wheel = cached(
        cache_folder() / "wheels" / f"{MUJOCO}-{mujoco_version()}-{platform}.whl",
        lambda: _download(platform),
    )
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(next(m for m in archive.namelist() if m.endswith(f"/{name}")))


def _download(platform: str) -> bytes:
    """Download MuJoCo's package for another platform, without installing it."""
    with temporary_folder(cache_folder()) as folder:
        command = [
            *(sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"),
            *("--dest", str(folder)),
            *("--only-binary", ":all:", "--platform", PLATFORMS[platform].wheel),
            f"{MUJOCO}=={mujoco_version()}",
        ]
        # For TMPDIR see `compile_library`.
        done = run(command, environment=os.environ | {"TMPDIR": str(folder)})
        wheels = list(folder.glob("*.whl"))
        if done.returncode or not wheels:
            reason = last_line(done.stderr)
            raise CosimError(f"MuJoCo's library for {platform} cannot be downloaded: {reason}")
        return wheels[0].read_bytes()


def own_licences() -> dict[str, bytes]:
    """The project's licence and notice, by their names in an FMU."""
    names = {"license.txt": "LICENSE", "NOTICE.txt": "NOTICE"}
    checkout = SOURCES.resolve().parents[1]  # behind the link of a clone
    if (checkout / "LICENSE").is_file():
        return {member: (checkout / name).read_bytes() for member, name in names.items()}
    return {member: licence("panda-cosim", name) for member, name in names.items()}


def licence(package: str, name: str) -> bytes:
    """Text of a licence file that a package was installed with."""
    files = distribution(package).files or []
    file = next(file for file in files if file.name == name and "dist-info" in str(file))
    return Path(str(file.locate())).read_bytes()


_VERSION: Final = re.compile(r"(3\.[1-9]\d|[4-9]\.\d\d?)\.\d\d?", re.A)
_CHILD: Final = """
import pickle, sys
from pathlib import Path
import mujoco
from panda_cosim.fmus.errors import CosimError
call, answer, version = sys.argv[1:]
assert mujoco.__version__ == version, mujoco.__file__
try:
    Path(answer).write_bytes(pickle.loads(Path(call).read_bytes())())
except CosimError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
"""


def check_engine(version: object) -> str:
    """Return a version of MuJoCo that FMUs can hold; "" is the installed one."""
    if version != "" and not (isinstance(version, str) and _VERSION.fullmatch(version)):
        raise InputError(f"mujoco: value {excerpt(version)}; must be a version from 3.10.0 on")
    return str(version)


def made_with(version: str, make: Callable[[], bytes]) -> bytes:
    """Call a function that can be pickled where this version of MuJoCo is imported."""
    if version == mujoco_version():
        return make()
    paths = [str(_installed(version)), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, **SAFE_PATH, "PYTHONPATH": os.pathsep.join(paths)}
    with temporary_folder(cache_folder()) as folder:
        call, answer = folder / "call", folder / "answer"
        call.write_bytes(pickle.dumps(make))
        command = [sys.executable, "-c", _CHILD, str(call), str(answer), version]
        done = run(command, environment=environment)
        if done.returncode:
            kind = InputError if done.returncode == InputError.exit_code else CosimError
            raise kind(f"with MuJoCo {version}: {last_line(done.stderr)}")
        return answer.read_bytes()


def has_engine(version: str) -> bool:
    """Whether a version of MuJoCo is here, so that nothing has to be downloaded."""
    return version in ("", mujoco_version()) or _engine(version).is_dir()


def _engine(version: str) -> Path:
    return cache_folder() / "engines" / f"{version}-{sys.implementation.cache_tag}"


def _installed(version: str) -> Path:
    """Return the folder of a version, downloaded if it is missing."""
    folder = _engine(version)
    packages = ["mujoco"] if version.startswith("3.") else ["mujoco", "mujoco-core"]
    if not folder.is_dir():
        with in_cache(folder) as partial:
            pip = (sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
            options = ("--no-deps", "--only-binary", ":all:", "--retries", "1", "--target")
            done = run([*pip, *options, str(partial), *(f"{p}=={version}" for p in packages)])
            if done.returncode:
                raise CosimError(f"MuJoCo {version} cannot be installed: {last_line(done.stderr)}")
            with suppress(OSError):  # another process was first
                partial.rename(folder)
    return folder


def last_line(text: str) -> str:
    """Return what a program that failed has said last."""
    return (text.strip().splitlines() or ["no reason is known"])[-1]
