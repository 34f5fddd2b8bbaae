"""Files of a recording: an Arrow stream while it grows, a Parquet file when it is complete.

Both hold one float64 column per scalar, with unit and description in the column's metadata, and a
JSON text under `METADATA_KEY` in the schema's metadata. Only this module and `reference` use
pyarrow; functions import it, since it takes 0.1 s that `panda-cosim --help` should not spend.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import one_line
from ..files import read_integer

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

Array = NDArray[np.float64]
Metadata = dict[str, Any]

FORMAT = 1  # of the recording; one of another number cannot be read
STREAM_FILE = "recording.arrows"
PARQUET_FILE = "recording.parquet"
PARTIAL_FILE = f"{PARQUET_FILE}.part"  # while the one is made of the other
METADATA_KEY = b"panda_cosim"
BLOCK_ROWS = 16_384  # of a Parquet row group: 20 MB in memory at 150 columns
NO_END = "it has no end mark: the process was killed, the disk was full, or it is still running"


@dataclass(frozen=True)
class Column:
    """A scalar signal: `name` such as `plant.qpos[1]`, its `unit` and what it is."""

    name: str
    unit: str = ""
    description: str = ""


class BlockReader(Protocol):
    """A recording's data, read on demand.

    Attributes:
        columns: All columns, in the file's order.
        metadata: Scenario, versions, parameters and so on.
    """

    columns: tuple[Column, ...]
    metadata: Metadata

    @property
    def rows(self) -> int:
        """Number of rows."""
        ...

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns in blocks of rows, in the order of time."""
        ...


def literal(path: Path) -> str:
    """Return a path that pyarrow takes literally; it would expand a `~` at the start.

    Raises:
        InputError: The path is not UTF-8, so that pyarrow could not open it.
    """
    text = str(path.absolute())
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(f"{text}: is not UTF-8; must be, for a recording") from None
    return text


def distinct(columns: Sequence[Column]) -> list[Column]:
    """Make the columns' names distinct: `a.b` of FMU `x` and `b` of FMU `x.a` would be equal."""
    taken: set[str] = set()
    found = []
    for column in columns:
        name, count = column.name, 1
        while name in taken:
            count += 1
            name = f"{column.name} ({count})"
        taken.add(name)
        found.append(replace(column, name=name))
    return found


def make_schema(columns: Sequence[Column], metadata: Mapping[str, Any]) -> Any:
    """Return the Arrow schema of the columns."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    fields = [
        pa.field(
            column.name,
            pa.float64(),
            nullable=False,
            metadata={"unit": column.unit, "description": column.description},
        )
        for column in columns
    ]
    return pa.schema(fields, metadata={METADATA_KEY: json.dumps(metadata)})


def serialize_rows(schema: Any, values: Array) -> Any:
    """Return the stream's message with these rows. `values` has shape (columns, rows)."""
    return _make_batch(schema, values).serialize()


def serialize_end(schema: Any, state: Mapping[str, Any]) -> Any:
    """Return the stream's last message: no rows, and `state` as its metadata."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        empty = _make_batch(schema, np.empty((len(schema), 0)))
        writer.write_batch(empty, custom_metadata={METADATA_KEY: json.dumps(state)})
    # A new stream starts with the schema, which ours already has at its start.
    return sink.getvalue().slice(schema.serialize().size)


def convert_to_parquet(stream: Path, parquet: Path) -> None:
    """Write a stream's rows and metadata as Parquet, and keep the stream.

    Raises:
        OSError: The disk is full or not writable; `parquet` is then unchanged.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to import
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    source = StreamSource(stream)
    names = [column.name for column in source.columns]
    schema = make_schema(source.columns, source.metadata)
    partial = parquet.with_name(PARTIAL_FILE)
    try:
        with (
            partial.open("wb") as file,
            pq.ParquetWriter(
                file,
                schema,
                compression="zstd",
                use_dictionary=False,
                use_byte_stream_split=True,  # groups exponents: the file is a quarter smaller
                write_statistics=False,
                write_page_checksum=True,  # detects flipped bits
            ) as writer,
        ):
            for block in source.blocks(names):
                writer.write_batch(_make_batch(schema, block), row_group_size=BLOCK_ROWS)
        with partial.open("rb+") as written:
            os.fsync(written.fileno())  # before the stream is deleted
        partial.replace(parquet)
    except pa.ArrowException as error:
        raise OSError(str(error)) from error
    finally:
        partial.unlink(missing_ok=True)


