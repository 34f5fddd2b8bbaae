"""A recording in memory, for runs of which only the summary is kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .reader import Recording
from .storage import FORMAT, PARQUET_FILE, Column, distinct

Array = NDArray[np.float64]


class MemoryRecorder:
    """Keeps a recording in memory, with the interface of `Recorder`.

    Args:
        folder: The run's folder, for messages; nothing is written there.
        columns: Columns of a row; the first is `time`.
        metadata: Scenario, versions, parameters and so on.
    """

    def __init__(
        self, folder: Path, columns: Sequence[Column], metadata: Mapping[str, Any]
    ) -> None:
        self.columns = tuple(distinct(columns))
        self.metadata: dict[str, Any] = {**metadata, "format": FORMAT}
        self._folder = folder
        self._parts: list[Array] = []
        self._index = {column.name: i for i, column in enumerate(self.columns)}
        self.metadata |= {"complete": False, "reason": "the recording was not closed"}
        self._closed = False

    @property
    def rows(self) -> int:
        """Number of rows appended."""
        return sum(len(part) for part in self._parts)

    def append(self, rows: Array) -> None:
        """Append a block of rows, shape (n, columns), copied."""
        self._parts.append(rows.copy())

    def flush(self) -> None:
        """Do nothing: there is no file."""

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self.metadata |= {"complete": complete, "reason": reason}
        return self._folder

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns, all rows in one block."""
        columns = self._by_column()
        yield [columns[self._index[name]] for name in names]

    def _by_column(self) -> Array:
        """Join the rows to one array (columns, n) with contiguous columns."""
        if len(self._parts) != 1 or not self._parts[0].flags.f_contiguous:
            rows = np.empty((self.rows, len(self.columns)), order="F")
            np.concatenate([rows[:0], *self._parts], out=rows)
            self._parts = [rows]
        return self._parts[0].T

    def recording(self) -> Recording:
        """Return what was recorded."""
        return Recording(self._folder / PARQUET_FILE, self)  # where its files would be looked for

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Mark the recording as incomplete, with the reason, if `close` was not called."""
        if error is not None:
            self.close(complete=False, reason=f"{type(error).__name__}: {error}")


__all__ = ["MemoryRecorder"]
