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
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from ...assets import STEP_SIZE
from ..build.libraries import SOURCES
from ..build.native import NativeFmu
from ..errors import InputError, located
from ..interface.controller import PERIOD
from ..interface.variables import Interface, Numbers, Variable
from .python_fmu import class_of, code_of, is_slave, python_fmu

SLAVE: Final = SOURCES.with_name("inside") / "law.py"
SLAVE_FILE: Final = "law_slave.py"  # its name in the FMU


@dataclass(frozen=True)
class LawFile:
    """A law, as `read_law` reads it from its file; its FMU is made once its signals are known."""

    path: Path
    name: str  # of the class
    text: str  # docstring of the class
    takes: tuple[str, ...]  # names of the signals that `update` takes
    parameters: Mapping[str, bool | Numbers]  # start values by name


def read_law(path: Path, name: str) -> LawFile | None:
    """Read a law without running it; None if the class is a PythonFMU slave."""
    node = class_of(path, name)
    if is_slave(node):  # its variables are known only once it runs
        return None
    text, parameters = ast.get_docstring(node) or name, dict(_parameters(node))
    return LawFile(path, name, text, _takes(path, node), parameters)


def _takes(path: Path, node: ast.ClassDef) -> tuple[str, ...]:
    """Names of the signals: the arguments of `update` after self and time."""
    methods = {each.name: each for each in node.body if isinstance(each, ast.FunctionDef)}
    match methods.get("update"):
        case ast.FunctionDef(
            args=ast.arguments(
                args=[_, ast.arg("time"), _, *_] as named, vararg=None, kwarg=None, kwonlyargs=[]
            )
        ):
            return tuple(each.arg for each in named[2:])
    raise InputError(
        f"{path}: class {node.name}: must have a method update(self, time, SIGNAL, ...), whose "
        "arguments name the signals that it takes"
    )


def _parameters(node: ast.ClassDef) -> Iterator[tuple[str, bool | Numbers]]:
    for statement in node.body:
        match statement:
            case (
                ast.Assign(targets=[ast.Name(name), *_], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(name), value=ast.expr() as value)
            ) if name[0] != "_" and (literal := _literal(value)) is not None:
                yield name, literal


def _literal(node: ast.expr) -> bool | Numbers | None:
    """The value, if it is a number, a boolean or several numbers."""
    value: Any = None
    with suppress(ValueError, TypeError):
        value = ast.literal_eval(node)
    parts = value if isinstance(value, (tuple, list)) else [value]
    if isinstance(value, bool):
        return value
    if not parts or not {*map(type, parts)} <= {int, float}:
        return None
    return tuple(map(float, parts)) if parts is value else float(value)


def law_interface(
    law: LawFile, signals: Callable[[str], Variable | None], ctrl: Variable
) -> Interface:
    """The variables of a law's FMU: shapes and units are those of the signals."""
    variables = (
        *(_input(law, name, signals(name)) for name in law.takes),
        Variable("ctrl", ctrl.shape, ctrl.unit, "output", "discrete", ctrl.description),
        *(_parameter(name, value) for name, value in law.parameters.items()),
    )
    interface = Interface(law.name, law.text.splitlines()[0], variables)
    with located(law.path):
        interface.check()
    return interface


def _input(law: LawFile, name: str, signal: Variable | None) -> Variable:
    if signal is None:
        what = f"{law.name}.update takes {name!r}, which does not exist"
        raise InputError(f"{law.path}: {what}; must be a command or an output of another FMU")
    start: Any = 0.0 if signal.start is None else signal.start
    return Variable(
        name, signal.shape, signal.unit, "input", "continuous", signal.description, start
    )


def _parameter(name: str, value: bool | Numbers) -> Variable:
    if name == PERIOD.name:
        return replace(PERIOD, start=value)
    text = f"Parameter {name} of the law"
    if isinstance(value, bool):
        return Variable(name, (), "", "parameter", "tunable", text, value, kind="Boolean")
    shape = (len(value),) if isinstance(value, tuple) else ()
    return Variable(name, shape, "1", "parameter", "tunable", text, value)


def law_fmu(
    law: LawFile,
    interface: Interface,
    start: tuple[float, ...],
    first: Mapping[str, Any] | None = None,
    rates: Sequence[float] | None = None,
) -> NativeFmu:
    """Describe a law's FMU; `start` is `ctrl` before the first update, by element.

    `rates` [1/s], by element, are the most by which `ctrl` follows what the law returns.
    """
    # `first`: bounds `low` and `high` of the first `ctrl`, for as many elements; whether all must
    # be `within`, or at least one beyond; the `reason` for the message.
    set_law = f"\nfrom {law.path.stem} import {law.name} as LAW\n"
    rows = [
        {"name": v.name, "shape": v.shape, "size": v.size, "causality": v.causality,
         "is_switch": v.kind == "Boolean"}
        for v in interface.variables
    ]  # fmt: skip
    layout = {"step": STEP_SIZE, "variables": rows, "start": start, "first": first, "rates": rates}
    return python_fmu(
        interface,
        law.text,
        {SLAVE_FILE: SLAVE.read_bytes() + set_law.encode(), **law_code(law.path)},
        (SLAVE_FILE.removesuffix(".py"), "LawSlave"),
        ("numpy",),
        resources={"layout.json": json.dumps(layout).encode()},
        private=True,
    )


def law_code(path: Path) -> dict[str, bytes]:
    """The law's module, and those below its folder that it imports: contents by path."""
    if not path.stem.isidentifier() or not path.stem.isascii() or path.name == SLAVE_FILE:
        raise InputError(f"{path}: must have a module's name, of letters, digits and _")
    return code_of(path, path.parent)
