"""The interface table of any FMU, from its description."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, Final

from ..interface.variables import Interface, Scalar, Variable
from .fmu_file import Fmu

NUMBERS: Final = ("Real", "Float32", "Integer")  # a table's Real
SHOWN: Final = ("input", "output", "parameter")
_ELEMENT: Final = re.compile(r"(.+)\[(\d+(?:,\d+)*)\]", re.S)


def described_interface(fmu: Fmu) -> Interface:
    """Return an FMU's interface: inputs, outputs and parameters, with elements joined to arrays.

    Consecutive scalars `q[1]`, `q[2]` become one variable `q` of shape (2,). Value references
    are not those of the FMU.
    """
    scalars = [s for s in fmu.variables.values() if s.variable.causality in SHOWN]
    scalars.sort(key=lambda s: SHOWN.index(s.variable.causality))
    variables: list[Variable] = []
    for _, group in groupby(scalars, key=_array):
        variables += _joined(list(group))
    description = fmu.description.description or ""
    return Interface(fmu.description.modelName or fmu.path.stem, description, tuple(variables))


def _array(scalar: Scalar) -> tuple[str, ...]:
    """What the elements of one array have in common."""
    variable, match = scalar.variable, _ELEMENT.fullmatch(scalar.name)
    name = match[1] if match else scalar.name
    return name, variable.causality, variable.variability, variable.kind, variable.fmi_type


def _joined(scalars: Sequence[Scalar]) -> Iterable[Variable]:
    """Return one array if the scalars are all of its elements, row by row; else each of them."""
    last = _ELEMENT.fullmatch(scalars[-1].name)
    if last is not None:
        shape = tuple(int(n) for n in last[2].split(","))
        array = _variable(last[1], shape, scalars)
        if all(shape) and array.size == len(scalars) and array.names() == [s.name for s in scalars]:
            return [array]
    return [_variable(scalar.name, (), [scalar]) for scalar in scalars]


def _variable(name: str, shape: tuple[int, ...], scalars: Sequence[Scalar]) -> Variable:
    first = scalars[0].variable
    units = tuple(s.unit for s in scalars)
    starts: Any = None if any(s.start is None for s in scalars) else tuple(s.start for s in scalars)
    is_tunable = first.causality == "parameter" and first.variability == "tunable"
    return replace(
        first,
        name=name,
        shape=shape,
        unit=units[0] if len(set(units)) == 1 else units,
        variability="tunable" if is_tunable
        else "fixed" if first.causality == "parameter" else "continuous",
        start=starts if len(scalars) > 1 else scalars[0].start,
        minimum=_bound([s.minimum for s in scalars]),
        maximum=_bound([s.maximum for s in scalars]),
        kind="Real" if first.kind in NUMBERS else first.kind,
        multiple_of=1.0 if first.kind == "Integer" else None,
    )  # fmt: skip


def _bound(bounds: Sequence[float | None]) -> tuple[float, ...] | None:
    """Bounds of all elements; None if any element has none."""
    known = tuple(bound for bound in bounds if bound is not None)
    return known if len(known) == len(bounds) else None
