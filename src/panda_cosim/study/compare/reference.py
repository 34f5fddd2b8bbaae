"""Reference recordings: each is a scenario's last approved run.

`reference.parquet` lies beside the scenario and holds all recorded signals at every tick. Real ones
are rounded to a tenth of their tolerance, the quantum: int32, second differences of multiples of
it above the first value, which makes a file of some 100 kB. Others are as they were recorded. The
JSON under `METADATA_KEY` holds the quanta, the origin (versions, machine, FMUs, parameters), a
digest of every column, and the summary. Files of format 1 lack the values of some columns, and all
of texts.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ...fmus.atomic import replacing
from ...fmus.errors import InputError, excerpt, one_line
from ...result.judging.verdict import Summary
from ...result.recording import Recording
from ...result.recording.reader import bits
from ...result.recording.storage import METADATA_KEY, TEXTS, literal, make_batch, values_of
from ...task.files import as_argument
from ...task.scenario import Scenario
from ...task.tolerances import Tolerances, signal_of
from ..work import processor
from .tubes import widths

Array = NDArray[np.float64]

FORMATS: Final = (1, 2)  # that are read; the last one is written
REFERENCE_FILE: Final = "reference.parquet"
CHECKSUM_KEY: Final = b"panda-cosim.checksum"
QUANTA: Final = 10  # quanta per tolerance
_DIGEST_DIGITS = 16  # hexadecimal digits of a SHA-256; enough to exclude collisions
_LARGEST = 2**31 - 1
_KEPT = ("scenario", "coupling", "step_size", "start_time", "versions", "platform", "fmus")


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference recording, with which runs are compared."""

    rows: int  # ticks, both ends included
    step_size: float  # time between two ticks [s]
    # Makes a column (rows,), in its unit, whenever it is used; all of an hour are 2 GB.
    column: Callable[[str], Array]
    quanta: Mapping[str, float]  # rounding step of each Real, in its unit
    held: tuple[str, ...]  # columns of other types, as they were recorded
    types: Mapping[str, str]  # of every recorded column, as Arrow names it; none in format 1
    nominals: Mapping[str, float]  # of the columns that declare one, in their units
    units: Mapping[str, str]  # of every recorded column, with values or not
    digests: Mapping[str, str]  # of every recorded column's bits
    metadata: Mapping[str, Any]  # scenario, versions, machine, FMUs, parameters
    summary: Summary

    @property
    def time(self) -> Array:
        """Instant of each row (rows,) [s]."""
        start: float = self.metadata.get("start_time", 0.0)  # only a system's
        return start + self.step_size * np.arange(self.rows, dtype=np.float64)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of numbers with values. The view reads a reference as it reads a recording."""
        return (*self.quanta, *(name for name in self.held if self.types[name] not in TEXTS))

    @property
    def texts(self) -> tuple[str, ...]:
        """Columns of texts."""
        return tuple(name for name in self.held if self.types[name] in TEXTS)

    def is_real(self, name: str) -> bool:
        """Whether a column is of real numbers."""
        return name in self.quanta

    @property
    def descriptions(self) -> dict[str, str]:
        """Descriptions of columns, which a reference has none of."""
        return {}

    def __getitem__(self, name: str) -> Array:
        """Return a column (n,), or a signal's columns side by side (n, k)."""
        if name in self.quanta or name in self.held:
            return self.column(name)
        return np.column_stack(
            [self.column(each) for each in self.columns if signal_of(each) == name]
        )

    @classmethod
    def of(cls, recording: Recording, summary: Summary, tolerances: Tolerances) -> Self:
        """Make a reference from a run; values are rounded to a tenth of their tolerances."""
        _check_run(recording, summary)
        half = widths(recording, tolerances)
        if not half:
            raise InputError("the run records no signal; it cannot become a reference")
        names = ("time", *half)
        quanta = {n: width / QUANTA for n, width in half.items() if recording.is_real(n)}

        def column(name: str) -> Array:
            values, quantum = recording[name], quanta.get(name)
            if quantum is None:
                return values
            return np.asarray(values[0] + np.round((values - values[0]) / quantum) * quantum)

        return cls(
            rows=recording.rows,
            step_size=float(recording.metadata["step_size"]),
            column=column,
            quanta=quanta,
            held=tuple(name for name in half if name not in quanta),
            types={name: recording.types[name] for name in names},
            nominals=recording.nominals,
            units={name: recording.units.get(name, "") for name in names},
            digests={name: column_digest(recording[name]) for name in names},
            metadata=kept_metadata(recording),
            summary=summary,
        )

    def write(self, path: Path, recording: Recording) -> None:
        """Write the file atomically, block by block of the recording that it was made of."""
        origins = {name: float(recording[name][0]) for name in self.quanta}
        parts = (self.units, self.digests, self.types)
        text = json.dumps(
            {
                "format": FORMATS[-1],
                "rows": self.rows,
                "columns": {name: [part[name] for part in parts] for name in self.units},
                "quanta": self.quanta,
                "origins": origins,
                "nominals": self.nominals,
                "metadata": self.metadata,
                "summary": self.summary.to_dict(),
            }
        )
        with (
            replacing(path) as temporary,
            pq.ParquetWriter(
                literal(temporary),
                schema := _schema(self.quanta, {name: self.types[name] for name in self.held}),
                compression="zstd",
                compression_level=19,
                use_dictionary=False,
                use_byte_stream_split=list(self.quanta),
                write_statistics=False,
                write_page_checksum=True,
                store_schema=False,
            ) as writer,
        ):
            for columns in self._blocks(recording, origins):
                writer.write_batch(make_batch(schema, columns))
            writer.add_key_value_metadata({METADATA_KEY: text, CHECKSUM_KEY: checksum(text)})

    def _blocks(self, recording: Recording, origins: Mapping[str, float]) -> Iterator[list[Array]]:
        held = [recording[name] for name in self.held]  # not in blocks, which are of float64
        row = before = 0  # `before`: rows at the start of a block that were in the one before
        for block in recording.in_blocks("time", *self.quanta, before=2):
            columns, end = [], row + len(block[0]) - before
            for (name, quantum), values in zip(self.quanta.items(), block[1:], strict=True):
                steps = np.round((values - origins[name]) / quantum)
                differences = np.diff(np.diff(steps, prepend=0.0), prepend=0.0)[before:]
                if np.abs(differences).max(initial=0.0) > _LARGEST:
                    problem = "the tolerance is too small for its values"
                    raise InputError(f"[regression] {name}: {problem}")
                columns.append(differences)
            yield [*columns, *(values[row:end] for values in held)]
            row, before = end, 2

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a reference."""
        if not path.is_file():
            raise InputError(f"{path}: does not exist; {how_to_make(path)} makes it")
        file, description = _open(path)
        quanta, metadata = description["quanta"], description["metadata"]
        origins, columns = description.get("origins", {}), description["columns"]
        types = {name: kind for name, (_, _, *kinds) in columns.items() for kind in kinds}

        def column(name: str) -> Array:
            values = values_of(_read(file, name).combine_chunks())
            if name not in quanta:
                return values
            steps = values.astype(int).cumsum().cumsum()
            return np.asarray(origins.get(name, 0.0) + steps * quanta[name])

        return cls(
            rows=description["rows"],
            step_size=metadata["step_size"],
            column=column,
            quanta=quanta,
            held=tuple(name for name in file.schema_arrow.names if name not in quanta),
            types=types,
            nominals=description.get("nominals", {}),
            units={name: unit for name, (unit, *_) in columns.items()},
            digests={name: digest for name, (_, digest, *_) in columns.items()},
            metadata=metadata,
            summary=Summary.read(description["summary"]),
        )


def _schema(quanta: Iterable[str], held: Mapping[str, str]) -> Any:
    types = {**dict.fromkeys(quanta, "int32"), **held}
    fields = [pa.field(n, pa.type_for_alias(kind), nullable=False) for n, kind in types.items()]
    return pa.schema(fields)


def _read(file: Any, name: str) -> Any:
    return file.read([name]).column(0)


def _open(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the file and the description of a reference, if both are whole."""
    try:
        file = pq.ParquetFile(literal(path), page_checksum_verification=True)
        for name in file.schema_arrow.names:
            _read(file, name)
        notes = file.metadata.metadata or {}
        if notes[CHECKSUM_KEY].decode() != checksum(notes[METADATA_KEY].decode()):
            raise ValueError("the checksum is wrong")
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        reason = f"has no {error}" if isinstance(error, KeyError) else one_line(error)
        raise InputError(f"{path}: is not a reference: {reason}") from None
    description = json.loads(notes[METADATA_KEY])
    if description["format"] not in FORMATS:
        valid = " or ".join(map(str, FORMATS))
        raise InputError(f"{path}: format {excerpt(description['format'])}; must be {valid}")
    columns, quanta = description["columns"], description["quanta"]
    held = {n: kinds[0] for n, (_, _, *kinds) in columns.items() if kinds and n not in quanta}
    held.pop("time", None)
    is_whole = file.metadata.num_rows == description["rows"]
    if not (is_whole and file.schema_arrow == _schema(quanta, held)):
        raise InputError(f"{path}: is damaged: its columns are not those of its description")
    return file, description


