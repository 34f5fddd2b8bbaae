"""The build backend of the package: setuptools, after the FMUs' libraries have been compiled.

So users of the package need no compiler to build FMUs. If there is none when the package itself is
built, the build requires ziglang, which contains one.
"""

from __future__ import annotations

import shutil
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the other hooks are unchanged

ROOT = Path(__file__).parents[2]


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return the packages needed to build a wheel."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *_compiler()]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Return the packages needed for an editable install."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *_compiler()]


def build_wheel(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Compile, then build the wheel, for this platform only, since it contains libraries."""
    settings = dict(config_settings or {})
    given = settings.get("--build-option", [])
    options = given.split() if isinstance(given, str) else list(given)
    settings["--build-option"] = [*options, f"--plat-name={sysconfig.get_platform()}"]
    return _with_libraries(build_meta.build_wheel, folder, settings, metadata)


def build_editable(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Compile, then make the editable install."""
    return _with_libraries(build_meta.build_editable, folder, config_settings, metadata)


def _compiler() -> list[str]:
    found = any(map(shutil.which, ("cc", "gcc", "clang"))) and sys.platform != "win32"
    return [] if found else ["ziglang>=0.17.1"]


def _with_libraries(build: Callable[..., str], *arguments: Any) -> str:
    sys.path.insert(0, str(ROOT))
    try:
        from fmus.build.libraries import prebuild  # noqa: PLC0415 - from the sources

        for path in prebuild():
            print(f"compiled {path.relative_to(ROOT)}")
    finally:
        sys.path.remove(str(ROOT))
    return build(*arguments)
