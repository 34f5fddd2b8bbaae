"""Inputs that a scenario drives: [inputs] and its file, one value each, or values over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, expand, targets
from ...fmus.interface.types import in_row, type_of
from ...fmus.interface.variables import Interface, Scalar, Value
from ...fmus.master.fmu_file import read_value
from ...fmus.master.wiring import Array, Name
from ...task.scenario import Scenario
from .parts import split

EARLY: Final = 1e-9  # [s] by which a tick may be before the row that holds from its time on


@dataclass(frozen=True, eq=False)
class DrivenInput:
    """An input over time: one row, or several at times that do not decrease.

    A continuous Real is interpolated linearly, others are held from their row on; before the first
    row and after the last, the input has these rows' values. At a jump, the later row counts.
    """

    scalar: Scalar
    values: Sequence[Value]  # of each row
    times: Array  # (n,) [s]

    @property
    def _is_interpolated(self) -> bool:
        variable = self.scalar.variable
        is_real = type_of(variable) in ("Float64", "Float32")
        return is_real and variable.variability == "continuous" and len(self.values) > 1

    def _rows(self, times: Array) -> NDArray[np.intp]:
        """The last row up to each time; the first one before it."""
        return (np.searchsorted(self.times, times + EARLY, side="right") - 1).clip(0)

    def at_start(self, time: float) -> Any:
        """Start value, for the time of the start [s]."""
        at = np.array([time])
        if self._is_interpolated:
            return float(self.sample(at)[0])
        return self.values[self._rows(at)[0]]

    def sample(self, times: Array) -> Any:
        """Values at some times, as rows hold them."""
        if not self._is_interpolated:
            column = [in_row(self.scalar, value) for value in self.values]
            return [column[row] for row in self._rows(times)]
        values, before = np.array(self.values), self._rows(times).clip(max=len(self.values) - 2)
        t0, t1 = self.times[before], self.times[before + 1]
        share = ((t1 - times) / np.where(t1 > t0, t1 - t0, 1.0)).clip(0.0, 1.0)
        return share * values[before] + (1.0 - share) * values[before + 1]


def driven_inputs(
    scenario: Scenario, interfaces: Mapping[str, Interface]
) -> dict[Name, DrivenInput]:
    """Check the inputs of [inputs] and of its file against the FMUs; by FMU and scalar."""
    by_fmu: dict[str, dict[str, ParameterValue]] = {}
    for key, value in scenario.inputs.items():
        if key != "file":
            instance, name = split("[inputs] ", key, interfaces)
            by_fmu.setdefault(instance, {})[name] = value
    driven: dict[Name, DrivenInput] = {}
    for instance, values in by_fmu.items():
        place = f"[inputs] {instance}"
        for name, value in expand(place, interfaces[instance], values, "input").items():
            scalar = interfaces[instance].named[name]
            driven[instance, name] = DrivenInput(scalar, [value], np.zeros(1))
    table, times = scenario.input_table, np.array(scenario.input_table.times)
    for key, cells in table.columns.items():
        instance, name = split("[inputs] ", key, interfaces)
        scalar, *others = targets(instance, interfaces[instance], name, "input")
        if others or (instance, scalar.name) in driven:
            what = "has several elements" if others else "is in [inputs], too"
            raise InputError(f"{table.place}: {key}: {what}; must be one element, given once")
        place = f"{table.place}: {key}: row"
        values_over_time = [
            scalar.checked(f"{place} {row}", read_value(f"{place} {row}:", scalar.variable, cell))
            for row, cell in enumerate(cells, 1)
        ]
        driven[instance, scalar.name] = DrivenInput(scalar, values_over_time, times)
    return driven
