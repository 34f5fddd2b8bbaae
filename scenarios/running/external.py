"""What a scenario gives the FMUs from outside: commands and pushes, as a run gets to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ..definition.scenario import Scenario
from .start import StartValues, resolve

PART = 16_384  # [tick] that are made at a time: an hour's in one go would take 0.4 GB


class External:
    """Rows of external inputs: the push, if there is one, then the commands.

    They are made when a slice is asked for, a part at a time, so that memory stays flat.

    Args:
        scenario: What is run.
        values: Start values, which the table is resolved with.

    Attributes:
        shape: Number of instants and of inputs.

    Raises:
        InputError: The table cannot be resolved.
    """

    def __init__(self, scenario: Scenario, values: StartValues) -> None:
        self._trajectory = resolve(scenario, values)
        self._pushes = scenario.push
        self._first = -PART
        self._part = self._make(0, 1)
        self.shape = (scenario.ticks + 1, self._part.shape[1])

    def __getitem__(self, ticks: slice, /) -> NDArray[np.float64]:
        """Return the rows of some ticks in turn; an end beyond the last one is cut off."""
        start, stop, _ = ticks.indices(self.shape[0])
        rows = np.empty((max(stop - start, 0), self.shape[1]))
        for first in range(start - start % PART, stop, PART):
            if first != self._first:
                self._first, self._part = first, self._make(first, PART)
            low, high = max(start, first), min(stop, first + PART)
            rows[low - start : high - start] = self._part[low - first : high - first]
        return rows

    def _make(self, first: int, count: int) -> NDArray[np.float64]:
        times = STEP_SIZE * np.arange(first, first + count, dtype=np.float64)
        commands: NDArray[np.float64] = self._trajectory.sample(times)
        if not self._pushes:
            return commands
        forces = np.zeros((count, 3))
        for push in self._pushes:
            active = (times >= push.start - STEP_SIZE / 2) & (
                times < push.start + push.duration - STEP_SIZE / 2
            )
            forces[active] += push.force
        return np.hstack((forces, commands))
