"""Takes a run's rows: into a file that survives any end of the run, or into memory."""

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, SimulationError
from . import storage
from .reader import Recording
from .storage import PARQUET_FILE, STREAM_FILE, Column

Array = NDArray[np.float64]

FLUSH_INTERVAL = 0.3  # [s] wall time; the master's own delay makes it at most 0.5 s
_BUFFER_ROWS = 4096


class _Context(ABC):
    """A recording whose block ends it, as incomplete if `close` was not called."""

    @abstractmethod
    def end(self, *, complete: bool, reason: str | None = None) -> None:
        """Take no more rows; the recording can be read from memory. A second call does nothing."""

    @abstractmethod
    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording, unless it has ended, and wait for its file."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Close it; a present error says more than one of closing."""
        if error is None:
            self.close(complete=False, reason="the recording was not closed")
            return
        with suppress(SimulationError):
            self.close(complete=False, reason=f"{type(error).__name__}: {error}")


class Recorder(_Context):
    """Writes a recording; it only observes. A full disk raises SimulationError."""

    def __init__(
        self,
        folder: str | Path,
        columns: Sequence[Column],
        metadata: Mapping[str, Any],
    ) -> None:
        place = Path(folder).absolute()  # an FMU may change the working directory
        self._stream = place / STREAM_FILE
        self._parquet = place / PARQUET_FILE
        storage.literal(self._parquet)  # or it would be refused after the run
        # As a file returns it.
        kept: dict[str, Any] = json.loads(json.dumps({**metadata, "format": storage.FORMAT}))
        self._memory: MemoryRecorder | None = MemoryRecorder(place, columns, kept)
        self._buffer = np.empty((len(columns), _BUFFER_ROWS), storage.type_of_rows(columns))
        self.late: dict[str, Any] = {}  # metadata that is known only at the end, `storage.LATE`
        self._filled = 0
        self._saved = 0
        self._size = 0  # of the stream's whole messages [bytes]
        self._error: SimulationError | None = None
        self._ended = False
        self._file_made: Future[None] | None = None
        try:
            self._make_place()
            self._file = self._stream.open("xb", buffering=0)
            self._last_flush = time.monotonic()
        except (OSError, ValueError) as error:  # ValueError: a null byte in the name
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{folder}: cannot be written to: {reason}") from error
        # A thread imports pyarrow and writes the stream's head, while FMUs in C begin to step.
        head = partial(self._write_head, storage.distinct(columns), kept)
        self._head: Future[Any] = ThreadPoolExecutor(1).submit(head)

    @property
    def rows(self) -> int:
        """Number of rows appended."""
        return self._saved + self._filled

    def append(self, rows: Array) -> None:
        """Append a copy of a block of rows, shape (n, columns); flush if it is time."""
        if self._error is not None:
            raise self._error
        if self._memory is not None:
            self._memory.append(rows)
            if self._memory.rows > storage.BLOCK_ROWS:
                self._memory = None
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
        """Pass all rows to the operating system as one batch; they then survive the process."""
        self._last_flush = time.monotonic()
        if self._filled:
            rows = self._buffer[:, : self._filled]
            self._write(storage.serialize_rows(self._head.result(), rows))
            self._saved += self._filled
            self._filled = 0

    def end(self, *, complete: bool, reason: str | None = None) -> None:
        """End the stream; a thread makes the Parquet file meanwhile, which `close` waits for."""
        if self._ended:
            return
        self._ended = True
        failed_before = self._error is not None
        try:
            self._end_stream(complete, reason)
        except SimulationError:
            self._file.close()
            if not failed_before:
                raise
        else:
            self._file_made = ThreadPoolExecutor(1).submit(self._make_parquet)
            if self._memory is None:  # it is read from the file
                self._file_made.result()

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording, and return its file: Parquet, or the stream if that failed."""
        self.end(complete=complete, reason=reason)
        made, self._file_made = self._file_made, None
        if made is not None:
            made.result()
        return self._parquet if self._parquet.exists() else self._stream

    def recording(self) -> Recording | None:
        """Return what was recorded, if it is short and was written whole."""
        return None if self._memory is None else self._memory.recording()

    def _write_head(self, columns: Sequence[Column], metadata: Mapping[str, Any]) -> Any:
        """Write the stream's first message, and return its schema."""
        schema = storage.make_schema(columns, metadata)
        try:
            self._write(schema.serialize())
        except SimulationError:
            self._stream.unlink()
            raise
        return schema

    def _make_place(self) -> None:
        self._stream.parent.mkdir(parents=True, exist_ok=True)
        for path in (self._stream, self._parquet):
            if path.exists():
                raise InputError(f"{path}: already exists; must be a folder without a recording")

    def _end_stream(self, complete: bool, reason: str | None) -> None:
        try:
            self.flush()
        except SimulationError as error:
            with suppress(SimulationError):  # a short message may fit where the rows did not
                self._mark_end(complete=False, reason=str(error))
            raise
        self._mark_end(complete, reason)

    def _make_parquet(self) -> None:
        try:
            memory, stream = self._memory, self._stream
            source = memory.source() if memory is not None else storage.open_stream(stream)
            storage.write_parquet(source, self._parquet)
            self._stream.unlink()
        except (OSError, InputError) as error:
            raise self._failure(error) from error
        finally:
            self._file.close()

    def _mark_end(self, complete: bool, reason: str | None) -> None:
        if self._memory is not None:
            self._memory.late = self.late
            self._memory.end(complete=complete, reason=reason)
        state = {"complete": complete, "reason": reason, **self.late}
        schema = self._head.result()
        self._error = None
        self._write(storage.serialize_end(schema, state))

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
        self._memory = None  # the file has less
        why = getattr(error, "strerror", None) or str(error)
        return SimulationError(
            f"{self._stream}: recording failed after {self._saved} rows, which are kept: {why}; "
            "free some space or choose another folder"
        )


