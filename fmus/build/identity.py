"""What an FMU depends on: code, data and versions, as a digest."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from typing import Final

from ..errors import CosimError
from ..twins import ROOT

# What no FMU depends on, as the contracts on imports have it above: all else is hashed.
ABOVE: Final = ("cli", "study", "run", "result", "task", "fmus/master")
_MADE: Final = (".pyc", ".bin")  # made from what is hashed
_NOT_OURS: Final = ("__pycache__", "node_modules")  # folders


@cache
def package_version(name: str) -> str:
    """Version of a package; `metadata.version` would parse all of its description."""
    package = distribution(name)
    text = package.read_text("METADATA") or ""
    return text.partition("\nVersion: ")[2].partition("\n")[0] or package.version


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
    code = {}
    for package in ROOT.glob("*/__init__.py"):
        for folder, inner, files in os.walk(package.parent):
            place = Path(folder).relative_to(ROOT).as_posix()
            inner[:] = [name for name in inner if name not in _NOT_OURS and place not in above]
            for name in () if place in above else files:
                if not name.endswith(_MADE):
                    code[f"{place}/{name}"] = Path(folder, name).read_bytes()
    return digest(code, package_version("panda-cosim"), mujoco_version())


def mujoco_package() -> str:
    """Name of the package that holds MuJoCo's library and headers."""
    return "mujoco-core" if int(package_version("mujoco").split(".")[0]) >= 4 else "mujoco"


def mujoco_version() -> str:
    """Version of that package, which compiles models and steps them."""
    package, mujoco = mujoco_package(), package_version("mujoco")
    version = package_version(package)
    if version != mujoco:
        raise CosimError(
            f"mujoco {mujoco} and {package} {version}: must be one version, which compiles models "
            f"and steps them; pip install 'mujoco=={mujoco}' '{package}=={mujoco}'"
        )
    return version
