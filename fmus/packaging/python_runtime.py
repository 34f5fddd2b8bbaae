"""The Python that an FMU in Python runs in: its requirements, and the one recorded in the FMU."""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Final

from .table import Option

MIN_PYTHON: Final = (3, 11)
NEEDS: Final = MappingProxyType({"numpy": (2, 3), "mujoco": (4, 0)})  # as in pyproject.toml
PATHS_VARIABLE: Final = "PANDA_COSIM_PYTHONPATH"  # see fmus/native/python_host.py
RECORDED: Final = ("python", "home", "version", "path")  # options that depend on this machine
_sysconfig: Final = Lock()  # sysconfig's first call is not thread-safe


def python_options(needs: Iterable[str] = ()) -> tuple[Option, ...]:
    """Options of the Python backend: required packages, and the Python for hosts without one.

    Args:
        needs: Names of packages that the FMU imports; for their minimum versions see `NEEDS`.
    """
    names = tuple(needs)
    lowest = {name: ".".join(map(str, NEEDS[name])) if name in NEEDS else "*" for name in names}
    library = python_library()
    return (
        *(("need", f"{name} {lowest[name]}") for name in names),
        ("minimum", ".".join(map(str, MIN_PYTHON))),
        *((("python", str(library)),) if library else ()),
        ("home", sys.base_prefix),
        ("version", ".".join(map(str, sys.version_info[:2]))),
        *(("path", folder) for folder in package_folders(names)),
    )


@cache
def python_library() -> Path | None:
    """Path of this Python's shared library; None if it has none."""
    if sys.platform == "win32":
        library = Path(sys.base_prefix, "python{}{}.dll".format(*sys.version_info[:2]))
        return library if library.is_file() else None
    with _sysconfig:
        names = ("Py_ENABLE_SHARED", "INSTSONAME", "LIBDIR", "MULTIARCH")
        shared, name, folder, multiarch = map(sysconfig.get_config_var, names)
    if not shared or not name:
        return None
    first = Path(folder or "/usr/lib")
    folders = (first, first / (multiarch or ""), Path(sys.base_prefix) / "lib")
    return next((place / name for place in folders if (place / name).is_file()), None)


@cache
def package_folders(names: tuple[str, ...] = ("numpy", "mujoco")) -> tuple[str, ...]:
    """Folders that hold packages, each once."""
    specs = (find_spec(name) for name in names)
    folders = [str(Path(s.origin).parent.parent) for s in specs if s is not None and s.origin]
    return tuple(dict.fromkeys(folders))
