"""Makes an FMU on our own library from a user's PythonFMU slave."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, Final, cast

from ..build.native import NativeFmu
from ..errors import CosimError, InputError
from ..interface.variables import Causality, Interface, Kind, Value, Variability, Variable
from ..messages import one_line
from ..processes import SAFE_PATH, run
from .python_fmu import BASE, class_of, classes_of, code_of, is_slave, python_fmu

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
_CAUSALITIES: Final = ("input", "output", "parameter", "local")


def slave_fmu(path: Path, name: str = "") -> NativeFmu:
    """Describe the FMU of a PythonFMU slave. This runs the slave's file."""
    chosen = name or _only_slave(path)
    code = code_of(path, path.parent)
    description, law, rows = _described(path, chosen)
    variables = tuple(_variable(path, row) for row in rows)
    interface = Interface(chosen, one_line(description or law) or chosen, variables)
    return python_fmu(
        interface,
        law or chosen,
        code,
        (path.stem, chosen),
        ("pythonfmu",),
        private=True,
        step_size=0.0,
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
    file = path.resolve()
    command = [sys.executable, "-c", _DESCRIBE, file.as_posix(), name, str(file.parent)]
    child = run(command, environment=os.environ | SAFE_PATH)
    answers = [line for line in child.stdout.splitlines() if line.startswith("SLAVE ")]
    if child.returncode or not answers:
        class_of(path, name)  # which may be mistyped
        reason = (child.stderr.strip().splitlines() or ["no message"])[-1]
        raise CosimError(f"{path}: {name} cannot be instantiated: {one_line(reason)}")
    description, law, rows = json.loads(answers[-1][6:])
    return description, law, rows


def _variable(path: Path, row: list[Any]) -> Variable:
    name, kind, causality, variability, text, start = row
    if causality not in _CAUSALITIES:
        valid = ", ".join(_CAUSALITIES)
        raise InputError(f"{path}: variable {name}: causality {causality!r}; valid: {valid}")
    fixed = "fixed" if causality == "parameter" else ""
    known = variability or fixed or ("continuous" if kind == "Real" else "discrete")
    has_start = causality in ("input", "parameter") or known == "constant"
    convert: dict[str, type[Value]] = {"Boolean": bool, "String": str}
    value = convert.get(kind, float)(0 if start is None else start) if has_start else None
    return Variable(
        name,
        (),
        "",
        cast(Causality, causality),
        cast(Variability, known),
        one_line(text),
        value,
        kind=cast(Kind, kind),
    )
