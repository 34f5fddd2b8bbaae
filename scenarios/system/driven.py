"""The inputs that a scenario drives: with one value each, and over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, expand, targets
from ...fmus.interface.types import in_row, type_of
from ...fmus.interface.variables import Interface, Scalar, Value
from ...fmus.master.fmu_file import read_value
from ...fmus.master.wiring import Name
from ...fmus.messages import did_you_mean, excerpt
from ..scenario.scenario import Scenario

Array = NDArray[np.float64]
_REALS: Final = ("Float64", "Float32")
EARLY: Final = 1e-9  # [s] by which a tick may be before the row that holds from its time on


@dataclass(frozen=True, eq=False)
class DrivenInputs:
    """Values of inputs by FMU and scalar variable, which is the same as in the table's rows."""

    constant: Mapping[Name, Value] = field(default_factory=dict)
    varying: Mapping[Name, tuple[Value, ...]] = field(default_factory=dict)  # at each of the times
    times: Array = field(default_factory=lambda: np.zeros(0))  # (n,) [s]

    @property
    def names(self) -> list[Name]:
        """All of them."""
        return [*self.constant, *self.varying]

    def at_start(self, time: float, scalars: Mapping[Name, Scalar]) -> dict[str, dict[str, Value]]:
        """Start values by FMU, for the time of the start [s]."""
        row = max(int(self._row(time)), 0)
        values: dict[str, dict[str, Value]] = {}
        for (instance, name), value in self.constant.items():
            values.setdefault(instance, {})[name] = value
        for (instance, name), column in self.varying.items():
            scalar = scalars[instance, name]
            value = column[row]
            if type_of(scalar.variable) in _REALS:
                value = float(self.sample((instance, name), scalar, np.array([time]))[0])
            values.setdefault(instance, {})[name] = value
        return values

    def _row(self, times: ArrayLike) -> Any:
        """The last row up to some times; -1 before the first."""
        return np.searchsorted(self.times, np.asarray(times) + EARLY, side="right") - 1

    def sample(self, name: Name, scalar: Scalar, times: Array) -> Any:
        """Values of an input at some times, as rows hold them.

        Continuous Reals are interpolated linearly, others are held from their row on; before the
        first row and after the last they have these rows' values. At a jump, the later row counts.
        """
        if name in self.constant:
            return in_row(scalar, self.constant[name])
        column = [in_row(scalar, value) for value in self.varying[name]]
        last = len(self.times) - 1
        rows = self._row(times)
        is_held = scalar.variable.variability != "continuous"
        if is_held or type_of(scalar.variable) not in _REALS or not last:
            return [column[row] for row in rows.clip(0, last)]
        values, before = np.array(column), rows.clip(0, last - 1)
        t0, t1 = self.times[before], self.times[before + 1]
        share = ((t1 - times) / np.where(t1 > t0, t1 - t0, 1.0)).clip(0.0, 1.0)
        return share * values[before] + (1.0 - share) * values[before + 1]


def driven_inputs(scenario: Scenario, interfaces: Mapping[str, Interface]) -> DrivenInputs:
    """Check the inputs of [inputs] and of its file against the FMUs."""
    by_fmu: dict[str, dict[str, ParameterValue]] = {}
    for key, value in scenario.inputs.items():
        if key != "file":
            instance, name = _split(key, interfaces)
            by_fmu.setdefault(instance, {})[name] = value
    constant = {
        (instance, name): value
        for instance, given in by_fmu.items()
        for name, value in expand(instance, interfaces[instance], given, "input").items()
    }
    table = scenario.input_table
    varying: dict[Name, tuple[Value, ...]] = {}
    for key, cells in table.columns.items():
        instance, name = _split(key, interfaces)
        scalars = {scalar.name: scalar for scalar in interfaces[instance].scalars()}
        named = targets(instance, interfaces[instance], scalars, name, "input")
        scalar, place = named[0], f"{table.place}: {key}: row"
        if len(named) > 1 or (instance, scalar.name) in constant:
            what = "has several elements" if len(named) > 1 else "is in [inputs], too"
            raise InputError(f"{table.place}: {key}: {what}; must be one element, given once")
        varying[instance, scalar.name] = tuple(
            scalar.checked(f"{place} {row}", read_value(f"{place} {row}:", scalar.variable, cell))
            for row, cell in enumerate(cells, 1)
        )
    return DrivenInputs(constant, varying, table.times if varying else np.zeros(0))


def _split(key: str, interfaces: Mapping[str, Interface]) -> Name:
    """FMU and variable that a key names; an FMU's name may have dots."""
    fitting = [name for name in interfaces if key.startswith(f"{name}.")]
    if not fitting:
        raise InputError(
            f"[inputs] {excerpt(key)}: no such FMU; valid: {', '.join(interfaces)}"
            f"{did_you_mean(key.partition('.')[0], interfaces)}"
        )
    instance = max(fitting, key=len)
    return instance, key.removeprefix(f"{instance}.")
