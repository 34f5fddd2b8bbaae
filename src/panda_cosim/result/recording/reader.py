"""Reads recordings, `recording.parquet` or the `recording.arrows` of a run that was killed."""

from __future__ import annotations

import csv
import hashlib
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from itertools import chain, islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...fmus.atomic import check_replaceable, replacing
from ...fmus.errors import InputError, did_you_mean, excerpt, one_line
from ...fmus.extras import needing
from ...task.typed import typed
from .storage import (
    PARQUET_FILE,
    REALS,
    STREAM_FILE,
    TEXTS,
    Column,
    Metadata,
    Source,
    addresses,
    in_one_block,
    open_parquet,
    open_stream,
    read_type,
)

_INDEXED = re.compile(r"(?P<signal>.+)\[(?P<indices>[1-9]\d{0,5}(,[1-9]\d{0,5})*)\]", re.A)


@typed
class Recording:
    """A recording; columns are read from disk when they are used.

    `open` makes one of a run's folder or file, and a recorder one of what it holds in memory.
    Signals are indexed by name, all rows at once: `recording["plant.qpos"]` has shape (n, 16),
    `recording["plant.jac"]` (n, 6, 7), `recording["plant.qpos[1]"]` (n,). For all rows of a long
    run, `in_blocks` and `by_rows` take less memory.

    Attributes:
        path: The file.
        columns: Names of all columns of numbers, such as `plant.qpos[1]`.
        texts: Names of the columns of text (str) and bytes, if FMUs have such outputs.
        units: Unit of each column of numbers.
        types: Type of each column, as Arrow names it.
        nominals: Nominal value of each column that declares one, in its unit.
        descriptions: Description of each column.
        addresses: Columns by the short names of models' elements, such as `plant.lift.pos`.
        metadata: Scenario, versions, parameters and so on.
    """

    def __init__(self, path: Path, source: Source) -> None:
        self.path = path
        self.metadata = source.metadata
        self.types = {column.name: column.type for column in source.columns}
        self.texts = tuple(name for name, kind in self.types.items() if kind in TEXTS)
        self.units = {c.name: c.unit for c in source.columns if c.type not in TEXTS}
        self.columns = tuple(self.units)
        self.nominals = {c.name: c.nominal for c in source.columns if c.nominal is not None}
        self._types = {name: read_type(kind) for name, kind in self.types.items()}
        self.descriptions = {column.name: column.description for column in source.columns}
        self.addresses = addresses(source.columns)
        self._source = source
        if self.columns[:1] != ("time",):
            raise InputError(f"{path}: the first column is not time")
        self._shapes = shapes_of(self.columns) | shapes_of(self.texts)

    @classmethod
    def open(cls, path: str | Path, *, in_order: bool = False) -> Self:
        """Open a recording: a run's folder, a Parquet file, or an interrupted Arrow stream.

        Args:
            path: The recording.
            in_order: Refuse one whose time does not increase, which no plot can show.

        Raises:
            InputError: There is no recording, it is damaged, or of another version.
        """
        given = Path(path)
        names = [PARQUET_FILE, STREAM_FILE]
        files = [given / name for name in names] if given.is_dir() else [given]
        file = next(filter(Path.is_file, files), None)
        if file is None:
            raise InputError(f"{given}: must be a recording or its folder")
        read = open_stream if file.suffix == Path(STREAM_FILE).suffix else open_parquet
        recording = cls(file, read(file))
        if in_order:
            recording.check_time()
        return recording

    @classmethod
    def of_columns(
        cls,
        columns: Mapping[str, Array],
        metadata: Metadata,
        units: Mapping[str, str] | None = None,
        *,
        path: Path = Path(),
    ) -> Self:
        """Make one of real numbers in memory, each column (n,), `time` the first."""
        listed = tuple(Column(name, (units or {}).get(name, "")) for name in columns)
        blocks = in_one_block(columns.__getitem__)
        return cls(path, Source(listed, metadata, len(columns["time"]), blocks))

    @property
    def complete(self) -> bool:
        """Whether the run was completed."""
        return self.metadata.get("complete") is True

    @property
    def reason(self) -> str | None:
        """Why the run was not completed, or None."""
        reason = self.metadata.get("reason")
        return None if reason is None else one_line(str(reason))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._source.rows

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals, without indices."""
        return tuple(self._shapes)

    @property
    def time(self) -> Array:
        """Instant of each row, shape (n,) [s]."""
        return self["time"]

    def __getitem__(self, name: str) -> Array:
        """Return a signal or one of its elements, first axis the rows.

        It is of type float64, or of int64, uint64 or object (str, bytes) if a float64 cannot hold
        its values.

        Raises:
            InputError: There is no such signal, or the data is damaged.
        """
        names = self.elements(name)
        values, row = np.empty((self.rows, len(names)), self._types[names[0]]), 0
        for block in self._source.blocks(names):  # no more than one beside the result
            end = row + len(block[0])
            values[row:end].T[:] = block
            row = end
        return values.reshape(len(values), *self._shapes.get(name, ()))

    def __contains__(self, name: object) -> bool:
        """Whether there is a signal or element of that name."""
        return name in self._shapes or name in self._types or name in self.addresses

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the signals."""
        return iter(self._shapes)

    def __repr__(self) -> str:
        """Describe the recording in one line."""
        state = "complete" if self.complete else f"incomplete: {self.reason}"
        return f"<Recording {self.path}: {self.rows} rows, {len(self.columns)} columns, {state}>"

    def is_real(self, name: str) -> bool:
        """Whether a column is of real numbers; others keep their value from row to row."""
        return self.types[name] in REALS

    def sha256(self) -> str:
        """Return the SHA-256 of all values, column by column; the same bits, the same."""
        content = hashlib.sha256()
        for name in (*self.columns, *self.texts):
            for (values,) in self._source.blocks([name]):
                content.update(bits(values.astype(self._types[name], copy=False)))
        return content.hexdigest()

    def in_blocks(self, *names: str, before: int = 0) -> Iterator[list[Array]]:
        """Yield signals block by block, each (k, ...).

        All blocks but the first begin with so many rows of the one before. The only block of a
        recording without rows is empty.
        """
        columns = [self.elements(name) for name in names]
        ends = [np.empty((0, *self._shapes.get(name, ()))) for name in names]
        flat = list(chain.from_iterable(columns))
        for block in self._source.blocks(flat) if self.rows else [[np.empty(0)] * len(flat)]:
            parts = iter(block)
            stacks = [np.column_stack(list(islice(parts, len(each)))) for each in columns]
            signals = [
                np.concatenate((end, stack.reshape(-1, *end.shape[1:])))
                for end, stack in zip(ends, stacks, strict=True)
            ]
            ends = [signal[len(signal) - before :] for signal in signals]
            yield signals

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write all rows as CSV (RFC 4180), in full precision.

        Raises:
            InputError: The file exists or cannot be written.
        """
        path = Path(path)
        check_replaceable(path, overwrite=overwrite)
        with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)  # writes floats exactly, as repr()
            names = (*self.columns, *self.texts)
            writer.writerow(names)
            for block in self._source.blocks(names):
                columns = (map(cell, values.tolist()) for values in block)
                writer.writerows(zip(*columns, strict=True))

    def to_mat(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write all rows as a MAT file of level 5, which MATLAB and Octave load.

        Each signal is a variable, `plant.qpos` as `plant_qpos` (n, 16), texts are cells. The cell
        array `signals` has variable, signal, unit and description, a row for each.

        Raises:
            InputError: The file exists or cannot be written.
        """
        from scipy.io import savemat  # noqa: PLC0415 - slow to import

        path = Path(path)
        check_replaceable(path, overwrite=overwrite)
        variables, rows = {"signals": np.empty((0, 4), object)}, []
        for signal in self:
            name, values = _matlab_name(signal, variables), self[signal]
            is_text = values.dtype == object
            variables[name] = np.vectorize(cell, [object])(values) if is_text else values
            columns = self.elements(signal)
            units = dict.fromkeys(filter(None, (self.units.get(each) for each in columns)))
            rows.append((name, signal, ", ".join(units), self.descriptions[columns[0]]))
        variables["signals"] = np.array(rows, object)
        with replacing(path) as partial:
            savemat(partial, variables, appendmat=False, do_compression=True, oned_as="column")

    def to_pandas(self, signals: Sequence[str] | None = None) -> Any:
        """Return a pandas.DataFrame with one column per scalar, indexed by time [s].

        `attrs` holds units and descriptions by column; its own `to_xarray` makes a dataset of it.

        Args:
            signals: Signals to include; None: all.

        Raises:
            InputError: pandas is not installed.
            InputError: There is no such signal.
        """
        with needing("pandas", "notebook", "this table"):
            pandas = import_module("pandas")
        names = [name for signal in signals or self.signals for name in self.elements(signal)]
        index = pandas.Index(self.time, name="time")
        frame = pandas.DataFrame({name: self[name] for name in names if name != "time"}, index)
        frame.attrs["units"] = {name: self.units.get(name, "") for name in frame.columns}
        frame.attrs["descriptions"] = {name: self.descriptions[name] for name in frame.columns}
        return frame

    def elements(self, name: str) -> list[str]:
        """Return the columns of a signal, or the one column of that name."""
        name = self.addresses.get(name, name)
        shape = self._shapes.get(name)
        if shape is None and name not in self._types:
            hint = did_you_mean(name, (*self.signals, *self.columns))
            raise InputError(f"{self.path}: no signal {excerpt(name)}{hint}")
        if not shape:
            return [name]
        indices = (np.array(index) + 1 for index in np.ndindex(*shape))
        return [f"{name}[{','.join(map(str, index))}]" for index in indices]

    def check_time(self) -> None:
        """Refuse instants that do not increase."""
        time = self.time
        wrong = ~np.isfinite(time)
        wrong[1:] |= ~(time[1:] > time[:-1])
        if wrong.any():
            row = int(wrong.argmax())
            value = f"value {time[row]} in row {row + 1}"
            raise InputError(f"{self.path}: time: {value}; must increase from row to row")


