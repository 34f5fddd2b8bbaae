"""External inputs that a scenario gives the FMUs: commands and pushes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.interface.forces import FORCES
from ...fmus.interface.tables import COMMANDS, INTERFACES
from ...fmus.master.wiring import Name
from ..definition.scenario import Scenario
from .start import StartValues, resolve

CHUNK = 16_384  # ticks computed at a time; a whole hour would take 0.4 GB


def given_names(scenario: Scenario) -> list[Name]:
    """Return instance and scalar variable of each input: forces on bodies, then the commands."""
    if scenario.is_system:
        return []
    given = [("plant", FORCES[body]) for body in scenario.pushed]
    given += [("controller", command) for command in COMMANDS]
    return [(i, n) for i, name in given for n in INTERFACES[i].variable(name).names()]


class ScenarioInputs:
    """Rows of external inputs: the force on each pushed body, then the commands.

    They are computed chunk by chunk as slices are read, so that memory stays flat.

    Args:
        scenario: The scenario.
        values: Start values used to resolve the table.
        columns: Which of the inputs exist; None: all.

    Attributes:
        shape: Number of instants and number of inputs.

    Raises:
        InputError: The table cannot be resolved.
    """

    def __init__(
        self, scenario: Scenario, values: StartValues, columns: Sequence[int] | None = None
    ) -> None:
        self._trajectory = None if scenario.is_system else resolve(scenario, values)
        self._columns = None if columns is None else list(columns)
        self._pushes = scenario.push
        self._pushed = scenario.pushed
        self._first = -CHUNK
        self._part = self._make(0, 1)
        self.shape = (scenario.ticks + 1, self._part.shape[1])

    def __getitem__(self, ticks: slice, /) -> NDArray[np.float64]:
        """Return the rows of a range of ticks, cut off at the last one."""
        start, stop, _ = ticks.indices(self.shape[0])
        rows = np.empty((max(stop - start, 0), self.shape[1]))
        for first in range(start - start % CHUNK, stop, CHUNK):
            if first != self._first:
                self._first, self._part = first, self._make(first, CHUNK)
            low, high = max(start, first), min(stop, first + CHUNK)
            rows[low - start : high - start] = self._part[low - first : high - first]
        return rows

    def _make(self, first: int, count: int) -> NDArray[np.float64]:
        if self._trajectory is None:
            return np.zeros((count, 0))
        times = STEP_SIZE * np.arange(first, first + count, dtype=np.float64)
        rows = np.hstack((self._forces(times), self._trajectory.sample(times)))
        return rows if self._columns is None else rows[:, self._columns]

    def _forces(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        forces = np.zeros((len(times), len(self._pushed), 3))
        for push in self._pushes:
            active = (times >= push.start - STEP_SIZE / 2) & (
                times < push.start + push.duration - STEP_SIZE / 2
            )
            forces[active, self._pushed.index(push.on)] += push.force
        return forces.reshape(len(times), -1)
