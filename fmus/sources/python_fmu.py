"""FMUs that run a slave class in Python: which files go in, which Python runs them, and the FMU.

A host's Python has one table of modules, so an FMU that imported `plant` could get the host's
`plant`, or another FMU's. Each FMU therefore carries its code as one package, whose name contains
a hash of the content.
"""

from __future__ import annotations

import ast
import json
import os
import sys
import sysconfig
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Any, Final

from ...assets import STEP_SIZE
from ..build.identity import digest, package_version
from ..build.libraries import SOURCES
from ..build.native import NativeFmu, Option
from ..errors import CosimError, InputError, one_line, refuse
from ..interface.variables import Interface, Value, Variable
from ..processes import SAFE_PATH, last_line, run

HOST: Final = "python_host.py"  # what the library calls Python through
BASE: Final = "Fmi2Slave"  # PythonFMU's class of slaves
MIN_PYTHON: Final = "3.11"
PYTHONFMU: Final = "pythonfmu"
# As in pyproject.toml.
NEEDS: Final = MappingProxyType({"numpy": "2.3", "mujoco": "3.10", PYTHONFMU: "0.7"})
PATHS_VARIABLE: Final = "PANDA_COSIM_PYTHONPATH"  # see fmus/native/python_host.py
# CPython 3.11 counts the depth of a syntax tree for all threads together: two that parse at once
# can end with a SystemError ("recursion depth mismatch").
_ONE_PARSER: Final = Lock()
_REQUIREMENTS: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
sysconfig.get_config_vars()  # now, since its first call is not thread-safe


def python_fmu(  # noqa: PLR0913 - what differs between our slaves, laws and users' slaves
    interface: Interface,
    law: str,
    code: Mapping[str, bytes],
    slave: tuple[str, str],
    needs: tuple[str, ...],
    *,
    resources: Mapping[str, bytes] | None = None,
    private: bool = False,
    step_size: float = STEP_SIZE,
) -> NativeFmu:
    """Describe the FMU of a slave class."""
    package, files = package_of(interface, code)
    files |= {HOST: (SOURCES / HOST).read_bytes(), **(resources or {})}
    options = [("package", package), ("slave", " ".join(slave))]
    if private:  # the names by which the code's modules, or their packages, are imported
        tops = (path.partition("/")[0] for path in code if path.endswith(".py"))
        options += [("private", top.removesuffix(".py")) for top in dict.fromkeys(tops)]
    options += [("need", f"{name} {NEEDS.get(name, '*')}") for name in needs]
    options.append(("minimum", MIN_PYTHON))
    return NativeFmu(interface, "python", law, files, tuple(options), recorded_python(needs),
                     requirements("own", needs), step_size)  # fmt: skip


def requirements(kind: str, needs: Iterable[str]) -> tuple[str, ...]:
    """What an FMU needs that runs Python, for people: packages with their lowest versions."""
    packages = ", ".join(f"{name} {NEEDS.get(name, '')}".strip() for name in needs)
    words = {"python": MIN_PYTHON, "packages": packages, "variable": PATHS_VARIABLE}
    return tuple(text.format_map(words) for text in _REQUIREMENTS[kind])


def package_of(interface: Interface, code: Mapping[str, bytes]) -> tuple[str, dict[str, bytes]]:
    """Name of the package of an FMU's code, and its files by path."""
    package = f"{interface.model.lower()}_{digest(code)[:12]}"
    packed = {"__init__.py": b'"""The code of one FMU."""\n', **code}
    return package, {f"{package}/{path}": content for path, content in packed.items()}


def require_pythonfmu() -> str:
    """Return the version of PythonFMU, which our slaves derive from; refuse to go on without."""
    if find_spec(PYTHONFMU) is None:
        raise InputError(
            f"the package {PYTHONFMU} is not installed, which FMUs that run Python need: "
            f"`pip install {PYTHONFMU}`"
        )
    return package_version(PYTHONFMU)


# The Python that a host without one starts: this one, at its path on this machine.


@cache
def recorded_python(needs: tuple[str, ...] = ("numpy", "mujoco", PYTHONFMU)) -> tuple[Option, ...]:
    """Options for the Python backend: the path and version of this Python and of packages."""
    library, specs = python_library(), map(find_spec, needs)
    folders = [str(Path(s.origin).parent.parent) for s in specs if s is not None and s.origin]
    return (
        *((("python", str(library)),) if library else ()),
        ("home", sys.base_prefix),
        ("version", ".".join(map(str, sys.version_info[:2]))),
        *(("path", folder) for folder in dict.fromkeys(folders)),
    )


@cache
def python_library() -> Path | None:
    """Path of this Python's shared library; None if it has none."""
    names = ("Py_ENABLE_SHARED", "INSTSONAME", "LIBDIR", "MULTIARCH")
    shared, name, folder, multiarch = map(sysconfig.get_config_var, names)
    if not shared or not name:
        return None
    first = Path(folder or "/usr/lib")
    folders = (first, first / (multiarch or ""), Path(sys.base_prefix) / "lib")
    return next((place / name for place in folders if (place / name).is_file()), None)


