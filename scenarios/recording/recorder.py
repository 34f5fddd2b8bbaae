"""Writes a recording during a run, so that it survives any end of the run."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, SimulationError
from . import storage
from .storage import PARQUET_FILE, STREAM_FILE, Column

Array = NDArray[np.float64]

FLUSH_INTERVAL = 0.3  # [s] wall time; the master's own delay makes it at most 0.5 s
_BUFFER_ROWS = 4096


class Recorder:
    """Writes a recording; it only observes, and changes, checks or drops no value.

    It is a context manager: on exit without `close` it keeps the rows and marks the recording as
    incomplete.

    Args:
        folder: The run's folder; made if missing.
        columns: Columns of a row; the first is `time`.
        metadata: Scenario, versions, parameters and so on, written as JSON.
        overwrite: Replace an existing recording.

    Raises:
        InputError: The folder contains a recording, or cannot be written to.
        SimulationError: The disk is full.
    """

    def __init__(
        self,
        folder: str | Path,
        columns: Sequence[Column],
        metadata: Mapping[str, Any],
        *,
        overwrite: bool = False,
    ) -> None:
        place = Path(folder).absolute()  # an FMU may change the working directory
        self._stream = place / STREAM_FILE
        self._parquet = place / PARQUET_FILE
        storage.literal(self._parquet)  # or it would be refused after the run
        self._schema = storage.make_schema(
            storage.distinct(columns), {**metadata, "format": storage.FORMAT}
        )
        self._buffer = np.empty((len(columns), _BUFFER_ROWS))
        self._filled = 0
        self._saved = 0
        self._size = 0  # of the stream's whole messages [bytes]
        self._error: SimulationError | None = None
        self._closed = False
        try:
            self._make_place(overwrite)
            self._file = self._stream.open("xb", buffering=0)
            storage.lock(self._file, wait=True)
            self._last_flush = time.monotonic()
        except (OSError, ValueError) as error:  # ValueError: a null byte in the name
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{folder}: cannot be written to: {reason}") from error
        try:
            self._write(self._schema.serialize())
        except SimulationError:
            self._file.close()
            self._stream.unlink()
            raise

    @property
    def rows(self) -> int:
        """Number of rows appended."""
        return self._saved + self._filled

    def append(self, rows: Array) -> None:
        """Append a copy of a block of rows, shape (n, columns); flush if it is time.

        Raises:
            SimulationError: The disk is full or failed. All rows flushed before are kept.
        """
        if self._error is not None:
            raise self._error
        while len(rows):
            part = rows[: _BUFFER_ROWS - self._filled]
            self._buffer[:, self._filled : self._filled + len(part)] = part.T
            self._filled += len(part)
            rows = rows[len(part) :]
            if self._filled == _BUFFER_ROWS:
                self.flush()
        if time.monotonic() - self._last_flush >= FLUSH_INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Pass all rows to the operating system as one batch; they then survive the process.

        Raises:
            SimulationError: The disk is full or failed. All rows flushed before are kept.
        """
        self._last_flush = time.monotonic()
        if self._filled:
            self._write(storage.serialize_rows(self._schema, self._buffer[:, : self._filled]))
            self._saved += self._filled
            self._filled = 0

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording; a second call does nothing.

        Args:
            complete: Whether the run was completed.
            reason: Why it was not.

        Returns:
            The file with the recording: Parquet, or the stream if converting it failed.

        Raises:
            SimulationError: The disk is full or failed; the stream keeps all flushed rows. Not
                raised again after `append` or `flush` has raised it.
        """
        if not self._closed:
            self._closed = True
            failed_before = self._error is not None
            try:
                self._finish(complete, reason)
            except SimulationError:
                if not failed_before:
                    raise
            finally:
                self._file.close()
        return self._parquet if self._parquet.exists() else self._stream

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Close the recording as incomplete, if `close` was not called."""
        if error is None:
            self.close(complete=False, reason="the recording was not closed")
            return
        with suppress(SimulationError):  # the present error says more
            self.close(complete=False, reason=f"{type(error).__name__}: {error}")

    def _make_place(self, overwrite: bool) -> None:
        self._stream.parent.mkdir(parents=True, exist_ok=True)
        for path in (self._stream, self._parquet):
            if path.exists() and not overwrite:
                raise InputError(f"{path}: already exists; must be a folder without a recording")
            if overwrite:
                path.unlink(missing_ok=True)

    def _finish(self, complete: bool, reason: str | None) -> None:
        try:
            self.flush()
        except SimulationError as error:
            with suppress(SimulationError):  # a short message may fit where the rows did not
                self._mark_end(complete=False, reason=str(error))
            raise
        self._mark_end(complete, reason)
        try:
            storage.convert_to_parquet(self._stream, self._parquet)
            self._stream.unlink()
        except (OSError, InputError) as error:
            raise self._failure(error) from error

    def _mark_end(self, complete: bool, reason: str | None) -> None:
        state = {"complete": complete, "reason": reason}
        self._error = None
        self._write(storage.serialize_end(self._schema, state))

    def _write(self, message: Any) -> None:
        """Append one message to the stream, completely or not at all."""
        rest = memoryview(message)
        size = self._size + len(rest)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except BaseException as error:
            with suppress(OSError):
                self._file.truncate(self._size)
                self._file.seek(self._size)
            if not isinstance(error, OSError):
                raise
            self._error = self._failure(error)
            raise self._error from error
        self._size = size

    def _failure(self, error: Exception) -> SimulationError:
        why = getattr(error, "strerror", None) or str(error)
        return SimulationError(
            f"{self._stream}: recording failed after {self._saved} rows, which are kept: {why}; "
            "free some space or choose another folder"
        )