class MemoryRecorder(_Context):
    """Keeps a recording in memory, with the interface of `Recorder`; the folder is only named."""

    def __init__(
        self, folder: Path, columns: Sequence[Column], metadata: Mapping[str, Any]
    ) -> None:
        self._path = folder / PARQUET_FILE  # where its file would be looked for
        self._columns = storage.distinct(columns)
        self._metadata = {**metadata, "format": storage.FORMAT}
        self._values = np.empty((len(columns), 2 * _BUFFER_ROWS), storage.type_of_rows(columns))
        self.late: dict[str, Any] = {}
        self.rows = 0  # number of rows appended
        self._ended = False

    def append(self, rows: Array) -> None:
        """Append a block of rows, shape (n, columns), copied."""
        end = self.rows + len(rows)
        if end > self._values.shape[1]:
            shorter = self._values[:, : self.rows]
            self._values = np.empty((len(self._columns), 2 * end), shorter.dtype)
            self._values[:, : self.rows] = shorter
        self._values[:, self.rows : end] = rows.T
        self.rows = end

    def flush(self) -> None:
        """Do nothing: there is no file."""

    def end(self, *, complete: bool, reason: str | None = None) -> None:
        """Note the end."""
        if not self._ended:
            self._ended = True
            self._metadata |= {"complete": complete, "reason": reason, **self.late}

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording, which has no file."""
        self.end(complete=complete, reason=reason)
        return self._path.parent

    def recording(self) -> Recording:
        """Return what was recorded."""
        return Recording(self._path, self.source())

    def source(self) -> storage.Source:
        """Return what was recorded, as a recording's data."""
        values = self._values[:, : self.rows]
        by_name = {
            column.name: values[i].astype(storage.read_type(column.type), copy=False)
            for i, column in enumerate(self._columns)
        }
        blocks = partial(_one_block, by_name)
        return storage.Source(self._columns, self._metadata, self.rows, blocks)


def _one_block(columns: Mapping[str, Array], names: Sequence[str]) -> Iterator[list[Array]]:
    yield [columns[name] for name in names]


AnyRecorder = Recorder | MemoryRecorder
