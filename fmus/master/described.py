"""The interface table of any FMU, from its description."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import groupby
from typing import Final, cast

from ..interface.variables import Causality, Interface, Kind, Numbers, Value, Variability, Variable
from .fmu_file import Fmu, FmuVariable

NUMBERS: Final = ("Real", "Float32", "Integer")  # a table's Real
SHOWN: Final = ("input", "output", "parameter")
_ELEMENT: Final = re.compile(r"(.+)\[(\d+(?:,\d+)*)\]", re.S)


def described_interface(fmu: Fmu) -> Interface:
    """Return an FMU's interface: inputs, outputs and parameters, with elements joined to arrays.

    Consecutive scalars `q[1]`, `q[2]` become one variable `q` of shape (2,). Value references
    are not those of the FMU.
    """
    found = [v for v in fmu.variables.values() if v.causality in SHOWN]
    found.sort(key=lambda v: SHOWN.index(v.causality))
    variables: list[Variable] = []
    for _, group in groupby(found, key=_kind_of_array):
        variables += _together(list(group))
    description = fmu.description.description or ""
    return Interface(fmu.description.modelName or fmu.path.stem, description, tuple(variables))


def _kind_of_array(v: FmuVariable) -> tuple[str, ...]:
    return v.causality, v.variability, _base(v.name), v.type


def _base(name: str) -> str:
    match = _ELEMENT.fullmatch(name)
    return match[1] if match else name


def _together(scalars: list[FmuVariable]) -> Iterable[Variable]:
    """Return one array if the scalars are all of its elements, row by row; else each of them."""
    last = _ELEMENT.fullmatch(scalars[-1].name)
    if last is not None:
        shape = tuple(int(n) for n in last[2].split(","))
        array = _variable(_base(scalars[0].name), shape, scalars)
        if all(shape) and array.size == len(scalars) and array.names() == [s.name for s in scalars]:
            return [array]
    return [_variable(scalar.name, (), [scalar]) for scalar in scalars]


def _variable(name: str, shape: tuple[int, ...], scalars: list[FmuVariable]) -> Variable:
    first = scalars[0]
    units = tuple(s.unit or "" for s in scalars)
    return Variable(
        name,
        shape,
        units if len(set(units)) > 1 else units[0],
        cast("Causality", first.causality),
        _variability(first),
        first.description,
        _start(scalars),
        _bound([s.minimum for s in scalars]),
        _bound([s.maximum for s in scalars]),
        cast("Kind", "Real" if first.type in NUMBERS else first.type),
        tuple(first.choices.values()),
        1.0 if first.type == "Integer" else None,
    )


def _variability(first: FmuVariable) -> Variability:
    if first.causality != "parameter":
        return "continuous"
    return "tunable" if first.variability == "tunable" else "fixed"


def _start(scalars: list[FmuVariable]) -> Numbers | Value | None:
    if any(s.start is None for s in scalars):
        return None
    values = tuple(_value(s) for s in scalars)
    return values[0] if len(values) == 1 else values  # type: ignore[return-value]


def _value(scalar: FmuVariable) -> Value:
    value = scalar.start_value()
    if scalar.type == "Enumeration":
        return scalar.choices.get(int(value), str(value))
    return float(value) if scalar.type in NUMBERS else value


def _bound(bounds: list[float | None]) -> Numbers | None:
    """Bounds of all elements; None if any element has none."""
    known = tuple(b for b in bounds if b is not None)
    return None if len(known) < len(bounds) else known


__all__ = ["described_interface"]
