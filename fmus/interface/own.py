"""Variables of the project's own FMUs, from the TOML file of each beside this module.

The files say what each variable is. Shapes come from the layouts of plant and controller; defaults,
ranges and units of parameters from the classes that they set.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, TypedDict, cast

import numpy as np

from .variables import Kind, Numbers, Variability, Variable

Values = tuple[Numbers | None, Numbers | None, Numbers | None]  # start, minimum, maximum


class Row(TypedDict, total=False):
    """What a file says of a variable."""

    text: str  # its description, one line
    unit: str  # of a signal; "1" unless it is said
    parts: list[tuple[str, int, str, str]]  # arrays of one unit each: name, rows, unit, text
    source: str  # where a native FMU finds it, see `fmus/README.md`
    on_request: bool  # recorded only where a connection or a criterion needs it


class Table(TypedDict, total=False):
    """What a file says of an FMU."""

    description: str
    input: dict[str, Row]
    output: dict[str, Row]
    signal: dict[str, str]  # of the sensors, texts of what they measure
    parameter: dict[str, Row | str]  # a text alone where there is no more to say


def read_table(fmu: str) -> Table:
    """Read the file of an FMU."""
    path = Path(__file__).with_name(f"{fmu}.toml")
    return cast(Table, tomllib.loads(path.read_text(encoding="utf-8")))


def signals(
    rows: Mapping[str, Row],
    layout: np.dtype[np.void],
    causality: Literal["input", "output"],
    values: Mapping[str, Values] | None = None,
    variability: Variability = "continuous",
) -> Iterator[Variable]:
    """Yield the variables of a layout; `values` are of those that are not 0 without bounds."""
    usual: Values = (0.0 if causality == "input" else None, None, None)
    for name in layout.names or ():
        row, shape = rows[name], layout[name].shape
        unit, (start, low, high) = row.get("unit", "1"), (values or {}).get(name, usual)
        variable = Variable(name, shape, unit, causality, variability, "", start, low, high)
        yield _described(variable, row)


def parameters(
    rows: Mapping[str, Row | str], parameters_class: type, fixed: Collection[str]
) -> Iterator[Variable]:
    """Yield the parameters that set the fields of a class; those not `fixed` can be tuned."""
    for entry in fields(parameters_class):
        row = rows[entry.name]
        variability: Variability = "fixed" if entry.name in fixed else "tunable"
        variable = _parameter(entry.name, entry.default, entry.metadata, variability)
        yield _described(variable, {"text": row} if isinstance(row, str) else row)


def _parameter(
    name: str, start: Any, about: Mapping[str, Any], variability: Variability
) -> Variable:
    if "choices" in about:
        named: Kind = "Enumeration" if about["choices"] else "String"
        kind: Kind = "Boolean" if isinstance(start, bool) else named
        return Variable(name, (), "", "parameter", variability, "", start, kind=kind,
                        choices=about["choices"])  # fmt: skip
    shape = (len(start),) if isinstance(start, tuple) else ()
    low, high = about["range"]
    return Variable(name, shape, about["unit"], "parameter", variability, "",
                    start if shape else float(start), low, high,
                    multiple_of=about["multiple_of"])  # fmt: skip


def _described(variable: Variable, row: Row) -> Variable:
    """Add what the file says; where there are parts, their units are those of the elements."""
    parts, width = row.get("parts", ()), math.prod(variable.shape[1:])
    units = tuple(unit for _, n, unit, _ in parts for _ in range(n * width))
    return replace(
        variable,
        description=row["text"],
        unit=units or variable.unit,
        parts=tuple((name, n, text) for name, n, _, text in parts),
        source=row.get("source", ""),
        on_request=row.get("on_request", False),
    )