def by_rows(
    recording: Recording, function: Callable[..., NDArray[Any]], *names: str, before: int = 0
) -> NDArray[Any]:
    """Return what a function computes of each row of signals; no signal is whole in memory."""
    # With `before`, the function also gets so many rows before each block but the first.
    blocks = recording.in_blocks(*names, before=before)
    return np.concatenate([function(*signals) for signals in blocks])


def run_names(recordings: Sequence[Recording]) -> list[str]:
    """Return names of runs: those of their folders, or the whole paths if two are alike."""
    files = (recording.path for recording in recordings)
    paths = [f.parent if f.name in (PARQUET_FILE, STREAM_FILE) else f for f in files]
    names = [path.resolve().name for path in paths]
    return names if len({*names}) == len(names) else [*map(str, paths)]


def bits(values: Array) -> Any:
    """Return the bits of a column's values, for digests; each text follows its length."""
    if values.dtype != object:
        return np.ascontiguousarray(values).data
    texts = [text.encode() if isinstance(text, str) else text for text in values]
    return b"".join(len(text).to_bytes(8, "little") + text for text in texts)


def cell(value: object) -> object:
    """Return a value as tables have it; bytes are hexadecimal digits."""
    return value.hex() if isinstance(value, bytes) else value


def _matlab_name(signal: str, taken: Collection[str]) -> str:
    """Return a name for a variable in MATLAB: a letter, then letters, digits and _, 63 in all."""
    bare = re.sub(r"\W", "_", signal, flags=re.A)
    name = (bare if bare[:1].isalpha() else f"x{bare}")[:60]
    numbers = (f"{name}_{number}" for number in range(2, 100))
    return next(each for each in (name, *numbers) if each not in taken)


@lru_cache(maxsize=16)  # runs of a sweep have the same columns
def shapes_of(columns: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    """Return each signal's shape, from its elements' indices, which start at 1."""
    # Columns of no complete array (`x[3]` alone, `y` beside `y[1]`) are signals of their own.
    elements: dict[str, dict[str, tuple[int, ...]]] = {}
    for column in columns:
        match = _INDEXED.fullmatch(column)
        signal, indices = (match["signal"], match["indices"].split(",")) if match else (column, [])
        elements.setdefault(signal, {})[column] = tuple(map(int, indices))
    shapes: dict[str, tuple[int, ...]] = {}
    for signal, indices_by_column in elements.items():
        shape = _shape(list(indices_by_column.values()))
        if shape and signal in columns:  # `y[1]` beside `y[1][1]`
            shape = None
        shapes |= {signal: shape} if shape is not None else dict.fromkeys(indices_by_column, ())
    return shapes


def _shape(indices: Sequence[tuple[int, ...]]) -> tuple[int, ...] | None:
    """Return the shape of the array with exactly these elements, or None if there is none."""
    if len({len(index) for index in indices}) != 1:
        return None
    shape = tuple(map(max, zip(*indices, strict=True)))
    return shape if math.prod(shape) == len(indices) else None
