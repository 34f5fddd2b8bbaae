"""A control law in a Python file, as an FMU.

A law is a class with a method `update`; it is read without being run:

    class MyLaw:
        \"\"\"What it computes.\"\"\"

        gain = 4.0   # a number, boolean or tuple of numbers is a tunable parameter
        period = 0.002  # optional: time between two updates [s]; default 1 ms

        def update(self, time, pos_cmd, hand_xpos, jac):
            return ctrl

The arguments of `update` after `time` name the signals that it takes: commands and outputs of the
other FMUs, as numbers or numpy arrays of their shapes. It returns `ctrl`. A method `start(self)`,
if there is one, is called before the first update, with the parameters set.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ...assets import STEP_SIZE
from ..errors import InputError
from ..interface.variables import Interface, Numbers, Variable
from ..messages import did_you_mean
from .bundle import packed
from .native import NativeFmu
from .python_fmu import HOST, host
from .python_runtime import python_options
from .python_source import parse_file

Signals = Callable[[str], Variable | None]
SLAVE: Final = Path(__file__).parents[1] / "slaves" / "law.py"
LAYOUT: Final = "layout.json"
PERIOD_MAX: Final = 1.0  # [s]
_BASE: Final = "Fmi2Slave"  # PythonFMU's class of slaves


@dataclass(frozen=True)
class LawFile:
    """A law, as read from its file.

    Attributes:
        path: The file.
        name: Name of the class.
        description: First line of its docstring.
        text: The docstring.
        takes: Names of the signals that `update` takes.
        parameters: Start values, by name.
        is_slave: Whether it is a PythonFMU slave, whose variables are known only once it runs.
    """

    path: Path
    name: str
    description: str
    text: str
    takes: tuple[str, ...]
    parameters: Mapping[str, bool | Numbers]
    is_slave: bool = False


def read_law(path: Path, name: str) -> LawFile:
    """Read a law without running it.

    Args:
        path: The Python file.
        name: Name of the class.

    Raises:
        InputError: The file cannot be read or has no such class, or the class is not a law.
    """
    tree = parse_file(path)
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    if name not in classes:
        valid = ", ".join(classes) or "none"
        raise InputError(
            f"{path}: no class {name!r}; classes there: {valid}{did_you_mean(name, classes)}"
        )
    node = classes[name]
    text = ast.get_docstring(node) or name
    is_slave = any(ast.unparse(base).split(".")[-1] == _BASE for base in node.bases)
    takes = () if is_slave else _takes(path, node)
    parameters = {} if is_slave else dict(_parameters(path, node))
    law = LawFile(path, name, text.splitlines()[0], text, takes, parameters, is_slave)
    _check_parameters(path, law)
    return law


def _takes(path: Path, node: ast.ClassDef) -> tuple[str, ...]:
    """Names of the signals: the arguments of `update` after self and time."""
    found = [n for n in node.body if isinstance(n, ast.FunctionDef) and n.name == "update"]
    arguments = [a.arg for a in found[0].args.args] if found else []
    plain = found and not (found[0].args.vararg or found[0].args.kwarg or found[0].args.kwonlyargs)
    if not plain or len(arguments) < 3 or arguments[1] != "time":
        raise InputError(
            f"{path}: class {node.name}: must have a method update(self, time, SIGNAL, ...), whose "
            "arguments name the signals that it takes"
        )
    return tuple(arguments[2:])


def _parameters(path: Path, node: ast.ClassDef) -> Any:
    for statement in node.body:
        if isinstance(statement, ast.Assign):
            targets, value = statement.targets, statement.value
        elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
            targets, value = [statement.target], statement.value
        else:
            continue
        name = targets[0].id if isinstance(targets[0], ast.Name) else "_"
        literal = _literal(value)
        if literal is not None and not name.startswith("_"):
            yield name, _checked_period(path, literal) if name == "period" else literal


def _check_parameters(path: Path, law: LawFile) -> None:
    """Refuse parameters that no FMU can have beside the law's signals and methods."""
    taken = {
        "ctrl": "its output",
        "start": "a method",
        "update": "a method",
        "time": "the time",
    }
    taken |= dict.fromkeys(law.takes, "one of its signals")
    for name, value in law.parameters.items():
        if name in taken:
            raise InputError(
                f"{path}: class {law.name}: {name} = ...: is the name of {taken[name]}; must be "
                "another name"
            )
        if not all(map(math.isfinite, value if isinstance(value, tuple) else (value,))):
            raise InputError(
                f"{path}: class {law.name}: {name}: value {value!r}; must be a finite number"
            )


