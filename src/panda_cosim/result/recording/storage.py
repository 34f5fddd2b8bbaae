"""Files of a recording: an Arrow stream while it grows, a Parquet file when it is complete.

Both hold one column per scalar, float64 unless an FMU has another type, with unit and description
in the column's metadata, and a JSON text under `METADATA_KEY` in the schema's metadata. Only this
module and `reference` use pyarrow; functions import it, since it takes 0.1 s that
`panda-cosim --help` should not spend.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike

from ...assets.fields import Array
from ...fmus.atomic import replacing
from ...fmus.errors import InputError, excerpt, one_line
from ...fmus.interface.variables import address
from ...fmus.reading import finite_number
from ...task.files import read_integer

Metadata = dict[str, Any]
Blocks = Callable[[Sequence[str]], Iterator[list[Array]]]  # named columns in blocks of rows

FORMAT = 1  # of the recording; one of another number cannot be read
STREAM_FILE = "recording.arrows"
PARQUET_FILE = "recording.parquet"
METADATA_KEY = b"panda_cosim"
_NOTES = (b"unit", b"description", b"nominal")  # metadata of a column
BLOCK_ROWS = 16_384  # of a Parquet row group: 20 MB in memory at 150 columns
# Types of columns, as Arrow names them, and NumPy's.
TYPES: Final[dict[str, DTypeLike]] = {
    "double": np.float64, "float": np.float32, "bool": np.bool_, "string": object, "binary": object,
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}  # fmt: skip
TEXTS: Final = ("string", "binary")
REALS: Final = ("double", "float")  # all else is held from row to row
LATE: Final = ("row_times", "row_ends", "engine")  # metadata that a run's end may change
NO_END = "it has no end mark: the process was killed, the disk was full, or it is still running"


@dataclass(frozen=True)
class Column:
    """A scalar signal: `name` such as `plant.qpos[1]`, its `unit` and what it is."""

    name: str
    unit: str = ""
    description: str = ""
    type: str = "double"  # Arrow's name of one of `TYPES`
    nominal: float | None = None  # size of usual values, in the unit; None: not declared


def addresses(columns: Iterable[Column]) -> dict[str, str]:
    """Names of columns by the addresses in their descriptions, such as `plant.lift.pos`."""
    numbers = (c for c in columns if c.type not in TEXTS)
    found = {(c.name.rpartition(".")[0], address(c.description)): c.name for c in numbers}
    return {".".join(place): name for place, name in found.items() if place[1]}


@dataclass(frozen=True)
class Source:
    """A recording's data, in a file or in memory."""

    columns: tuple[Column, ...]
    metadata: Metadata  # scenario, versions, parameters and so on
    rows: int
    blocks: Blocks


def in_one_block(column: Callable[[str], Array]) -> Blocks:
    """Return what reads columns in blocks of rows, of which there is one."""
    return lambda names: iter([[column(name) for name in names]])


def literal(path: Path) -> str:
    """Return a path that pyarrow takes literally; it would expand a `~` at the start."""
    return str(path.absolute())


def make_schema(columns: Sequence[Column], metadata: Mapping[str, object]) -> Any:
    """Return the Arrow schema of the columns."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    fields = [
        pa.field(each.name, pa.type_for_alias(each.type), nullable=False, metadata=_notes(each))
        for each in columns
    ]
    return pa.schema(fields, metadata={METADATA_KEY: json.dumps(metadata)})


def _notes(column: Column) -> dict[str, str]:
    """Return the metadata of a column."""
    notes = {"unit": column.unit, "description": column.description, "nominal": column.nominal}
    return {name: str(value) for name, value in notes.items() if value is not None}


def serialize_end(schema: Any, state: Mapping[str, object]) -> Any:
    """Return the stream's last message: no rows, and `state` as its metadata."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        empty = make_batch(schema, np.empty((len(schema), 0)))
        writer.write_batch(empty, custom_metadata={METADATA_KEY: json.dumps(state)})
    # A new stream starts with the schema, which ours already has at its start.
    return sink.getvalue().slice(schema.serialize().size)


def write_parquet(source: Source, parquet: Path) -> None:
    """Write a recording's rows and metadata as Parquet."""
    schema = make_schema(source.columns, source.metadata)
    doubles = [column.name for column in source.columns if column.type == "double"]
    with parquet_writer(parquet, schema, doubles) as writer:
        for block in source.blocks(schema.names):
            writer.write_batch(make_batch(schema, block), row_group_size=BLOCK_ROWS)


@contextmanager
def parquet_writer(
    path: Path, schema: Any, numbers: Sequence[str], **options: object
) -> Iterator[Any]:
    """Yield what writes a Parquet file, which replaces another once it is whole and on disk."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    try:
        with replacing(path) as partial, partial.open("wb") as file:
            with pq.ParquetWriter(
                file,
                schema,
                compression="zstd",
                use_dictionary=False,
                use_byte_stream_split=numbers,  # groups exponents: the file is a quarter smaller
                write_statistics=False,
                write_page_checksum=True,  # detects flipped bits
                **options,
            ) as writer:
                yield writer
            file.flush()
            os.fsync(file.fileno())
    except pa.ArrowException as error:
        raise OSError(str(error)) from error


@contextmanager
def _reading(path: Path, problem: str) -> Iterator[None]:
    """Say what is wrong with a file that cannot be read."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    try:
        yield
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        raise InputError(f"{path}: {problem}: {one_line(error)}") from error


