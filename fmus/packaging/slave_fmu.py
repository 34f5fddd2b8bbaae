"""Makes an FMU on our own library from a user's PythonFMU slave."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, cast

from ..atomic import check_replaceable
from ..errors import CosimError, InputError
from ..interface.variables import Causality, Interface, Kind, Value, Variability, Variable
from ..messages import did_you_mean, one_line
from ..processes import SAFE_PATH, run
from .build import write_one
from .bundle import packed
from .native import NativeFmu
from .python_fmu import HOST, host
from .python_runtime import python_options
from .python_source import parse_file

# Imports the file, which runs it, and prints the variables of an instance.
_DESCRIBE: Final = """
import importlib.util, json, sys
path, name, folder = sys.argv[1:]
sys.path.insert(0, folder)
spec = importlib.util.spec_from_file_location(path.rpartition("/")[2].removesuffix(".py"), path)
module = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = module
spec.loader.exec_module(module)
slave = getattr(module, name)(instance_name="fmu", resources=folder, visible=False)
def word(value, otherwise):
    return value.name if value is not None else otherwise
def start(v):
    return v.getter() if v.getter is not None else getattr(v, "start", None)
rows = [
    [v.name, type(v).__name__, word(v.causality, "local"), word(v.variability, ""),
     v.description or "", start(v)]
    for v in slave.vars.values()
]
print("\\nSLAVE " + json.dumps([slave.description or "", type(slave).__doc__ or "", rows]))
"""
_KINDS: Final = ("Real", "Integer", "Boolean", "String")
_CAUSALITIES: Final = ("input", "output", "parameter", "local")
_BASE: Final = "Fmi2Slave"


def slave_fmu(path: Path, name: str = "", files: Sequence[Path] | None = None) -> NativeFmu:
    """Describe the FMU of a PythonFMU slave. This runs the slave's file.

    Args:
        path: Python file with the slave's class.
        name: Name of the class, and of the model; "": the only class that derives from
            `pythonfmu.Fmi2Slave`.
        files: Python files in its folder that it imports; None: all of them.

    Raises:
        InputError: The file cannot be read, has no such class, or has variables that an FMU
            cannot have.
        CosimError: The class cannot be instantiated.
    """
    chosen = name or _only_slave(path)
    sources = _sources(path, path.parent.glob("*.py") if files is None else files)
    description, law, rows = _described(path, chosen)
    variables = tuple(_variable(path, row) for row in rows)
    interface = Interface(chosen, one_line(description or law) or chosen, variables)
    content = hashlib.sha256(b"".join(n.encode() + b"\0" + s for n, s in sorted(sources.items())))
    package = f"{chosen.lower()}_{content.hexdigest()[:12]}"
    resources = {HOST: host(), **packed(package, sources)}
    options = [("package", package), ("slave", f"{path.stem} {chosen}")]
    options += [("private", file.removesuffix(".py")) for file in sources]
    return NativeFmu(
        interface,
        "python",
        law or chosen,
        resources,
        (*options, *python_options(("pythonfmu",))),
        step_size=0.0,
    )


def write_slave(  # noqa: PLR0913 - a build has this many options
    path: Path,
    name: str,
    out: Path,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    *,
    overwrite: bool = True,
) -> Path:
    """Write the FMU of a slave into a folder; for the arguments see `slave_fmu`.

    Without `overwrite`, only a file that this project made is replaced.

    Returns:
        The FMU.

    Raises:
        InputError: See `slave_fmu`; or the folder cannot be written.
        CosimError: See `slave_fmu`.
    """
    fmu = slave_fmu(path, name)
    place = out / f"{fmu.model}.fmu"
    check_replaceable(place, overwrite=overwrite)
    return write_one(fmu, place, fmi, platforms)


def _only_slave(path: Path) -> str:
    """Name of the class in a file that derives from PythonFMU's; the file is not run."""
    classes = [n for n in parse_file(path).body if isinstance(n, ast.ClassDef)]
    found = [c.name for c in classes if any(ast.unparse(b).endswith(_BASE) for b in c.bases)]
    if len(found) != 1:
        valid = ", ".join(c.name for c in classes) or "none"
        raise InputError(f"{path}: must have one subclass of {_BASE}, or name one of: {valid}")
    return found[0]


def _check_class(path: Path, name: str) -> None:
    """Say which classes a file defines if the named one may be mistyped."""
    classes = [n.name for n in parse_file(path).body if isinstance(n, ast.ClassDef)]
    if name not in classes:
        valid = ", ".join(classes) or "none"
        raise InputError(f"{path}: no class {name!r}; classes there: {valid}")


def _sources(path: Path, beside: Iterable[Path]) -> dict[str, bytes]:
    """The slave's file, and those in its folder, by name."""
    try:
        # Editors leave links that lead nowhere, such as `.#slave.py`, beside a changed file.
        files = [path, *sorted(file for file in beside if file.is_file())]
        return {file.name: file.read_bytes() for file in files}
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error


def _described(path: Path, name: str) -> tuple[str, str, list[list[Any]]]:
    """Description, docstring, and the variables in the order of value references."""
    file = path.resolve()
    command = [sys.executable, "-c", _DESCRIBE, file.as_posix(), name, str(file.parent)]
    child = run(command, environment=os.environ | SAFE_PATH)
    told = [line for line in child.stdout.splitlines() if line.startswith("SLAVE ")]
    if child.returncode or not told:
        _check_class(path, name)
        reason = (child.stderr.strip().splitlines() or ["no message"])[-1]
        raise CosimError(f"{path}: {name} cannot be instantiated: {one_line(reason)}")
    description, law, rows = json.loads(told[-1][6:])
    return description, law, rows


def _variable(path: Path, row: list[Any]) -> Variable:
    name, kind, causality, variability, text, start = row
    for what, value, valid in (("type", kind, _KINDS), ("causality", causality, _CAUSALITIES)):
        if value not in valid:
            near = did_you_mean(value, valid)
            raise InputError(
                f"{path}: variable {name}: {what} {value!r}; valid: {', '.join(valid)}{near}"
            )
    fixed = "fixed" if causality == "parameter" else ""
    known = variability or fixed or ("continuous" if kind == "Real" else "discrete")
    is_given = causality in ("input", "parameter") or known == "constant"
    return Variable(
        name,
        (),
        "",
        cast(Causality, causality),
        cast(Variability, known),
        one_line(text),
        _start(kind, start) if is_given else None,
        kind=cast(Kind, kind),
    )


def _start(kind: str, value: Any) -> Value:
    convert: dict[str, type] = {"Boolean": bool, "String": str}
    made: Value = convert.get(kind, float)(value if value is not None else 0)
    return made