def checksum(text: str) -> str:
    """Return the checksum of a reference's description; Parquet has its own for columns."""
    return hashlib.sha256(text.encode()).hexdigest()


def column_digest(values: Array) -> str:
    """Return the digest of a column's bits."""
    return hashlib.sha256(bits(values)).hexdigest()[:_DIGEST_DIGITS]


def kept_metadata(recording: Recording) -> dict[str, Any]:
    """Return the part of a recording's metadata that a reference keeps: its origin."""
    metadata = recording.metadata
    kept = {key: metadata[key] for key in _KEPT if key in metadata}
    return {**kept, "processor": processor(), "parameters": metadata.get("parameters", {})}


def _check_run(recording: Recording, summary: Summary) -> None:
    if not recording.complete:
        raise InputError("the run ended early; it cannot become a reference")
    if not summary.as_expected:
        raise InputError(f"the run cannot become a reference: {summary.brief}")
    for name in recording.columns:
        if not np.isfinite(recording[name]).all():
            raise InputError(f"{name} is not finite; the run cannot become a reference")


def how_to_make(path: Path) -> str:
    """Return the command that makes the reference of one scenario, in backticks."""
    return f"`panda-cosim regress {as_argument(path.parent)} --update`"


def reference_path(scenario: Scenario) -> Path:
    """Return where a scenario's reference is, or would be."""
    if scenario.folder is None:
        raise InputError(f"scenario {scenario.name}: has no folder, hence no reference")
    return scenario.folder / REFERENCE_FILE
