"""Variables of FMUs, and the interface that they make.

Slaves, model descriptions, documentation, connections and tests come from the interfaces of our
FMUs (`plant`, `controller`, `sensors`, `tables`) or are checked against them. Names never change:
users' scripts depend on them.
"""

from __future__ import annotations

import math
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby, product
from typing import Any, Final, Literal, cast

from ..errors import InputError, refuse
from .units import Units

Causality = Literal["input", "output", "parameter", "local"]
Variability = Literal["continuous", "discrete", "fixed", "tunable", "constant"]
Kind = Literal["Real", "Integer", "Boolean", "Enumeration", "String", "Binary"]
Value = float | bool | str
Numbers = float | tuple[float, ...]
Unit = str | tuple[str, ...]
Part = tuple[str, int, str]  # name, number of rows, and description of an array
MOST_ELEMENTS: Final = 500_000  # of all arrays of an FMU or an SSP
MULTIPLE_TOLERANCE: Final = 1e-6  # relative to the `multiple_of` of a variable
# Bits of integers, and whether one is the sign's, by FMI type; FMI 2.0's one type is Integer.
INTEGERS: Final = {
    "Integer": (32, True),
    **{f"{sign}Int{bits}": (bits, not sign) for sign in ("", "U") for bits in (8, 16, 32, 64)},
}


_ADDRESS: Final = re.compile(r".* of .* \((\S+\.\w+)\)")
_DIGITS: Final = re.compile("([0-9a-f]{2})*", re.I | re.A)  # of a Binary


def address(description: str) -> str:
    """The short name in the description of a joint's or an actuator's element; "" if none is."""
    found = _ADDRESS.fullmatch(description)
    return found[1] if found else ""


@dataclass(frozen=True, slots=True)
class Scalar:
    """One scalar of a variable: what FMI sets and gets by a value reference.

    `Variable.scalars` makes them, or an `Interface` for all of its variables at once. Whatever a
    user sets goes through `checked`: bounds and types are checked here and nowhere else. Do not
    keep one to hold a value; values are in rows, by the scalar's name.
    """

    name: str  # with the indices of an element, such as `jac[1,2]`
    variable: Variable
    element: int  # index among the variable's scalars, row by row
    unit: str  # "" if there is none
    start: Value | None
    minimum: float | None
    maximum: float | None
    value_reference: int  # of FMI; in FMI 3.0, that of the whole array

    def checked(self, place: str, value: Any) -> Value:
        """Return a value in this scalar's type; of an enumeration, the name of a choice."""
        choices = self.variable.choices
        match self.variable.kind:
            case "Boolean":
                is_valid, must = value in (False, True), "true or false"
                value = bool(value)
            case "Binary":
                is_valid, must = bool(_DIGITS.fullmatch(str(value))), "text of hexadecimal digits"
            case "String" | "Enumeration":
                is_valid = isinstance(value, str) and (not choices or value in choices)
                must = f"one of {', '.join(choices)}" if choices else "text in quotes"
            case _:
                return self._checked_number(place, value)
        if not is_valid:
            refuse(place, value, f"must be {must}", choices)
        return cast(Value, value)

    def _checked_number(self, place: str, value: object) -> float:
        low, high = self._bounds()
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        number: Any = value if is_number else math.inf
        if not (abs(number) <= sys.float_info.max and low <= number <= high):
            refuse(place, value, f"must be {self._range(low, high)}")
        part = 1.0 if self.variable.whole else self.variable.multiple_of
        if isinstance(value, int) and part == 1.0:
            return value
        if part and abs(number - round(number / part) * part) > MULTIPLE_TOLERANCE * part:
            refuse(place, value, f"must be a whole multiple of {part:g}{self._unit}")
        return int(number) if self.variable.whole else float(number)

    def _bounds(self) -> tuple[float, float]:
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if self.variable.whole:
            bits, signed = self.variable.whole
            low = max(low, -(2 ** (bits - 1)) if signed else 0)
            high = min(high, 2 ** (bits - signed) - 1)
        return low, high

    def _range(self, low: float, high: float) -> str:
        if self.variable.whole:
            return f"a whole number from {int(low)} to {int(high)}"
        words = {
            (True, True): f"a number from {low:g} to {high:g}{self._unit}",
            (True, False): f"a number of at least {low:g}{self._unit}",
            (False, True): f"a number up to {high:g}{self._unit}",
        }
        return words.get((math.isfinite(low), math.isfinite(high)), "a finite number")

    @property
    def _unit(self) -> str:
        """Unit to write after a number; "" for a dimensionless one."""
        return "" if self.unit in ("", "1") else f" {self.unit}"

    def converted(self, value: Value) -> Any:
        """Return a value as an FMU takes it: of an enumeration, the number of a choice."""
        match self.variable.kind:
            case "Binary":
                return value if isinstance(value, bytes) else bytes.fromhex(str(value))
            case "String":
                return str(value)
            case "Boolean":
                return bool(value)
            case "Enumeration":
                return self.variable.number_of(value) if isinstance(value, str) else int(value)
        return int(value) if self.variable.whole else float(value)

    @property
    def description(self) -> str:
        """What it is, on one line."""
        details = self.variable.details
        return details[self.element] if details else self.variable.description

    def alone(self) -> Variable:
        """Return this scalar as a variable of its own."""
        return replace(
            self.variable, name=self.name, shape=(), parts=(), unit=self.unit, start=self.start,
            minimum=self.minimum, maximum=self.maximum, details=(), description=self.description,
        )  # fmt: skip

    def start_value(self) -> Any:
        """Start value as an FMU takes it; zero or empty if there is none."""
        if self.start is not None:
            return self.converted(self.start)
        return self.converted("" if self.variable.kind in ("String", "Binary") else 0.0)


