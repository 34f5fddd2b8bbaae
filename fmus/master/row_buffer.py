"""Rows on their way from the slaves to the recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BLOCK_ROWS = 256  # recorded before rows are used again; few enough to stay in the cache


class ExternalInputs(Protocol):
    """Rows that are given: an array, or what makes them when they are asked for."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of rows and of columns."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Return some rows."""


class RowBuffer:
    """Rows of the recording: time, external inputs, outputs. One more than is recorded.

    Args:
        outputs: Number of columns after those of the external inputs.
        external: Number of external inputs.

    Attributes:
        rows: The rows, `BLOCK_ROWS` and one.
        external: Number of external inputs.
        held: Columns that hold their values where nobody writes them.
        first: Tick of the first row.
        filled: Rows that are complete.
    """

    def __init__(self, outputs: int, external: int) -> None:
        self.rows = np.zeros((BLOCK_ROWS + 1, 1 + external + outputs))
        self.external = external
        self.held: list[int] = []
        self.first = self.filled = self._given = 0

    def begin(
        self,
        sink: Callable[[Array], None],
        external: ExternalInputs,
        start: float,
        step_size: float,
    ) -> None:
        """Start a recording at a start time [s]."""
        self._sink, self._external = sink, external
        self._start, self._step_size = start, step_size
        self.rows[:] = 0.0
        self.first = self.filled = self._given = 0
        self._set_given()

    def _set_given(self) -> None:
        """Fill in what is known beforehand: the rows' times and external inputs."""
        values = self._external[self.first : self.first + len(self.rows)]
        rows = self.rows[: len(values)]
        ticks = np.arange(self.first, self.first + len(values))
        rows[:, 0] = self._start + ticks * self._step_size
        rows[:, 1 : 1 + self.external] = values

    def hold(self, row: int) -> None:
        """Let the held columns of a row be those of the row before."""
        self.rows[row, self.held] = self.rows[row - 1, self.held]

    def turn(self) -> None:
        """Use the rows again, after a flush: what was the last becomes the first."""
        self.hold(BLOCK_ROWS)
        self.rows[0] = self.rows[BLOCK_ROWS]
        self.first += BLOCK_ROWS
        self.filled = self._given = 0
        self._set_given()

    def flush(self) -> int | None:
        """Give the complete rows to the sink, up to the first that is not finite.

        Returns:
            Index of that row; None: all are finite.
        """
        non_finite = self.find_non_finite(self.filled)
        given, self._given = self._given, self.filled if non_finite is None else non_finite
        if self._given > given:
            self._sink(self.rows[given : self._given])
        return non_finite

    def find_non_finite(self, end: int) -> int | None:
        """Find the first row before an index, of those not given, that is not finite."""
        sound = np.isfinite(self.rows[self._given : end])
        if sound.all():
            return None
        return self._given + int(sound.all(axis=1).argmin())
