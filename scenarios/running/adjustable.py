"""External inputs that can be changed during a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.interface.variables import Interface, Value
from ...fmus.master.wiring import Name
from ...fmus.messages import did_you_mean
from ..definition.scenario import Scenario
from ..definition.table import TrajectoryTable
from ..fields import Quantity, Vector
from .external import ScenarioInputs, given_names
from .start import StartValues

Array = NDArray[np.float64]


class AdjustableInputs:
    """The scenario's pushes and commands, some of which can be held at other values.

    Args:
        scenario: The scenario.
        values: Start values used to resolve its table.
        names: Instance and scalar variable of each input: forces, then the commands.
        start: Values of inputs that the scenario does not give; default 0.
    """

    def __init__(
        self,
        scenario: Scenario,
        values: StartValues,
        names: Sequence[Name],
        start: Mapping[Name, float] | None = None,
    ) -> None:
        self._start = np.array([(start or {}).get(name, 0.0) for name in names])
        self._scenario, self._values = scenario, values
        self._columns = {".".join(name): i for i, name in enumerate(names)}
        self._held: dict[int, float] = {}
        self._use(scenario)

    @property
    def table(self) -> TrajectoryTable:
        """The current trajectory table."""
        return self._scenario.table

    @property
    def held(self) -> list[str]:
        """Held scalars."""
        return [scalar for scalar, column in self._columns.items() if column in self._held]

    def use(self, scenario: Scenario) -> None:
        """Take the commands from a changed scenario.

        Raises:
            InputError: Its table cannot be resolved.
        """
        self._use(scenario)
        self._scenario = scenario

    def _use(self, scenario: Scenario) -> None:
        columns = {".".join(name): i for i, name in enumerate(given_names(scenario))}
        self._from = [i for name, i in columns.items() if name in self._columns]
        self._to = [self._columns[name] for name in columns if name in self._columns]
        self._given = ScenarioInputs(scenario, self._values)

    def hold(self, name: str, values: Sequence[Value]) -> None:
        """Hold an input at values until it is released.

        Args:
            name: Such as `controller.pos_cmd`, or one of its scalars.
            values: One per scalar, or one for all.
        """
        columns = self.columns(name)
        self._held |= dict(zip(columns, map(float, values), strict=True))

    def release(self, name: str) -> None:
        """Give an input the scenario's values again.

        Raises:
            InputError: It is not held.
        """
        held = [column for column in self.columns(name) if column in self._held]
        if not held:
            raise InputError(f"{name}: is not held; `set` holds an input")
        for column in held:
            del self._held[column]

    def columns(self, name: str) -> list[int]:
        """Columns of an input.

        Raises:
            InputError: There is no such input.
        """
        found = [
            column
            for scalar, column in self._columns.items()
            if name in (scalar, scalar.partition("[")[0])
        ]
        if not found:
            valid = list(dict.fromkeys(s.partition("[")[0] for s in self._columns))
            raise InputError(
                f"{name}: is not an input given from outside; valid: {', '.join(valid)}"
                f"{did_you_mean(name, valid)}"
            )
        return found

    def __contains__(self, name: str) -> bool:
        """Return whether there is such an input."""
        return any(name in (s, s.partition("[")[0]) for s in self._columns)

    def rows(self, first: int, count: int) -> Array:
        """Return the inputs of some ticks (count, number of inputs)."""
        given = self._given[first : first + count]
        rows = np.tile(self._start, (len(given), 1))
        rows[:, self._to] = given[:, self._from]
        for column, value in self._held.items():
            rows[:, column] = value
        return rows


def checked_values(interface: Interface, name: str, value: object, count: int) -> list[float]:
    """Check a value for an input against its FMU's interface.

    Args:
        interface: Interface of the FMU.
        name: Such as `plant.push_force[1]`.
        value: One number for all scalars, or one per scalar.
        count: Number of scalars.

    Returns:
        One value per scalar.

    Raises:
        InputError: The number of values is wrong, or one is out of bounds.
    """
    rest = name.partition(".")[2]
    scalar = next(s for s in interface.scalars() if rest in (s.name, s.variable.name))
    low = -np.inf if scalar.minimum is None else scalar.minimum
    high = np.inf if scalar.maximum is None else scalar.maximum
    quantity = Quantity(low, high, "" if scalar.unit == "1" else scalar.unit)
    if not isinstance(value, list | tuple | np.ndarray):
        return [quantity.check(name, value) + 0.0] * count  # -0.0 becomes 0.0
    return [part + 0.0 for part in Vector(count, quantity).check(name, value)]
