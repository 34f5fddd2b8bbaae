"""The rows of the recording that the recorder has not received yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import SimulationError
from .wiring import Name

Array = NDArray[np.float64]
BLOCK_ROWS = 256  # few enough to stay in the processor's cache


class ExternalInputs(Protocol):
    """External inputs of each tick: an array, or an object that computes rows when sliced."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of rows and of columns."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Return some rows."""


class RowBuffer:
    """Rows of the recording: time, external inputs, outputs.

    It holds `BLOCK_ROWS` rows and one more, for the outputs of the last tick.
    """

    rows: Array  # (BLOCK_ROWS + 1, 1 + external + outputs)
    first: int  # tick of the first row
    filled: int  # number of complete rows

    def __init__(
        self, columns: Sequence[Name], external: int, start: float, step_size: float
    ) -> None:
        self.rows = np.zeros((BLOCK_ROWS + 1, 1 + len(columns)))
        self._columns = columns
        self.external = external
        self._start, self._step_size = start, step_size
        self.first = self.filled = self._flushed = 0
        self.set_held([])

    def set_held(self, columns: Sequence[int]) -> None:
        """Choose the output columns that `hold` copies, besides the external inputs."""
        self._held = [*range(1, 1 + self.external), *columns]

    def begin(self, sink: Callable[[Array], None]) -> None:
        """Start a recording; the sink is called with complete rows (n, columns)."""
        self._sink = sink
        self.rows[:] = 0.0
        self.first = self.filled = self._flushed = 0
        self._set_times()

    def _set_times(self) -> None:
        ticks = np.arange(self.first, self.first + len(self.rows))
        self.rows[:, 0] = self._start + ticks * self._step_size

    def set_external(self, row: int, values: Array) -> None:
        """Set the external inputs (n, external) of the rows from `row` on."""
        self.rows[row : row + len(values), 1 : 1 + self.external] = values

    def hold(self, row: int) -> None:
        """Copy the held columns from the row before; the first row has them from `turn`."""
        if row > 0:
            self.rows[row, self._held] = self.rows[row - 1, self._held]

    def turn(self) -> None:
        """Reuse the rows after a flush: the last row becomes the first."""
        self.hold(BLOCK_ROWS)
        self.rows[0] = self.rows[BLOCK_ROWS]
        self.first += BLOCK_ROWS
        self.filled = self._flushed = 0
        self._set_times()

    def complete(self, row: int) -> None:
        """Mark a row as complete; raises SimulationError if a value is not finite."""
        if not np.isfinite(self.rows[row]).all():
            raise self.error_at(row)
        self.filled = row + 1

    def complete_unchecked(self, row: int) -> None:
        """Mark a row as complete; `flush` finds values that are not finite."""
        self.filled = row + 1

    def flush(self) -> int | None:
        """Pass complete rows to the sink, up to the first that is not finite; returns its index."""
        non_finite = self.find_non_finite(self.filled)
        flushed, self._flushed = self._flushed, self.filled if non_finite is None else non_finite
        if self._flushed > flushed:
            self._sink(self.rows[flushed : self._flushed])
        return non_finite

    def find_non_finite(self, end: int) -> int | None:
        """Find the first row, of those before `end` not yet flushed, that is not finite."""
        finite = np.isfinite(self.rows[self._flushed : end])
        if finite.all():
            return None
        return self._flushed + int(finite.all(axis=1).argmin())

    def error_at(self, row: int) -> SimulationError:
        """Return the error that names the first value of a row that is not finite."""
        values = self.rows[row]
        column = int(np.flatnonzero(~np.isfinite(values))[0])
        instance, variable = self._columns[column - 1]
        return SimulationError(
            f"value {values[column]} is not finite",
            time=float(values[0]),
            instance=instance,
            variable=variable,
        )