def _literal(node: ast.expr) -> bool | Numbers | None:
    """The value, if it is a number, a boolean or several numbers."""
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError):
        return None
    if isinstance(value, bool):
        return value
    if isinstance(value, (int, float)):
        return float(value)
    if isinstance(value, (tuple, list)) and value and all(type(v) in (int, float) for v in value):
        return tuple(map(float, value))
    return None


def _checked_period(path: Path, period: bool | Numbers) -> float:
    ticks = period / STEP_SIZE if isinstance(period, float) else 0.0
    if not (1 <= round(ticks) <= PERIOD_MAX / STEP_SIZE and abs(ticks - round(ticks)) < 1e-6):
        raise InputError(
            f"{path}: period: value {period!r}; must be a whole multiple of {STEP_SIZE:g} s, at "
            f"most {PERIOD_MAX:g} s"
        )
    return float(round(ticks) * STEP_SIZE)


def law_interface(law: LawFile, signals: Signals, ctrl: Variable) -> Interface:
    """The variables of a law's FMU: shapes and units are those of the signals.

    Args:
        law: The law.
        signals: Function that returns the signal of a name, or None.
        ctrl: The plant's input that the law computes.

    Raises:
        InputError: There is no signal of a name.
    """
    variables = [_input(law, name, signals(name)) for name in law.takes]
    variables.append(
        Variable("ctrl", ctrl.shape, ctrl.unit, "output", "discrete", ctrl.description)
    )
    variables += [_parameter(name, value) for name, value in law.parameters.items()]
    return Interface(law.name, law.description, tuple(variables))


def _input(law: LawFile, name: str, signal: Variable | None) -> Variable:
    if signal is None:
        raise InputError(
            f"{law.path}: {law.name}.update takes {name!r}, which does not exist; must be a "
            "command or an output of another FMU"
        )
    start = 0.0 if signal.start is None else signal.start
    return Variable(
        name, signal.shape, signal.unit, "input", "continuous", signal.description, start
    )


def _parameter(name: str, value: bool | Numbers) -> Variable:
    shape = (len(value),) if isinstance(value, tuple) else ()
    text = f"Parameter {name} of the law"
    if isinstance(value, bool):
        return Variable(name, (), "", "parameter", "tunable", text, value, kind="Boolean")
    if name == "period":
        text = "Time between two updates; outputs are held in between"
        return Variable(
            name, (), "s", "parameter", "fixed", text, value, STEP_SIZE, PERIOD_MAX,
            multiple_of=STEP_SIZE,
        )  # fmt: skip
    return Variable(name, shape, "1", "parameter", "tunable", text, value)


def law_fmu(law: LawFile, interface: Interface, start: tuple[float, ...]) -> NativeFmu:
    """Describe a law's FMU.

    Args:
        law: The law.
        interface: Its variables.
        start: Value of `ctrl` before the first update, by element.
    """
    found = modules(law.path)
    layout = _layout(interface, start)
    set_law = f"\nfrom {law.path.stem} import {law.name} as LAW\n".encode()
    slave = SLAVE.read_bytes() + set_law
    content = hashlib.sha256(layout + slave)
    for name, source in found.items():
        content.update(name.encode() + b"\0" + source)
    package = f"law_{content.hexdigest()[:16]}"
    code = {"law_slave.py": slave, **{f"{name}.py": source for name, source in found.items()}}
    files = {HOST: host(), LAYOUT: layout, **packed(package, code)}
    options = [("package", package), ("slave", "law_slave LawSlave"), ("private", "law_slave")]
    options += [("private", name) for name in found]
    needs = python_options(("numpy",))
    return NativeFmu(interface, "python", law.text, files, (*options, *needs))


def _layout(interface: Interface, start: tuple[float, ...]) -> bytes:
    """Layout of the variables, for the slave, as JSON."""
    rows = [
        {"name": v.name, "shape": v.shape, "size": v.size, "causality": v.causality,
         "is_switch": v.kind == "Boolean"}
        for v in interface.variables
    ]  # fmt: skip
    return json.dumps({"step": STEP_SIZE, "variables": rows, "start": start}).encode()


def modules(path: Path) -> dict[str, bytes]:
    """The law's module, and the modules in its folder that it imports, by name."""
    found: dict[str, bytes] = {}
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file.stem in found or not file.is_file():
            continue
        if not re.fullmatch(r"[A-Za-z_]\w*", file.stem, re.A) or file.stem == "law_slave":
            raise InputError(f"{file}: must have a module's name, of letters, digits and _")
        found[file.stem] = file.read_bytes()
        waiting += [file.with_name(f"{name}.py") for name in _imported(parse_file(file))]
    return found


def _imported(tree: ast.Module) -> set[str]:
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    return {name.partition(".")[0] for name in names}


__all__ = ["LawFile", "law_fmu", "law_interface", "modules", "read_law"]
