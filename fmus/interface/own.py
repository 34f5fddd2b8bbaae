"""Variables of the project's own FMUs, from the TOML file of each beside this module.

The files say what each variable is: `[input]`, `[output]` and `[parameter]` have a row for each.
Shapes come from the layouts of plant and controller; defaults, ranges and units of parameters from
the classes that they set. The keys of a row are

    text        the description, one line; a parameter's row may be the text alone
    unit        of a signal; "1" unless it is said
    parts       arrays of one unit each: name, rows, unit, text
    source      where a native FMU finds it, see `fmus/README.md`
    on_request  recorded only where a connection or a criterion needs it
    max         of a parameter, below that of the class
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from .variables import Kind, Numbers, Variability, Variable

Values = tuple[Numbers | None, Numbers | None, Numbers | None]  # start, minimum, maximum


Row = Mapping[str, Any]  # what a file says of a variable


def read_table(fmu: str) -> dict[str, Any]:
    """Read the file of an FMU."""
    return tomllib.loads(Path(__file__).with_name(f"{fmu}.toml").read_text(encoding="utf-8"))


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
        variable = _parameter(entry, "fixed" if entry.name in fixed else "tunable")
        yield _described(variable, {"text": row} if isinstance(row, str) else row)


def _parameter(entry: Field[Any], variability: Variability) -> Variable:
    name, start, about = entry.name, cast(Any, entry.default), entry.metadata
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
        maximum=row.get("max", variable.maximum),
    )
