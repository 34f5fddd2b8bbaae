"""External inputs of a run: the scenario's commands and pushes, and values held instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ...fmus.interface.plant import FORCES
from ...fmus.interface.tables import COMMANDS, INTERFACES
from ...fmus.interface.variables import Interface, Value
from ...fmus.master.wiring import Name
from ...fmus.messages import did_you_mean
from ..fields import Quantity, Vector
from ..scenario.scenario import Scenario
from .start import StartValues, resolve

Array = NDArray[np.float64]
CHUNK = 16_384  # ticks computed at a time; a whole hour would take 0.4 GB


def names_from(scenario: Scenario) -> list[Name]:
    """Return the inputs that a scenario gives: forces on bodies, then the commands."""
    if scenario.is_system:
        return []
    variables = [("plant", FORCES[body]) for body in scenario.pushed]
    variables += [("controller", command) for command in COMMANDS]
    return [(i, n) for i, name in variables for n in INTERFACES[i].variable(name).names()]


class Inputs:
    """Rows of external inputs, computed chunk by chunk so that memory stays flat.

    Args:
        scenario: Gives commands and pushes.
        values: Start values used to resolve its table.
        names: Instance and scalar variable of each input.
        start: Values of inputs that the scenario does not give; default 0.

    Attributes:
        shape: Number of instants and number of inputs.
        table: The current trajectory table.
    """

    def __init__(
        self,
        scenario: Scenario,
        values: StartValues,
        names: Sequence[Name],
        start: Mapping[Name, float] | None = None,
    ) -> None:
        self._values = values
        self._columns = {".".join(name): i for i, name in enumerate(names)}
        self._start = np.array([(start or {}).get(name, 0.0) for name in names])
        self._held: dict[int, float] = {}
        self.shape = (scenario.ticks + 1, len(names))
        self.use(scenario)

    # The scenario's values.

    def use(self, scenario: Scenario) -> None:
        """Take commands and pushes from a scenario."""
        self._trajectory = None if scenario.is_system else resolve(scenario, self._values)
        self._pushes, self._pushed, self.table = scenario.push, scenario.pushed, scenario.table
        names = [".".join(name) for name in names_from(scenario)]
        self._from = [i for i, name in enumerate(names) if name in self._columns]
        self._to = [self._columns[names[i]] for i in self._from]
        self._first = -CHUNK
        self._part = np.empty((0, len(self._columns)))

    def __getitem__(self, ticks: slice, /) -> Array:
        """Return the rows of a range of ticks, cut off at the last one."""
        start, stop, _ = ticks.indices(self.shape[0])
        rows = np.empty((max(stop - start, 0), self.shape[1]))
        for first in range(start - start % CHUNK, stop, CHUNK):
            if first != self._first:
                self._first, self._part = first, self._computed(first, CHUNK)
            low, high = max(start, first), min(stop, first + CHUNK)
            rows[low - start : high - start] = self._part[low - first : high - first]
        for column, value in self._held.items():
            rows[:, column] = value
        return rows

    def _computed(self, first: int, count: int) -> Array:
        count = min(count, self.shape[0] - first)
        rows = np.tile(self._start, (count, 1))
        if self._trajectory is not None:
            times = STEP_SIZE * np.arange(first, first + count, dtype=np.float64)
            given = np.hstack((self._forces(times), self._trajectory.sample(times)))
            rows[:, self._to] = given[:, self._from]
        return rows

    def _forces(self, times: Array) -> Array:
        forces = np.zeros((len(times), len(self._pushed), 3))
        for push in self._pushes:
            active = (times >= push.start - STEP_SIZE / 2) & (
                times < push.start + push.duration - STEP_SIZE / 2
            )
            forces[active, self._pushed.index(push.on)] += push.force
        return forces.reshape(len(times), -1)

    # Values held instead.

    @property
    def held(self) -> list[str]:
        """Held scalars."""
        return [scalar for scalar, column in self._columns.items() if column in self._held]

    def hold(self, name: str, values: Sequence[Value]) -> None:
        """Hold an input, such as `controller.pos_cmd` or one of its scalars, until `release`."""
        self._held |= dict(zip(self.columns(name), map(float, values), strict=True))

    def release(self, name: str) -> None:
        """Give an input the scenario's values again."""
        held = [column for column in self.columns(name) if column in self._held]
        if not held:
            raise InputError(f"{name}: is not held; `set` holds an input")
        for column in held:
            del self._held[column]

    def columns(self, name: str) -> list[int]:
        """Columns of an input."""
        columns = [i for scalar, i in self._columns.items() if name in _names(scalar)]
        if not columns:
            valid = list(dict.fromkeys(_names(scalar)[1] for scalar in self._columns))
            raise InputError(
                f"{name}: is not an input given from outside; valid: {', '.join(valid)}"
                f"{did_you_mean(name, valid)}"
            )
        return columns

    def __contains__(self, name: str) -> bool:
        """Return whether there is such an input."""
        return any(name in _names(scalar) for scalar in self._columns)


def _names(scalar: str) -> tuple[str, str]:
    """Return a scalar's name, and that of its variable."""
    return scalar, scalar.partition("[")[0]


def checked_values(interface: Interface, name: str, value: object, count: int) -> list[float]:
    """Check a value for an input against its FMU's interface; one for all scalars, or one each."""
    rest = name.partition(".")[2]
    scalar = next(s for s in interface.scalars() if rest in (s.name, s.variable.name))
    low = -np.inf if scalar.minimum is None else scalar.minimum
    high = np.inf if scalar.maximum is None else scalar.maximum
    quantity = Quantity(low, high, "" if scalar.unit == "1" else scalar.unit)
    if not isinstance(value, list | tuple | np.ndarray):
        return [quantity.check(name, value) + 0.0] * count  # -0.0 becomes 0.0
    return [part + 0.0 for part in Vector(count, quantity).check(name, value)]
