"""The rows that an FMU's interface table consists of.

Each FMU has one table, in a module of its own (`plant`, `controller`, `trajectory`). Slaves, model
descriptions, documentation, connections and tests come from these tables or are checked against
them. Names never change: users' scripts depend on them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Literal

Causality = Literal["input", "output", "parameter", "local"]
Variability = Literal["continuous", "discrete", "fixed", "tunable", "constant"]
Kind = Literal["Real", "Integer", "Boolean", "Enumeration", "String", "Binary", "Clock"]
Value = float | bool | str
Numbers = float | tuple[float, ...]


@dataclass(frozen=True)
class Scalar:
    """One FMI scalar variable.

    Attributes:
        name: Structured name, such as `jac[1,2]`.
        variable: The row of the table that it belongs to.
        unit: SI unit; "" if it is not Real.
        start: Start value, or None.
        minimum: Lower bound, or None.
        maximum: Upper bound, or None.
        value_reference: FMI value reference, unique in the FMU: the index in its array of values.
    """

    name: str
    variable: Variable
    unit: str
    start: Value | None
    minimum: float | None
    maximum: float | None
    value_reference: int


@dataclass(frozen=True)
class Variable:
    """One row of an interface table: a scalar, vector or matrix.

    Attributes:
        name: Name without indices.
        shape: () for a scalar, else (n,) or (rows, columns); indices start at 1.
        unit: SI unit of each scalar, or of all; "" if it is not Real.
        causality: input, output, parameter or local.
        variability: continuous, discrete, fixed, tunable or constant.
        description: One line.
        start: Start value of each scalar, or of all; None for outputs.
        minimum: Lower bounds, or one for all; None: unbounded.
        maximum: Upper bounds, or one for all; None: unbounded.
        kind: FMI type. All outputs are Real, because importers read them as Real.
        choices: Names of an Enumeration's values, which count from 1.
        multiple_of: A Real must be a whole multiple of this; None: may have any value.
        source: Where a native FMU finds it, in its backend's notation; "": by its name.
        on_request: Whether it is recorded only where a connection or a criterion needs it.
    """

    name: str
    shape: tuple[int, ...]
    unit: str | tuple[str, ...]
    causality: Causality
    variability: Variability
    description: str
    start: Numbers | bool | str | None = None
    minimum: Numbers | None = None
    maximum: Numbers | None = None
    kind: Kind = "Real"
    choices: tuple[str, ...] = ()
    multiple_of: float | None = None
    source: str = ""
    on_request: bool = False

    @property
    def initial(self) -> str | None:
        """FMI's attribute `initial`."""
        if self.variability == "constant":
            return "exact"
        words = {"output": "calculated", "local": "calculated", "parameter": "exact"}
        return words.get(self.causality)

    @property
    def size(self) -> int:
        """Number of scalars."""
        return math.prod(self.shape)

    def names(self) -> list[str]:
        """Names of the scalars, row by row."""
        if not self.shape:
            return [self.name]
        indices = product(*(range(1, n + 1) for n in self.shape))
        return [f"{self.name}[{','.join(map(str, index))}]" for index in indices]

    def scalars(self, first_reference: int) -> Iterator[Scalar]:
        """Yield the scalars with value references from `first_reference` on."""
        for i, name in enumerate(self.names()):
            yield Scalar(
                name,
                self,
                self.unit[i] if isinstance(self.unit, tuple) else self.unit,
                _pick(self.start, i),
                _pick_number(self.minimum, i),
                _pick_number(self.maximum, i),
                first_reference + i,
            )


def _pick(values: Numbers | bool | str | None, i: int) -> Value | None:
    return values[i] if isinstance(values, tuple) else values


def _pick_number(values: Numbers | None, i: int) -> float | None:
    return values[i] if isinstance(values, tuple) else values


@dataclass(frozen=True)
class Interface:
    """The interface of one FMU.

    Attributes:
        model: Model name and identifier.
        description: One line.
        variables: The table: inputs, then outputs, then parameters.
        terminals: Names of variables that are connected together, by the terminal's name.
    """

    model: str
    description: str
    variables: tuple[Variable, ...]
    terminals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def scalars(self) -> list[Scalar]:
        """All scalar variables, in the order of their value references, which count from 0."""
        return list(self._scalars)

    @cached_property
    def _scalars(self) -> tuple[Scalar, ...]:
        scalars: list[Scalar] = []
        for variable in self.variables:
            scalars += variable.scalars(len(scalars))
        return tuple(scalars)

    @property
    def time_name(self) -> str:
        """Name of FMI 3.0's independent variable: `time`, unless another is called that."""
        name, taken = "time", {variable.name for variable in self.variables}
        while name in taken:
            name += "_"
        return name

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality."""
        return tuple(v for v in self.variables if v.causality == causality)

    def variable(self, name: str) -> Variable:
        """Return the variable of a name without indices.

        Raises:
            KeyError: There is none.
        """
        for variable in self.variables:
            if variable.name == name:
                return variable
        raise KeyError(name)


def input_(  # noqa: PLR0913 - a row has this many columns
    name: str,
    shape: tuple[int, ...],
    unit: str | tuple[str, ...],
    description: str,
    start: Numbers,
    minimum: Numbers | None = None,
    maximum: Numbers | None = None,
    source: str = "",
) -> Variable:
    """Return an input."""
    return Variable(name, shape, unit, "input", "continuous", description, start, minimum,
                    maximum, source=source)  # fmt: skip


def output(  # noqa: PLR0913 - a row has this many columns
    name: str,
    shape: tuple[int, ...],
    unit: str | tuple[str, ...],
    description: str,
    source: str = "",
    *,
    on_request: bool = False,
) -> Variable:
    """Return an output that changes at every step."""
    return Variable(name, shape, unit, "output", "continuous", description, source=source,
                    on_request=on_request)  # fmt: skip


def held(
    name: str, shape: tuple[int, ...], unit: str | tuple[str, ...], description: str
) -> Variable:
    """Return an output that changes at the controller's updates only."""
    return Variable(name, shape, unit, "output", "discrete", description)


def joints(arm: str, *others: str) -> tuple[str, ...]:
    """Units of a vector that begins with the seven joints of the arm."""
    return (*[arm] * 7, *others)


JAC_UNITS = (*["m/rad"] * 21, *["1"] * 21)  # of a Jacobian, linear rows first
