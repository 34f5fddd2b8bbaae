"""Takes a run's rows: into a file that survives any end of the run, or into memory."""

import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...assets.fields import Array
from ...fmus.atomic import writing
from ...fmus.errors import InputError, SimulationError
from . import storage
from .reader import Recording
from .storage import PARQUET_FILE, STREAM_FILE, Column

FLUSH_INTERVAL = 0.3  # [s] wall time; the master's own delay makes it at most 0.5 s
_BUFFER_ROWS = 4096


class MemoryRecorder(AbstractContextManager["MemoryRecorder"]):
    """Keeps a recording in memory; the folder is only named.

    `Output` makes one for a run without files. As a context manager it ends the recording, as
    incomplete if `close` was not called.
    """

    def __init__(
        self, folder: str | Path, columns: Sequence[Column], metadata: Mapping[str, object]
    ) -> None:
        self._place = Path(folder)
        self._columns = tuple(columns)
        # As a file returns it.
        self._metadata = json.loads(json.dumps({**metadata, "format": storage.FORMAT}))
        self._values = np.empty((len(columns), _BUFFER_ROWS), storage.type_of_rows(columns))
        self._filled = 0  # rows in memory
        self._dropped = 0  # rows before these
        self._is_whole = True  # whether memory holds the recording
        self.late: storage.Metadata = {}  # what is known only at the end, `storage.LATE`
        self._ended = False

    @property
    def rows(self) -> int:
        """Number of rows appended."""
        return self._dropped + self._filled

    def append(self, rows: Array) -> None:
        """Append a block of rows, shape (n, columns), copied."""
        end = self._filled + len(rows)
        if end > self._values.shape[1]:
            shorter = self._values[:, : self._filled]
            self._values = np.empty((len(self._columns), 2 * end), shorter.dtype)
            self._values[:, : self._filled] = shorter
        self._values[:, self._filled : end] = rows.T
        self._filled = end

    def mark(self) -> tuple[int, int]:
        """Return the rows and bytes so far, for `go_back`."""
        return self.rows, 0

    def go_back(self, mark: tuple[int, int]) -> None:
        """Drop the rows after a mark."""
        self._dropped = min(self._dropped, mark[0])
        self._filled = mark[0] - self._dropped

    def end(self, *, complete: bool, reason: str | None = None) -> None:
        """Take no more rows; the recording can be read from memory. A second call does nothing."""
        if not self._ended:
            self._ended = True
            self._metadata = self._metadata | self._state(complete, reason)

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording, unless it has ended, and return its file or folder."""
        self.end(complete=complete, reason=reason)
        return self._place

    def recording(self) -> Recording | None:
        """Return what was recorded, if memory holds it."""
        if not self._is_whole:
            return None
        return Recording(self._place / PARQUET_FILE, self._source())

    def _source(self) -> storage.Source:
        by_name = {
            column.name: values[: self._filled].astype(storage.read_type(column.type), copy=False)
            for column, values in zip(self._columns, self._values, strict=True)
        }
        blocks = storage.in_one_block(by_name.__getitem__)
        return storage.Source(self._columns, self._metadata, self._filled, blocks)

    def _state(self, complete: bool, reason: str | None) -> dict[str, object]:
        return {"complete": complete, "reason": reason, **self.late}

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Close it; an error says more than one of closing."""
        reason = f"{type(error).__name__}: {error}" if error else "the recording was not closed"
        with suppress(SimulationError):
            self.close(complete=False, reason=reason)


