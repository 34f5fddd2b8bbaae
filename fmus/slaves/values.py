"""The values of an instance's variables: one array of numbers, and the texts of Strings."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from ..interface.variables import Interface, Kind, Scalar
from .telling import SlaveError

Array = NDArray[np.float64]
Read = Callable[[], list[float]]
Write = Callable[..., None]
LARGEST: Final = sys.float_info.max  # bound of what is only finite


@dataclass(frozen=True, slots=True)
class Plan:
    """How a list of value references maps to the buffer; found out once, then used as it is.

    Attributes:
        references: The list.
        read: Returns the values as a list.
        write: Takes the values as arguments; raises SlaveError where they cannot be set.
        parameters: Whether a parameter is among them.
        bounds: Index in the list, lower and upper bound, of the inputs that have bounds.
    """

    references: list[int]
    read: Read
    write: Write
    parameters: bool
    bounds: list[tuple[int, float, float]]


class Values:
    """The values of an interface's variables, at their start values at first.

    Args:
        interface: The table.

    Attributes:
        values: All values, by value reference: inputs, then outputs, then parameters. Booleans are
            0 or 1, Enumerations count from 1.
        texts: Texts of Strings, by value reference.
        inputs: View of the inputs.
        outputs: View of the outputs.
        parameters: View of the parameters.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        self.scalars = interface.scalars()
        self.values = np.array([_number(s) for s in self.scalars])
        self.texts = {
            s.value_reference: str(s.start) for s in self.scalars if s.variable.kind == "String"
        }
        causes = [s.variable.causality for s in self.scalars]
        first_output = causes.count("input")
        self._first_parameter = first_output + causes.count("output")
        self.inputs = self.values[:first_output]
        self.outputs = self.values[first_output : self._first_parameter]
        self.parameters = self.values[self._first_parameter :]
        fixed = [s.variable.variability == "fixed" for s in self.scalars[self._first_parameter :]]
        self._fixed = np.array(fixed, bool)
        self._locked = False
        self._plans: dict[tuple[int, int], Plan] = {}

    def input_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the inputs; the largest number where there is none."""
        scalars = self.scalars[: self.inputs.size]
        low = [-LARGEST if s.minimum is None else s.minimum for s in scalars]
        high = [LARGEST if s.maximum is None else s.maximum for s in scalars]
        return np.array(low), np.array(high)

    def parameter(self, name: str) -> float | tuple[float, ...] | bool | str:
        """Value of a parameter, by its name without indices."""
        variable = self._interface.variable(name)
        first = next(s.value_reference for s in self.scalars if s.variable is variable)
        values = self.values[first : first + variable.size].tolist()
        if variable.kind == "String":
            return self.texts[first]
        if variable.kind == "Enumeration":
            return self._choice(variable.name, variable.choices, values[0])
        if variable.kind == "Boolean":
            return bool(values[0])
        return tuple(values) if variable.shape else float(values[0])

    @staticmethod
    def _choice(name: str, choices: tuple[str, ...], value: float) -> str:
        if value not in range(1, len(choices) + 1):
            raise SlaveError(f"{name}: {value:g} is out of range [1, {len(choices)}]")
        return choices[int(value) - 1]

    def fixed(self) -> tuple[bytes, tuple[str, ...]]:
        """Values of all fixed parameters, to be compared."""
        return self.parameters[self._fixed].tobytes(), tuple(self.texts.values())

    def keep_fixed(self, before: tuple[bytes, tuple[str, ...]]) -> str | None:
        """Put fixed parameters back to what they were.

        Args:
            before: What `fixed` returned.

        Returns:
            Name of one that had changed, or None.
        """
        if self.fixed() == before:
            return None
        numbers = np.frombuffer(before[0])
        changed = np.flatnonzero(~(self.parameters[self._fixed] == numbers))
        texts = dict(zip(self.texts, before[1], strict=True))
        other = [reference for reference, text in texts.items() if text != self.texts[reference]]
        self.parameters[self._fixed] = numbers
        self.texts |= texts
        if other:
            return self.scalars[other[0]].name
        where = int(np.flatnonzero(self._fixed)[changed[0]])
        return self.scalars[self._first_parameter + where].name

    def lock(self, locked: bool) -> None:
        """Let nothing be set any more, or again."""
        self._locked = locked
        self._plans.clear()

    def plan(self, vrs: list[int]) -> Plan:
        """Find out how a list of value references maps to the buffer.

        Raises:
            SlaveError: A reference is unknown.
        """
        key = (vrs[0], len(vrs)) if vrs else (0, 0)
        plan = self._plans.get(key)
        if plan is None or plan.references != vrs:
            for vr in vrs:
                self._check(vr, "Real")
            contiguous = vrs == list(range(key[0], key[0] + len(vrs)))
            read, write = (_bind_block if contiguous else _bind_scattered)(self.values, vrs)
            parameters = max(vrs, default=0) >= self._first_parameter
            write = self._refusal(vrs) or write
            plan = self._plans[key] = Plan(list(vrs), read, write, parameters, self._bounds(vrs))
        return plan

    def _bounds(self, vrs: list[int]) -> list[tuple[int, float, float]]:
        low, high = (bound.tolist() for bound in self.input_bounds())
        return [
            (i, low[vr], high[vr])
            for i, vr in enumerate(vrs)
            if vr < len(low) and (low[vr] > -LARGEST or high[vr] < LARGEST)
        ]

    def _refusal(self, vrs: list[int]) -> Write | None:
        """Say in place of setting why these cannot be set, if they cannot."""
        outputs = range(self.inputs.size, self._first_parameter)
        output = next((vr for vr in vrs if vr in outputs), None)
        if output is None and not (self._locked and vrs):
            return None
        name = self.scalars[vrs[0] if output is None else output].name
        reason = "it has been terminated" if output is None else "it is an output"

        def refuse(*_values: float) -> None:
            raise SlaveError(f"{name} cannot be set: {reason}")

        return refuse

    def get_others(self, kind: Kind, vrs: list[int]) -> list[Any]:
        """Values of variables that are not Real.

        Args:
            kind: Their type.
            vrs: Value references.

        Raises:
            SlaveError: A reference is unknown, or that of another type.
        """
        for vr in vrs:
            self._check(vr, kind)
        if kind == "String":
            return [self.texts[vr] for vr in vrs]
        convert = bool if kind == "Boolean" else int
        return [convert(self.values[vr]) for vr in vrs]

    def set_others(self, kind: Kind, vrs: list[int], values: list[Any]) -> None:
        """Set variables that are not Real; arguments as of `get_others`."""
        for vr, value in zip(vrs, values, strict=True):
            self._check(vr, kind)
            if self._locked:
                raise SlaveError("a value cannot be set: it has been terminated")
            if kind == "String" and not isinstance(value, str):
                raise SlaveError(f"{self.scalars[vr].name}: no text was given")
            if kind == "String":
                self.texts[vr] = value
            else:
                self.values[vr] = value

    def _check(self, vr: int, kind: Kind) -> None:
        if not (0 <= vr < len(self.scalars) and self.scalars[vr].variable.kind == kind):
            raise SlaveError(f"value reference {vr} is not that of a variable of type {kind}")


def _number(scalar: Scalar) -> float:
    """Start value as a number."""
    variable, start = scalar.variable, scalar.start
    if variable.kind == "Enumeration":
        return variable.choices.index(str(start)) + 1.0
    return 0.0 if start is None or variable.kind == "String" else float(start)


def _bind_block(reals: Array, vrs: list[int]) -> tuple[Read, Write]:
    """How to read and write values that stand side by side."""
    first, count = (vrs[0] if vrs else 0), len(vrs)
    # Packing takes a third of the time of an assignment from a list, and neither it nor a view of
    # memory needs numpy's code, which has left the processor's cache by then.
    write = partial(struct.Struct(f"{count}d").pack_into, reals.data, 8 * first)
    view = cast("memoryview[float]", reals[first : first + count].data)
    return cast(Read, view.tolist), write


def _bind_scattered(reals: Array, vrs: list[int]) -> tuple[Read, Write]:
    """How to read and write values that stand anywhere."""
    indices = np.array(vrs, dtype=np.intp)

    def read() -> list[float]:
        values: list[float] = reals.take(indices).tolist()
        return values

    def write(*values: float) -> None:
        reals[indices] = values

    return read, write
