"""The shared libraries in a native FMU: its own, and MuJoCo's for its platform."""

from __future__ import annotations

import hashlib
import os
import sys
import zipfile
from collections.abc import Mapping
from functools import cache, partial
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Final

from ..atomic import cache_folder, cached, temporary_folder
from ..errors import CosimError
from ..processes import run
from .compile import (
    BACKENDS, FMI_LAYER, PLATFORMS, SOURCES, STEPPER, compile_library, this_platform,
)

NEED_MUJOCO: Final = ("mujoco", "controller")  # backends that open MuJoCo's library
PREBUILT: Final = SOURCES / "lib"  # libraries that came with the package
MUJOCO: Final = "mujoco-core"  # the package that holds MuJoCo's library and headers
# Folders whose code FMUs contain or are described by.
_CODE: Final = ("assets", "controller", "plant", "fmus/interface", "fmus/native", "fmus/build",
                "fmus/inside")  # fmt: skip


def digest(*parts: str | bytes | Mapping[str, bytes]) -> str:
    """Hash of texts, contents, and files by name."""
    content = hashlib.sha256()
    for part in parts:
        for name, data in sorted(part.items()) if isinstance(part, Mapping) else [("", part)]:
            raw = data.encode() if isinstance(data, str) else data
            content.update(f"{name}\0{len(raw)}\0".encode() + raw)
    return content.hexdigest()


@cache
def code_digest() -> str:
    """Hash of all code that FMUs depend on, and of the versions of the packages used."""
    root = SOURCES.parents[1]
    paths = [path for folder in _CODE for path in (root / folder).rglob("*.*")]
    kinds = (".py", ".c", ".h", ".j2", ".png", ".xml")
    code = {p.relative_to(root).as_posix(): p.read_bytes() for p in paths if p.suffix in kinds}
    return digest(code, version("panda-cosim"), mujoco_version())


@cache
def library_name(backend: str, platform: str) -> str:
    """File name of a compiled library, with a hash of its sources, and of MuJoCo's version."""
    files = {*BACKENDS[backend], *(path.name for path in SOURCES.glob("*.h"))}
    files |= set(FMI_LAYER) if backend != STEPPER else set()
    sources = {name: (SOURCES / name).read_bytes() for name in files}
    flags = Path(__file__).with_name("compile.py").read_bytes()
    content = digest(sources, flags, mujoco_version() if backend in NEED_MUJOCO else "")
    return f"{backend}-{platform}-{content[:16]}.bin"


def fmu_library(backend: str, platform: str) -> bytes:
    """Library of an FMU: one that came with the package, or compiled and kept in the cache."""
    name = library_name(backend, platform)
    if (PREBUILT / name).is_file():
        return (PREBUILT / name).read_bytes()
    return cached(
        cache_folder() / "libraries" / name, lambda: compile_library(backend, platform)
    ).read_bytes()


def stepper_path() -> Path:
    """The library of the master's step, see `fmus/master/kernel.py`."""
    name = library_name(STEPPER, this_platform())
    if (PREBUILT / name).is_file():
        return PREBUILT / name
    content = partial(compile_library, STEPPER)
    return cached(cache_folder() / "libraries" / name, content)


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


@cache
def mujoco_version() -> str:
    """Version of MuJoCo's package."""
    return version(MUJOCO)


def mujoco_library(platform: str) -> bytes:
    """MuJoCo's library for a platform; for another than this one, from its package there."""
    name = PLATFORMS[platform].in_wheel.format(mujoco_version())
    if platform == this_platform():
        installed = [f for f in distribution(MUJOCO).files or [] if f.name == name]
        if installed:
            return Path(str(installed[0].locate())).read_bytes()
    wheel = cached(
        cache_folder() / "wheels" / f"{MUJOCO}-{mujoco_version()}-{platform}.whl",
        lambda: _download(platform),
    )
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.namelist():
            if member.rpartition("/")[2] == name:
                return archive.read(member)
    raise CosimError(f"{wheel}: {name} is missing in MuJoCo's package")


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
            lines = done.stderr.strip().splitlines() or ["pip failed"]
            raise CosimError(f"MuJoCo's library for {platform} cannot be downloaded: {lines[-1]}")
        return wheels[0].read_bytes()


def own_licences() -> dict[str, bytes]:
    """The project's licence and notice, by their names in an FMU."""
    names = {"license.txt": "LICENSE", "NOTICE.txt": "NOTICE"}
    checkout = SOURCES.parents[1]
    if (checkout / "LICENSE").is_file():
        return {member: (checkout / name).read_bytes() for member, name in names.items()}
    return {member: licence("panda-cosim", name) for member, name in names.items()}


def licence(package: str, name: str) -> bytes:
    """Text of a licence file that a package was installed with."""
    files = distribution(package).files or []
    file = next(file for file in files if file.name == name and "dist-info" in str(file))
    return Path(str(file.locate())).read_bytes()