def lock(file: BinaryIO | FileIO | int, *, wait: bool = False) -> bool:
    """Mark a stream or a folder as being written while it is open in this process.

    Args:
        file: The stream, or the folder's descriptor.
        wait: Wait for others, who only look whether it is marked.

    Returns:
        False if another process is writing it.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def is_being_written(stream: Path) -> bool:
    """Whether a run in progress is writing this stream."""
    with stream.open("rb") as file:
        return not lock(file)


def remove_left_behind(folder: Path) -> None:
    """Remove what a run that was killed at its end has left of its Parquet file.

    Its rows are in the stream, which a run keeps locked until it has made the file.
    """
    partial = folder / PARTIAL_FILE
    if fcntl is None or not partial.exists():
        return
    # OSError: the run goes on, the file system has no locks, or the folder is only to be read.
    with suppress(OSError), (folder / STREAM_FILE).open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        partial.unlink()


class StreamSource:
    """All complete batches of an Arrow stream, without an incomplete one at its end.

    Raises:
        InputError: The file is not a recording, or of another version.
    """

    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # noqa: PLC0415 - slow to import

        self._path = path
        self._batches = 0
        self.rows = 0
        if not path.stat().st_size:
            raise InputError(f"{path}: is empty: its run was killed at once, or has just begun")
        try:
            # Memory-mapped, so that only the headers of batches are read from disk here.
            reader = pa.ipc.open_stream(pa.memory_map(literal(path)))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{path}: is not an Arrow stream: {one_line(str(error))}") from error
        self.columns, self.metadata = _read_schema(path, reader.schema)
        self.metadata |= {"complete": False, "reason": NO_END}
        with suppress(pa.ArrowException, OSError, ValueError, StopIteration):
            while not self._scan_batch(reader):
                pass

    def _scan_batch(self, reader: Any) -> bool:
        """Check and count one batch; return whether it is the end mark."""
        batch, custom = reader.read_next_batch_with_custom_metadata()
        batch.validate(full=True)
        if any(column.null_count for column in batch.columns):
            raise ValueError("a value is missing")
        if not custom or METADATA_KEY not in custom:
            self._batches += 1
            self.rows += batch.num_rows
            return False
        state = json.loads(custom[METADATA_KEY])
        self.metadata |= {key: state[key] for key in ("complete", "reason") if key in state}
        return True

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns in blocks of about `BLOCK_ROWS` rows.

        Raises:
            InputError: The file has been changed since it was opened.
        """
        pending: list[list[Array]] = []
        for batch in self._read_batches():
            pending.append([_values(batch.column(name)) for name in names])
            if sum(len(parts[0]) for parts in pending) >= BLOCK_ROWS:
                yield [np.concatenate(parts) for parts in zip(*pending, strict=True)]
                pending = []
        if pending:
            yield [np.concatenate(parts) for parts in zip(*pending, strict=True)]

    def _read_batches(self) -> Iterator[Any]:
        import pyarrow as pa  # noqa: PLC0415 - slow to import

        try:
            # Not memory-mapped: the pages would stay in memory, 4 GB for an hour.
            with pa.OSFile(literal(self._path)) as file:
                reader = pa.ipc.open_stream(file)
                for _ in range(self._batches):
                    yield reader.read_next_batch()
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{self._path}: is damaged: {one_line(str(error))}") from error


class ParquetSource:
    """A complete recording.

    Raises:
        InputError: The file is damaged, not a recording, or of another version.
    """

    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # noqa: PLC0415 - slow to import
        import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

        self._path = path
        try:
            self._file = pq.ParquetFile(literal(path), page_checksum_verification=True)
            schema = self._file.schema_arrow
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            if isinstance(error, OSError) and error.strerror:
                raise InputError(f"{path}: cannot be read: {error.strerror}") from error
            raise InputError(
                f"{path}: is not a whole recording; must be a run's folder or its {PARQUET_FILE}"
            ) from error
        self.columns, self.metadata = _read_schema(path, schema)
        self.rows = self._file.metadata.num_rows

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns, one row group after the other.

        Raises:
            InputError: The data is damaged.
        """
        import pyarrow as pa  # noqa: PLC0415 - slow to import

        rows = 0
        for group in range(self._file.num_row_groups):
            try:
                table = self._read(group, names)
                block = [_values(table.column(name).combine_chunks()) for name in names]
            except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
                raise InputError(f"{self._path}: is damaged: {one_line(str(error))}") from error
            if any(len(column) != len(block[0]) for column in block):
                raise InputError(f"{self._path}: is damaged: its columns differ in length")
            rows += len(block[0]) if block else 0
            yield block
        if names and rows != self.rows:
            raise InputError(f"{self._path}: is damaged: has {rows} of {self.rows} rows")

    def _read(self, group: int, names: Sequence[str]) -> Any:
        """Return a row group; the only one of a short run is read once, and kept."""
        if self._file.num_row_groups > 1 or self._file.metadata.row_group(0).num_rows > BLOCK_ROWS:
            return self._file.read_row_group(group, columns=list(names))
        return self._only_group

    @cached_property
    def _only_group(self) -> Any:
        return self._file.read_row_group(0)


def _make_batch(schema: Any, values: Array | Sequence[Array]) -> Any:
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    # Made from buffers, since pa.array() copies, and imports pandas.
    arrays = [
        pa.Array.from_buffers(pa.float64(), len(column), [None, pa.py_buffer(column)])
        for column in values
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _values(column: Any) -> Array:
    """Return an Arrow array's values; its own to_numpy() would import pandas, which takes 0.4 s."""
    return np.asarray(np.from_dlpack(column), dtype=np.float64)


def _read_schema(path: Path, schema: Any) -> tuple[tuple[Column, ...], Metadata]:
    """Check a recording's schema, and return its columns and metadata."""
    text = (schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        raise InputError(f"{path}: is not a recording of panda-cosim: its metadata is missing")
    try:
        metadata = json.loads(text, parse_int=read_integer)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: metadata is not JSON: {one_line(str(error))}") from None
    if not isinstance(metadata, dict):
        raise InputError(f"{path}: metadata is not a JSON object")
    try:
        return tuple(_read_column(path, field) for field in schema), metadata
    except UnicodeDecodeError:
        raise InputError(f"{path}: is damaged: a column's name is not UTF-8") from None


def _read_column(path: Path, field: Any) -> Column:
    if str(field.type) != "double":
        raise InputError(f"{path}: column {field.name!a}: type {field.type}; must be double")
    notes = field.metadata or {}
    unit, description = (
        notes.get(key, b"").decode("utf-8", "replace") for key in (b"unit", b"description")
    )
    return Column(field.name, unit, description)
