"""Files of a recording: an Arrow stream while it grows, a Parquet file when it is complete.

Both hold one float64 column per scalar, with unit and description in the column's metadata, and a
JSON text under `METADATA_KEY` in the schema's metadata. Only this module and `reference` know
pyarrow, and import it when it is first used.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import one_line

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

Array = NDArray[np.float64]
Metadata = dict[str, Any]

FORMAT = 1  # of the recording; one of another number cannot be read
STREAM_FILE = "recording.arrows"
PARQUET_FILE = "recording.parquet"
METADATA_KEY = b"panda_cosim"
BLOCK_ROWS = 16_384  # of a Parquet row group: 20 MB in memory at 150 columns
NO_END = "it has no end: its process was killed, its disk was full, or it is still running"


@dataclass(frozen=True)
class Column:
    """A scalar signal: `name` such as `plant.qpos[1]`, its `unit` and what it is."""

    name: str
    unit: str = ""
    description: str = ""


class Source(Protocol):
    """A recording's data, read when asked for.

    Attributes:
        columns: All columns, in the file's order.
        metadata: What was written beside them.
    """

    columns: tuple[Column, ...]
    metadata: Metadata

    @property
    def rows(self) -> int:
        """How many rows there are."""
        ...

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns in blocks of rows, in the order of time."""
        ...


def literal(path: Path) -> str:
    """Return a path as pyarrow takes it literally: it would expand a `~` at the start."""
    return str(path.absolute())


def distinct(columns: Sequence[Column]) -> list[Column]:
    """Return the columns with different names: `a.b` of `x` and `b` of `x.a` may be one text."""
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
    import pyarrow as pa  # noqa: PLC0415  # heavy

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
    import pyarrow as pa  # noqa: PLC0415

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        empty = _make_batch(schema, np.empty((len(schema), 0)))
        writer.write_batch(empty, custom_metadata={METADATA_KEY: json.dumps(state)})
    # What that stream starts with, the schema, stands at the start of ours already.
    return sink.getvalue().slice(schema.serialize().size)


def convert_to_parquet(stream: Path, parquet: Path) -> None:
    """Write a stream's rows and metadata as Parquet; the stream stays.

    Raises:
        OSError: The disk is full or not writable; then `parquet` is as it was.
    """
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    source = StreamSource(stream)
    names = [column.name for column in source.columns]
    schema = make_schema(source.columns, source.metadata)
    partial = parquet.with_name(parquet.name + ".part")
    try:
        with (
            partial.open("wb") as file,
            pq.ParquetWriter(
                file,
                schema,
                compression="zstd",
                use_dictionary=False,
                use_byte_stream_split=True,  # a quarter smaller: exponents lie side by side
                write_statistics=False,
                write_page_checksum=True,  # so that no flipped bit is read as a number
            ) as writer,
        ):
            for block in source.blocks(names):
                writer.write_batch(_make_batch(schema, block), row_group_size=BLOCK_ROWS)
        with partial.open("rb+") as written:
            os.fsync(written.fileno())  # before the stream goes
        partial.replace(parquet)
    except pa.ArrowException as error:
        raise OSError(str(error)) from error
    finally:
        partial.unlink(missing_ok=True)


def lock(file: BinaryIO | FileIO) -> bool:
    """Mark a stream as being written, for as long as it is open in this process.

    Returns:
        Whether nobody else is writing it.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def is_being_written(stream: Path) -> bool:
    """Tell whether a run that is still going on writes this stream."""
    with stream.open("rb") as file:
        return not lock(file)


class StreamSource:
    """All whole batches of an Arrow stream; what was cut off after them is left out.

    Raises:
        InputError: The file is not a recording, or of another version.
    """

    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # noqa: PLC0415

        self._path = path
        self._batches = 0
        self.rows = 0
        try:
            # Mapped, so that only the batches' heads are read from disk here.
            reader = pa.ipc.open_stream(pa.memory_map(literal(path)))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{path}: is not an Arrow stream: {one_line(str(error))}") from error
        self.columns, self.metadata = _read_schema(path, reader.schema)
        self.metadata |= {"complete": False, "reason": NO_END}
        with suppress(pa.ArrowException, OSError, ValueError, StopIteration):
            while not self._scan_batch(reader):
                pass

    def _scan_batch(self, reader: Any) -> bool:
        """Check and count one batch; tell whether it was the mark of the end."""
        batch, custom = reader.read_next_batch_with_custom_metadata()
        batch.validate(full=True)
        if any(column.null_count for column in batch.columns):
            raise ValueError("a number is missing")
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
            InputError: The file was changed meanwhile.
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
        import pyarrow as pa  # noqa: PLC0415

        try:
            # Read, not mapped: pages of a map would stay in memory, all 4 GB of an hour.
            with pa.OSFile(literal(self._path)) as file:
                reader = pa.ipc.open_stream(file)
                for _ in range(self._batches):
                    yield reader.read_next_batch()
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{self._path}: is damaged: {one_line(str(error))}") from error


class ParquetSource:
    """A whole recording.

    Raises:
        InputError: The file is damaged, not a recording, or of another version.
    """

    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # noqa: PLC0415
        import pyarrow.parquet as pq  # noqa: PLC0415

        self._path = path
        try:
            self._file = pq.ParquetFile(literal(path), page_checksum_verification=True)
            schema = self._file.schema_arrow
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise InputError(
                f"{path}: is not a complete Parquet file: {one_line(str(error))}"
            ) from error
        self.columns, self.metadata = _read_schema(path, schema)
        self.rows = self._file.metadata.num_rows

    def blocks(self, names: Sequence[str]) -> Iterator[list[Array]]:
        """Yield the named columns, one row group after the other.

        Raises:
            InputError: The data is damaged.
        """
        import pyarrow as pa  # noqa: PLC0415

        rows = 0
        for group in range(self._file.num_row_groups):
            try:
                table = self._file.read_row_group(group, columns=list(names))
                block = [_values(table.column(name).combine_chunks()) for name in names]
            except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
                raise InputError(f"{self._path}: is damaged: {one_line(str(error))}") from error
            if any(len(column) != len(block[0]) for column in block):
                raise InputError(f"{self._path}: is damaged: its columns differ in length")
            rows += len(block[0]) if block else 0
            yield block
        if names and rows != self.rows:
            raise InputError(f"{self._path}: is damaged: it has {rows} rows of {self.rows}")


def _make_batch(schema: Any, values: Array | Sequence[Array]) -> Any:
    import pyarrow as pa  # noqa: PLC0415

    # From buffers, not pa.array(): that one copies, and looks for pandas first.
    arrays = [
        pa.Array.from_buffers(pa.float64(), len(column), [None, pa.py_buffer(column)])
        for column in values
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _values(column: Any) -> Array:
    """Return an Arrow array's numbers. Its own to_numpy() would import pandas first: 0.4 s."""
    return np.asarray(np.from_dlpack(column), dtype=np.float64)


def _read_schema(path: Path, schema: Any) -> tuple[tuple[Column, ...], Metadata]:
    """Check that it is a recording's schema, and return what it says."""
    text = (schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        raise InputError(f"{path}: is not a recording of panda-cosim: its metadata is missing")
    try:
        metadata = json.loads(text)
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
