"""FMUs that run a slave class in Python: which files go in, which Python runs them, and the FMU.

A host's Python has one table of modules, so an FMU that imported `plant` could get the host's
`plant`, or another FMU's. Each FMU therefore carries its code as one package, whose name contains
a hash of the content.
"""

from __future__ import annotations

import ast
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Final

from ..build.compile import SOURCES
from ..build.libraries import digest
from ..build.native import NativeFmu, Option
from ..errors import InputError
from ..inside.base import TICK
from ..interface.variables import Interface
from ..messages import did_you_mean, one_line

HOST: Final = "python_host.py"  # what the library calls Python through
BASE: Final = "Fmi2Slave"  # PythonFMU's class of slaves
MIN_PYTHON: Final = (3, 11)
NEEDS: Final = MappingProxyType({"numpy": (2, 3), "mujoco": (4, 0)})  # as in pyproject.toml
PATHS_VARIABLE: Final = "PANDA_COSIM_PYTHONPATH"  # see fmus/native/python_host.py
# CPython 3.11 counts the depth of a syntax tree for all threads together: two that parse at once
# can end with a SystemError ("recursion depth mismatch").
_ONE_PARSER: Final = Lock()
_sysconfig: Final = Lock()  # sysconfig's first call is not thread-safe


def python_fmu(  # noqa: PLR0913 - what differs between our slaves, laws and users' slaves
    interface: Interface,
    law: str,
    code: Mapping[str, bytes],
    slave: tuple[str, str],
    needs: tuple[str, ...],
    *,
    resources: Mapping[str, bytes] | None = None,
    private: bool = False,
    step_size: float = TICK,
) -> NativeFmu:
    """Describe the FMU of a slave class."""
    package = f"{interface.model.lower()}_{digest(code)[:12]}"
    packed = {"__init__.py": b'"""The code of one FMU."""\n', **code}
    files = {HOST: (SOURCES / HOST).read_bytes()}
    files |= {f"{package}/{path}": content for path, content in packed.items()}
    options = [("package", package), ("slave", " ".join(slave))]
    if private:
        options += [("private", name) for name in dict.fromkeys(map(_top, code))]
    lowest = {name: ".".join(map(str, NEEDS[name])) for name in needs if name in NEEDS}
    options += [("need", f"{name} {lowest.get(name, '*')}") for name in needs]
    options.append(("minimum", ".".join(map(str, MIN_PYTHON))))
    return NativeFmu(
        interface,
        "python",
        law,
        files | dict(resources or {}),
        tuple(options),
        recorded_python(needs),
        _requirements([f"{name} {lowest.get(name, '')}".strip() for name in needs]),
        step_size,
    )


def _top(path: str) -> str:
    """Name by which the code's module at a path is imported, or that of its outermost package."""
    return path.partition("/")[0].removesuffix(".py")


def _requirements(packages: list[str]) -> tuple[str, ...]:
    """Requirements of an FMU in Python, one paragraph each."""
    python = ".".join(map(str, MIN_PYTHON))
    return (
        f"The FMU runs Python inside the importer's process: Python {python} or newer"
        + (f", with {', '.join(packages)} or newer." if packages else "."),
        "In a Python importer, its own packages are used. In any other, the Python that built the "
        "FMU is started; resources/variables.txt records its path.",
        f"Other packages are found through the environment variable {PATHS_VARIABLE}: the folder "
        "that holds them, for the same Python version.",
    )


# The Python that a host without one starts: this one, at its path on this machine.


def recorded_python(needs: Iterable[str] = ("numpy", "mujoco")) -> tuple[Option, ...]:
    """Options for the Python backend: the path and version of this Python and of packages."""
    library = python_library()
    return (
        *((("python", str(library)),) if library else ()),
        ("home", sys.base_prefix),
        ("version", ".".join(map(str, sys.version_info[:2]))),
        *(("path", folder) for folder in _package_folders(tuple(needs))),
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
def _package_folders(names: tuple[str, ...]) -> tuple[str, ...]:
    """Folders that hold packages, each once."""
    specs = (find_spec(name) for name in names)
    folders = [str(Path(s.origin).parent.parent) for s in specs if s is not None and s.origin]
    return tuple(dict.fromkeys(folders))


# The files that go in.


def code_of(path: Path, root: Path) -> dict[str, bytes]:
    """A module and those below a folder that it imports, directly or not: contents by path."""
    code: dict[str, bytes] = {}
    first = path.relative_to(root).as_posix()
    waiting = [first]
    while waiting:
        name = waiting.pop()
        if name not in code and (name == first or (root / name).is_file()):
            imports = _imports(name, parse_file(root / name))
            code[name] = (root / name).read_bytes()
            for module in imports:
                stem = module.replace(".", "/")
                waiting += [f"{stem}.py", f"{stem}/__init__.py"]
    return code


def _imports(path: str, tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module imports and that may be modules beside it."""
    folders = path.split("/")[:-1]
    yield from (".".join(folders[: i + 1]) for i in range(len(folders)))  # its packages
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = folders[: len(folders) - node.level + 1] if node.level else []
            module = ".".join([*package, *([node.module] if node.module else [])])
            yield module  # a name that is imported from a package may be a module, too
            yield from (f"{module}.{alias.name}" for alias in node.names)


def parse_file(path: Path) -> ast.Module:
    """Parse a Python file, without running it; safe in several threads."""
    try:
        with _ONE_PARSER:
            return ast.parse(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{path}: not valid Python: {one_line(error)}") from error


def is_slave(node: ast.ClassDef) -> bool:
    """Whether a class derives from PythonFMU's class of slaves."""
    return any(ast.unparse(base).split(".")[-1] == BASE for base in node.bases)


def classes_of(path: Path) -> dict[str, ast.ClassDef]:
    """The classes of a file by name; the file is not run."""
    return {node.name: node for node in parse_file(path).body if isinstance(node, ast.ClassDef)}


def class_of(path: Path, name: str) -> ast.ClassDef:
    """Return a class of a file."""
    classes = classes_of(path)
    if name not in classes:
        valid = ", ".join(classes) or "none"
        near = did_you_mean(name, classes)
        raise InputError(f"{path}: no class {name!r}; classes there: {valid}{near}")
    return classes[name]