class Recorder(MemoryRecorder):
    """Writes a recording; it only observes. A full disk raises SimulationError.

    Rows go to the stream as they come. Memory holds them, too, until they are more than a block.
    """

    def __init__(
        self, folder: str | Path, columns: Sequence[Column], metadata: Mapping[str, object]
    ) -> None:
        place = Path(folder).absolute()  # an FMU may change the working directory
        super().__init__(place, columns, metadata)
        self._stream, self._parquet = place / STREAM_FILE, place / PARQUET_FILE
        self._saved = 0  # rows in the stream
        self._size = 0  # of the stream's whole messages [bytes]
        self._error: SimulationError | None = None
        self._file_made: Future[None] | None = None
        with writing(Path(folder)):
            place.mkdir(parents=True, exist_ok=True)
            for path in filter(Path.exists, (self._stream, self._parquet)):
                raise InputError(f"{path}: already exists; must be a folder without a recording")
            self._file = self._stream.open("xb", buffering=0)
        self._last_flush = time.monotonic()
        # A thread imports pyarrow and writes the stream's head, while FMUs in C begin to step.
        self._schema: Future[Any] = ThreadPoolExecutor(1).submit(self._write_head, self._metadata)

    def append(self, rows: Array) -> None:
        """Append a copy of a block of rows, shape (n, columns); flush if it is time."""
        if self._error is not None:
            raise self._error
        super().append(rows)
        is_late = time.monotonic() - self._last_flush >= FLUSH_INTERVAL
        if is_late or self.rows - self._saved >= _BUFFER_ROWS:
            self.flush()

    def flush(self) -> None:
        """Pass all rows to the operating system as one batch; they then survive the process."""
        self._last_flush = time.monotonic()
        schema = self._schema.result()  # the head is in the file, also before the first row
        unsaved = self._values[:, self._saved - self._dropped : self._filled]
        if unsaved.size:
            self._write(storage.make_batch(schema, unsaved).serialize())
            self._saved = self.rows
        if self._filled > storage.BLOCK_ROWS:
            self._is_whole = False
            self._dropped, self._filled = self.rows, 0

    def mark(self) -> tuple[int, int]:
        """Return the rows and bytes so far, all of them in the file."""
        self.flush()
        return self.rows, self._size

    def go_back(self, mark: tuple[int, int]) -> None:
        """Drop the rows after a mark, in the file, too."""
        super().go_back(mark)
        self._saved, self._size = mark
        self._file.truncate(self._size)
        self._file.seek(self._size)

    def end(self, *, complete: bool, reason: str | None = None) -> None:
        """End the stream; a thread makes the Parquet file meanwhile, which `close` waits for."""
        if self._ended:
            return
        super().end(complete=complete, reason=reason)
        failed_before = self._error is not None
        try:
            self.flush()
            self._mark_end(complete, reason)
        except SimulationError as error:
            with suppress(SimulationError):  # a short message may fit where the rows did not
                self._mark_end(False, str(error))
            self._file.close()
            if not failed_before:
                raise
            return
        self._file_made = ThreadPoolExecutor(1).submit(self._make_parquet)
        if not self._is_whole:  # it is read from the file
            self._file_made.result()

    def close(self, *, complete: bool, reason: str | None = None) -> Path:
        """End the recording, and return its file: Parquet, or the stream if that failed."""
        self.end(complete=complete, reason=reason)
        made, self._file_made = self._file_made, None
        if made is not None:
            made.result()
        return self._parquet if self._parquet.exists() else self._stream

    def _write_head(self, metadata: storage.Metadata) -> Any:
        """Write the stream's first message, and return its schema."""
        schema = storage.make_schema(self._columns, metadata)
        try:
            self._write(schema.serialize())
        except SimulationError:
            self._stream.unlink()
            raise
        return schema

    def _mark_end(self, complete: bool, reason: str | None) -> None:
        self._error = None
        self._write(storage.serialize_end(self._schema.result(), self._state(complete, reason)))

    def _make_parquet(self) -> None:
        try:
            source = self._source() if self._is_whole else storage.open_stream(self._stream)
            storage.write_parquet(source, self._parquet)
            self._stream.unlink()
        except (OSError, InputError) as error:
            raise self._failure(error) from error
        finally:
            self._file.close()

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
        self._is_whole = False  # the file has less
        why = getattr(error, "strerror", None) or str(error)
        return SimulationError(
            f"{self._stream}: recording failed after {self._saved} rows, which are kept: {why}; "
            "free some space or choose another folder"
        )
