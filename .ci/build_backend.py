"""The build backend of the package: setuptools, after the FMUs' libraries have been compiled.

So users of a wheel need no compiler to build FMUs. A clone's editable install leaves them to their
first use, without a second install of FMPy and MuJoCo for the build alone; unless there is no
compiler, since only a build can require ziglang, which contains one.
"""

from __future__ import annotations

import compileall
import shutil
import sys
import sysconfig
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the other hooks are unchanged

ROOT = Path(__file__).parents[1]
# The packages whose headers the libraries are compiled with. A wheel holds those for the newest
# MuJoCo; for another one that is installed, they are compiled when they are first used.
HEADERS = ["fmpy>=0.3.32", "mujoco>=3.10.0"]

LINKED = ("assets", "plant", "controller", "fmus", "scenarios")


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return the packages needed to build a wheel."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *HEADERS, *_compiler()]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Return the packages needed for an editable install."""
    needed = [*HEADERS, *_compiler()] if _compiler() else []
    return [*build_meta.get_requires_for_build_editable(config_settings), *needed]


def build_wheel(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Compile, then build the wheel, for this platform only, since it contains libraries."""
    settings = dict(config_settings or {})
    given = settings.get("--build-option", [])
    options = given.split() if isinstance(given, str) else list(given)
    settings["--build-option"] = [*options, f"--plat-name={sysconfig.get_platform()}"]
    _check_links()
    _compile()
    return str(build_meta.build_wheel(folder, settings, metadata))


def build_editable(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Make the editable install; where there is no compiler, compile before."""
    if _compiler():
        _compile()
    _check_links()
    for package in (*(ROOT / name for name in LINKED), ROOT / "src"):  # links are not followed
        # As pip does with a wheel's modules, also where Python is told to keep no byte code.
        compileall.compile_dir(package, quiet=2)
    return str(build_meta.build_editable(folder, config_settings, metadata))


def build_sdist(folder: str, config_settings: Any = None) -> str:
    """Pack the sources, with folders in place of the links."""
    _check_links()
    return str(build_meta.build_sdist(folder, config_settings))


def _check_links() -> None:
    """Refuse a checkout whose links are text, before what is built lacks half of the package."""
    bad = [name for name in LINKED if not (ROOT / "src" / "panda_cosim" / name).is_dir()]
    if bad:
        raise SystemExit(
            f"src/panda_cosim/{bad[0]} must be a symbolic link to {bad[0]}/, and is none: this "
            "checkout was made without links. On Windows, switch developer mode on; then "
            "`git config core.symlinks true` and `git checkout -- src`. "
            "A zip of the repository needs a program that unpacks links."
        )


def _compiler() -> list[str]:
    """Return the package that contains a compiler, if this machine has none."""
    found = any(map(shutil.which, ("cc", "gcc", "clang"))) and sys.platform != "win32"
    return [] if found else ["ziglang>=0.17.1"]


def _compile() -> None:
    sys.path.insert(0, str(ROOT / "src" / "panda_cosim"))
    try:
        from fmus.build.libraries import prebuild  # noqa: PLC0415 - from the sources

        for path in prebuild():
            print(f"compiled {path.relative_to(ROOT)}")
    finally:
        sys.path.remove(str(ROOT / "src" / "panda_cosim"))