def open_stream(path: Path) -> Source:
    """Open an Arrow stream: all complete batches, without an incomplete one at its end."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    with _reading(path, "is not an Arrow stream"):
        # Memory-mapped, so that only the headers of batches are read from disk here.
        reader = pa.ipc.open_stream(pa.memory_map(literal(path)))
    columns, metadata = read_schema(path, reader.schema)
    state: Metadata = {"complete": False, "reason": NO_END}
    batches = rows = 0
    with suppress(pa.ArrowException, OSError, ValueError, StopIteration):
        while True:
            batch, custom = reader.read_next_batch_with_custom_metadata()
            batch.validate(full=True)
            if any(column.null_count for column in batch.columns):
                break
            if custom and METADATA_KEY in custom:
                end = json.loads(custom[METADATA_KEY])
                state |= {key: end[key] for key in (*state, *LATE) if key in end}
                break
            batches, rows = batches + 1, rows + batch.num_rows

    def tables(_: Sequence[str]) -> Iterator[Any]:
        pending: list[Any] = []
        # Not memory-mapped: the pages would stay in memory, 4 GB for an hour.
        with pa.OSFile(literal(path)) as file:
            reader = pa.ipc.open_stream(file)
            for number in range(1, batches + 1):
                pending.append(reader.read_next_batch())
                if number == batches or sum(map(len, pending)) >= BLOCK_ROWS:
                    yield pa.Table.from_batches(pending)
                    pending = []

    return Source(columns, metadata | state, rows, partial(_blocks, path, tables))


def _blocks(
    path: Path, tables: Callable[[Sequence[str]], Iterator[Any]], names: Sequence[str]
) -> Iterator[list[Array]]:
    """Yield the named columns of a file's tables, which have about `BLOCK_ROWS` rows each."""
    with _reading(path, "is damaged"):
        for table in tables(names):
            yield [values_of(table.column(name).combine_chunks()) for name in names]


def open_parquet(path: Path) -> Source:
    """Open a complete recording."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    with _reading(path, f"must be a run's folder or its {PARQUET_FILE}, whole"):
        file = pq.ParquetFile(literal(path), page_checksum_verification=True)
        schema = file.schema_arrow
    columns, metadata = read_schema(path, schema)
    groups = [file.metadata.row_group(number).num_rows for number in range(file.num_row_groups)]
    is_short = len(groups) == 1 and groups[0] <= BLOCK_ROWS
    kept = cache(file.read_row_group)

    def tables(names: Sequence[str]) -> Iterator[Any]:
        for number, rows in enumerate(groups):
            # A short run is read once, and kept.
            table = kept(0) if is_short else file.read_row_group(number, list(names))
            if any(len(table.column(name)) != rows for name in names):
                raise ValueError(f"a column does not have {rows} rows")
            yield table

    return Source(columns, metadata, sum(groups), partial(_blocks, path, tables))


def read_cells(path: Path) -> dict[str, list[Any]]:
    """Return the columns of any Parquet file."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    with _reading(path, "cannot be read"):
        return dict(pq.ParquetFile(literal(path)).read().to_pydict())


def make_batch(schema: Any, values: Array | Sequence[Array]) -> Any:
    """Return columns as a batch of rows of a schema."""
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    # Made from buffers, since pa.array() copies, and imports pandas.
    arrays = []
    for field, column in zip(schema, values, strict=True):
        name = str(field.type)
        if name in TEXTS:
            arrays.append(pa.array(column.tolist(), field.type))
            continue
        numbers = np.ascontiguousarray(column, dtype=TYPES[name])
        if name == "bool":
            numbers = np.packbits(numbers, bitorder="little")
        buffers = [None, pa.py_buffer(numbers)]
        arrays.append(pa.Array.from_buffers(field.type, len(column), buffers))
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def values_of(column: Any) -> Array:
    """Return an Arrow array's values; its own to_numpy() would import pandas, which takes 0.4 s."""
    name = str(column.type)
    if name in TEXTS:
        texts = np.empty(len(column), object)
        texts[:] = column.to_pylist()
        return texts
    return np.asarray(np.from_dlpack(column.cast("uint8") if name == "bool" else column),
                      dtype=read_type(name))  # fmt: skip


def type_of_rows(columns: Sequence[Column]) -> DTypeLike:
    """Return float64 if that holds the values of all columns."""
    return np.float64 if {read_type(c.type) for c in columns} == {np.float64} else object


def read_type(name: str) -> DTypeLike:
    """Return the type in which a column is read: float64 if that holds all of its values."""
    return TYPES[name] if name in ("int64", "uint64", *TEXTS) else np.float64


def read_schema(path: Path, schema: Any) -> tuple[tuple[Column, ...], Metadata]:
    """Check a recording's schema, and return its columns and metadata."""
    text = (schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        raise InputError(f"{path}: is not a recording of panda-cosim: its metadata is missing")
    with _reading(path, "is damaged"):
        metadata = dict(json.loads(text, parse_int=read_integer))
        columns = tuple(map(_read_column, schema))
    version = metadata.get("format")
    if version != FORMAT:
        raise InputError(f"{path}: format {excerpt(version)}; must be {FORMAT}")
    return columns, metadata


def _read_column(field: Any) -> Column:
    notes = field.metadata or {}
    unit, description, nominal = (notes.get(k, b"").decode("utf-8", "replace") for k in _NOTES)
    return Column(field.name, unit, description, str(field.type), finite_number(nominal))