@dataclass(frozen=True)
class Variable:
    """One row of an interface table, or a variable of any FMU: a scalar, vector or matrix.

    Ours are made by `own.signals` and `own.parameters` from the TOML files, those of models and
    laws by `fmus/sources`, and those of any .fmu file by `master/fmu_file.py`. It never changes:
    another one comes from `dataclasses.replace`.
    """

    name: str  # without indices
    shape: tuple[int, ...]  # () for a scalar, else (n,) or (rows, columns); indices start at 1
    unit: Unit  # of each scalar, or of all; "" if it is not Real
    causality: Causality
    variability: Variability
    description: str  # one line
    start: Numbers | bool | str | None = None  # of each scalar, or of all; None for outputs
    minimum: Numbers | None = None  # of each scalar, or of all; None: unbounded
    maximum: Numbers | None = None
    nominal: float | None = None  # size of usual values, of a Real; None: not declared
    kind: Kind = "Real"  # all outputs of ours are Real, because importers read them as Real
    choices: tuple[str, ...] = ()  # names of an Enumeration's values
    numbers: tuple[int, ...] = ()  # of the choices, where they do not count from 1
    multiple_of: float | None = None  # a Real must be a whole multiple; None: may have any value
    source: str = ""  # where a native FMU finds it, in its backend's notation; "": by its name
    on_request: bool = False  # recorded only where a connection or a criterion needs it
    has_start: bool = False  # a value to start from can be set, though it is no parameter or input
    fmi_type: str = ""  # as the FMU's own version of FMI names it; "": not read from an FMU
    details: tuple[str, ...] = ()  # description of each scalar; (): that of the variable
    parts: tuple[Part, ...] = ()  # arrays that FMI 3.0 has instead, row by row

    def number_of(self, choice: str) -> int:
        """Return the number of a choice."""
        index = self.choices.index(choice)
        return self.numbers[index] if self.numbers else index + 1

    @property
    def initial(self) -> str | None:
        """FMI's attribute `initial`."""
        words = {"output": "calculated", "local": "calculated", "parameter": "exact"}
        return "exact" if self.variability == "constant" else words.get(self.causality)

    @property
    def whole(self) -> tuple[int, bool] | None:
        """Bits of a whole number, and whether one is the sign's; None: it is another type."""
        return INTEGERS.get(self.fmi_type or self.kind)

    @property
    def size(self) -> int:
        """Number of scalars."""
        return math.prod(self.shape)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each scalar."""
        return self.unit if isinstance(self.unit, tuple) else (self.unit,) * self.size

    def names(self) -> list[str]:
        """Names of the scalars, row by row."""
        return list(self._names) if self.shape else [self.name]

    @cached_property
    def _names(self) -> tuple[str, ...]:
        indices = product(*(range(1, n + 1) for n in self.shape))
        return tuple(f"{self.name}[{','.join(map(str, index))}]" for index in indices)

    def arrays(self) -> Iterator[Variable]:
        """Yield the arrays of one unit each that FMI 3.0 has instead; of several units, none."""
        first, width = 0, math.prod(self.shape[1:])
        columns = (self.unit, self.start, self.minimum, self.maximum)
        for name, rows, description in self._all_parts():
            elements = slice(first * width, (first + rows) * width)
            unit, start, low, high = (_cut(values, elements) for values in columns)
            details = self.details[elements]
            text = f"{description}: {', '.join(details)}" if details else description
            is_scalar = len(self.shape) == 1 and rows == 1 < self.size
            yield replace(
                self, name=name, description=text, parts=(), start=start, minimum=low,
                details=details,
                shape=(rows, *self.shape[1:]) if self.shape and not is_scalar else (),
                unit="" if isinstance(unit, tuple) else unit, maximum=high,
            )  # fmt: skip
            first += rows

    def _all_parts(self) -> Iterator[Part]:
        """Yield `parts`; then, named by their indices, arrays of what these leave over."""
        yield from self.parts
        first, width = sum(rows for _, rows, _ in self.parts), math.prod(self.shape[1:])
        by_row = [self.units[i : i + width] for i in range(first * width, self.size, width)]
        for _, group in groupby(by_row):
            rows = len(list(group))
            indices = f"_{first + 1}" + f"_to_{first + rows}" * (rows > 1)
            yield f"{self.name}{indices * (first > 0)}", rows, self.description
            first += rows

    def scalars(self, first_reference: int, stride: int = 1) -> Iterator[Scalar]:
        """Yield the scalars; value references count by `stride`, 0 in FMI 3.0."""
        columns: tuple[Any, ...] = (self.unit, self.start, self.minimum, self.maximum)
        for i, name in enumerate(self.names()):
            unit, start, low, high = (
                values[i] if isinstance(values, tuple) else values for values in columns
            )
            yield Scalar(name, self, i, unit, start, low, high, first_reference + stride * i)


@dataclass(frozen=True)
class Interface:
    """The interface of one FMU: all of its variables, whatever it is made from.

    Descriptions, documents, connections, columns of recordings and keys of `--set` follow from it.
    The modules beside this one make ours; `described_interface` reads that of an .fmu file, and
    runs nothing of it. Do not compare two by identity, but for ours (`INTERFACES`, `SENSORS`).
    """

    model: str  # name and identifier
    description: str  # one line
    variables: tuple[Variable, ...]  # inputs, then outputs, then parameters
    terminals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # variables by name
    units: Units = field(default_factory=dict)  # that an FMU from elsewhere defines, by name
    is_model: bool = False  # whether it is a MuJoCo model
    author: str = ""  # of a user's model, as its interface file says
    # Outputs, as scalars, of which an FMU from elsewhere says that they depend on no input.
    independent: frozenset[str] = frozenset()

    def scalars(self) -> list[Scalar]:
        """All scalar variables, in the order of their value references, which count from 0."""
        return list(self._scalars)

    @cached_property
    def _scalars(self) -> tuple[Scalar, ...]:
        scalars: list[Scalar] = []
        for variable in self.variables:
            scalars += variable.scalars(len(scalars))
        return tuple(scalars)

    def check(self) -> None:
        """Refuse two variables of one name, and start values that are out of bounds."""
        for name, count in Counter(variable.name for variable in self.variables).most_common(1):
            if count > 1:
                raise InputError(f"two variables have the name {name!r}")
        for scalar in self._scalars:
            if scalar.start is not None:
                scalar.checked(f"{scalar.name}: start", scalar.start)

    @property
    def time_name(self) -> str:
        """Name of FMI 3.0's independent variable: `time`, unless another is called that."""
        name, taken = "time", {variable.name for variable in self.variables}
        while name in taken:
            name += "_"
        return name

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(variable for variable in self.variables if variable.causality == causality)

    def variable(self, name: str) -> Variable:
        """Return the variable of a name without indices; raises KeyError."""
        return self._by_name[name]

    def end(self, name: str, causality: str) -> Variable | None:
        """Return a variable, or an element of one as a scalar variable; None: there is none."""
        if whole := self._by_name.get(name):
            return whole if whole.causality == causality else None
        scalar = self.named.get(name)
        return scalar.alone() if scalar and scalar.variable.causality == causality else None

    @cached_property
    def _by_name(self) -> dict[str, Variable]:
        return {variable.name: variable for variable in reversed(self.variables)}

    @cached_property
    def named(self) -> dict[str, Scalar]:
        """All scalar variables by their names, and by addresses such as `lift.pos`."""
        addressed = {address(s.description): s for s in self._scalars if s.variable.details}
        return addressed | {s.name: s for s in self._scalars}


def check_elements(place: str, count: int) -> None:
    """Refuse arrays before they are made, each element of which takes almost 1 kB of memory."""
    if count > MOST_ELEMENTS:
        refuse(f"{place}: array elements up to here", count, f"must be at most {MOST_ELEMENTS}")


def by_array(scalars: Iterable[Scalar]) -> dict[str, list[Scalar]]:
    """Scalars by the names of their variables."""
    arrays: dict[str, list[Scalar]] = {}
    for scalar in scalars:
        arrays.setdefault(scalar.variable.name, []).append(scalar)
    return arrays


def _cut(values: Any, elements: slice) -> Any:
    """Values of some elements; one alone if all of them are equal."""
    parts = values[elements] if isinstance(values, tuple) else (values,)
    return parts[0] if all(part == parts[0] for part in parts) else parts