# The files that go in.


def code_of(path: Path, root: Path) -> dict[str, bytes]:
    """A module, those below a folder that it imports, and files that they name, by path."""
    code: dict[str, bytes] = {}
    first = path.relative_to(root).as_posix()
    waiting = [first]
    while waiting:
        name = waiting.pop()
        if name not in code and (name == first or (root / name).is_file()):
            tree = parse_file(root / name)
            code[name] = (root / name).read_bytes()
            code |= _data(root, tree)
            for module in _imports(name, tree):
                stem = module.replace(".", "/")
                waiting += [f"{stem}.py", f"{stem}/__init__.py"]
    return code


def _data(root: Path, tree: ast.Module) -> Iterator[tuple[str, bytes]]:
    """Yield the files below a folder that a module names in its texts, with their contents."""
    nodes = ast.walk(tree)
    texts = {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    for name in sorted(map(os.path.normpath, texts)):
        with suppress(OSError, ValueError):  # too long, or no path at all
            if not name.startswith(("/", "..")) and (root / name).is_file():
                yield name, (root / name).read_bytes()


def _imports(path: str, tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module imports and that may be modules beside it."""
    folders = path.split("/")[:-1]
    yield from accumulate(folders, "{}.{}".format)  # its packages
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = folders[: len(folders) - node.level + 1] if node.level else []
            module = ".".join(filter(None, [*package, node.module]))
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
        refuse(f"{path}: class", name, f"the file has {', '.join(classes) or 'none'}", classes)
    return classes[name]


# A user's PythonFMU slave.

# Imports the file, which runs it, and prints the variables of an instance.
_DESCRIBE: Final = """
import importlib, json, sys
module, name, folder = sys.argv[1:]
sys.path.insert(0, folder)
slave_class = getattr(importlib.import_module(module), name)
slave = slave_class(instance_name="fmu", resources=folder, visible=False)
rows = [
    [v.name, type(v).__name__, getattr(v.causality, "name", "local"),
     getattr(v.variability, "name", ""), v.description or "",
     v.getter() if v.getter else getattr(v, "start", None)]
    for v in slave.vars.values()
]
print("\\nSLAVE " + json.dumps([slave.description or "", slave_class.__doc__ or "", rows]))
"""
_CAUSALITIES: Final = ("input", "output", "parameter", "local")


def slave_fmu(path: Path, name: str = "") -> NativeFmu:
    """Describe the FMU of a PythonFMU slave. This runs the slave's file."""
    require_pythonfmu()
    chosen = name or _only_slave(path)
    code = code_of(path, path.parent)
    description, law, rows = _described(path, chosen)
    variables = tuple(_variable(path, row) for row in rows)
    interface = Interface(chosen, one_line(description or law) or chosen, variables)
    slave = (path.stem, chosen)
    return python_fmu(
        interface, law or chosen, code, slave, (PYTHONFMU,), private=True, step_size=0.0
    )


def _only_slave(path: Path) -> str:
    """Name of the class in a file that derives from PythonFMU's; the file is not run."""
    classes = classes_of(path)
    slaves = [name for name, node in classes.items() if is_slave(node)]
    if len(slaves) != 1:
        valid = ", ".join(classes) or "none"
        raise InputError(f"{path}: must have one subclass of {BASE}, or name one of: {valid}")
    return slaves[0]


def _described(path: Path, name: str) -> tuple[str, str, list[list[Any]]]:
    """Description, docstring, and the variables in the order of value references."""
    command = [sys.executable, "-c", _DESCRIBE, path.stem, name, str(path.resolve().parent)]
    child = run(command, environment=os.environ | SAFE_PATH)
    answers = [line for line in child.stdout.splitlines() if line.startswith("SLAVE ")]
    if child.returncode or not answers:
        class_of(path, name)  # which may be mistyped
        reason = one_line(last_line(child.stderr))
        raise CosimError(f"{path}: {name} cannot be instantiated: {reason}")
    description, law, rows = json.loads(answers[-1][6:])
    return description, law, rows


def _variable(path: Path, row: list[Any]) -> Variable:
    name, kind, causality, variability, text, start = row
    if causality not in _CAUSALITIES:
        must = f"must be one of {', '.join(_CAUSALITIES)}"
        refuse(f"{path}: variable {name}: causality", causality, must)
    usual = {"parameter": "fixed"}.get(causality, "continuous" if kind == "Real" else "discrete")
    known: Any = variability or usual
    variable = Variable(name, (), "", causality, known, one_line(text), kind=kind)
    if causality not in ("input", "parameter") and variability != "constant":
        return variable
    convert: type[Value] = {"Boolean": bool, "String": str}.get(kind, float)
    return replace(variable, start=convert(0 if start is None else start))
