"""Reference recordings: each is a scenario's last approved run.

`reference.parquet` lies beside the scenario and holds the compared signals at every tick, rounded
to a tenth of their tolerance, the quantum. Each column is int32: second differences of multiples
of its quantum, which makes a file of about 100 kB. The JSON under `METADATA_KEY` holds the quanta,
the origin (versions, machine, FMUs, parameters), a digest of every recorded column, and the
summary.
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
from ..files import as_argument
from ..recording import Recording
from ..recording.storage import METADATA_KEY, literal
from ..scenario.scenario import Scenario
from ..scenario.tolerances import Tolerances, is_compared
from ..work import processor
from .differences import signal_of

Array = NDArray[np.float64]

FORMAT: Final = 1
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
    # Makes a compared column (rows,), in its unit, whenever it is used; all of an hour are 2 GB.
    column: Callable[[str], Array]
    quanta: Mapping[str, float]  # rounding step of each, in its unit
    units: Mapping[str, str]  # of every recorded column, compared or not
    digests: Mapping[str, str]  # of every recorded column's bits
    metadata: Mapping[str, Any]  # scenario, versions, machine, FMUs, parameters
    summary: Mapping[str, Any]  # content of `summary.json`

    @property
    def time(self) -> Array:
        """Instant of each row (rows,) [s]."""
        start: float = self.metadata.get("start_time", 0.0)  # only a system's
        return start + self.step_size * np.arange(self.rows, dtype=np.float64)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the compared columns. The view reads a reference as it reads a recording."""
        return tuple(self.quanta)

    @property
    def descriptions(self) -> dict[str, str]:
        """Descriptions of columns, which a reference has none of."""
        return {}

    def __getitem__(self, name: str) -> Array:
        """Return a column (n,), or a signal's columns side by side (n, k)."""
        if name in self.quanta:
            return self.column(name)
        return np.column_stack(
            [self.column(each) for each in self.columns if signal_of(each) == name]
        )

    @classmethod
    def of(cls, recording: Recording, summary: Mapping[str, Any], tolerances: Tolerances) -> Self:
        """Make a reference from a run; values are rounded to a tenth of their tolerances."""
        _check_run(recording, summary)
        compared = [name for name in recording.columns if is_compared(name)]
        if not compared:
            raise InputError(
                "the run records none of the signals that are compared; it cannot become a "
                "reference; a section [success] judges it instead"
            )
        units = dict(recording.units)
        quanta = {name: tolerances.value(name, units[name]) / QUANTA for name in compared}
        return cls(
            rows=recording.rows,
            step_size=float(recording.metadata["step_size"]),
            column=lambda n: np.round(recording[n] / quanta[n]) * quanta[n],
            quanta=quanta,
            units=units,
            digests={name: column_digest(recording[name]) for name in recording.columns},
            metadata=kept_metadata(recording),
            summary=dict(summary),
        )

    def write(self, path: Path, recording: Recording) -> None:
        """Write the file atomically, block by block of the recording that it was made of."""
        text = json.dumps(
            {
                "format": FORMAT,
                "rows": self.rows,
                "columns": {name: [self.units[name], self.digests[name]] for name in self.units},
                "quanta": self.quanta,
                "metadata": self.metadata,
                "summary": self.summary,
            }
        )
        with (
            replacing(path) as temporary,
            pq.ParquetWriter(
                literal(temporary),
                _schema(self.columns),
                compression="zstd",
                compression_level=19,
                use_dictionary=False,
                use_byte_stream_split=True,
                write_statistics=False,
                write_page_checksum=True,
                store_schema=False,
            ) as writer,
        ):
            for batch in self._second_differences(recording):
                writer.write_batch(batch)
            writer.add_key_value_metadata({METADATA_KEY: text, CHECKSUM_KEY: checksum(text)})

    def _second_differences(self, recording: Recording) -> Iterator[Any]:
        before = 0  # rows at the start of a block that were in the one before
        for block in recording.in_blocks(*self.columns, before=2):
            arrays = []
            for name, values in zip(self.columns, block, strict=True):
                steps = np.round(values / self.quanta[name])
                differences = np.diff(np.diff(steps, prepend=0.0), prepend=0.0)[before:]
                if np.abs(differences).max(initial=0.0) > _LARGEST:
                    problem = "the tolerance is too small for its values"
                    raise InputError(f"[regression] {name}: {problem}")
                arrays.append(pa.array(differences.astype(np.int32)))
            yield pa.RecordBatch.from_arrays(arrays, schema=_schema(self.columns))
            before = 2

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a reference."""
        if not path.is_file():
            raise InputError(f"{path}: does not exist; {how_to_make(path)} makes it")
        file, description = _open(path)
        quanta, metadata = description["quanta"], description["metadata"]
        return cls(
            rows=description["rows"],
            step_size=metadata["step_size"],
            column=lambda n: _read(file, n).to_numpy().astype(int).cumsum().cumsum() * quanta[n],
            quanta=quanta,
            units={name: unit for name, (unit, _) in description["columns"].items()},
            digests={name: bits for name, (_, bits) in description["columns"].items()},
            metadata=metadata,
            summary=description["summary"],
        )


def _schema(names: Iterable[str]) -> Any:
    return pa.schema([pa.field(name, pa.int32(), nullable=False) for name in names])


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
    if description["format"] != FORMAT:
        raise InputError(f"{path}: format {excerpt(description['format'])}; must be {FORMAT}")
    is_whole = file.metadata.num_rows == description["rows"]
    if not (is_whole and file.schema_arrow == _schema(description["quanta"])):
        raise InputError(f"{path}: is damaged: its columns are not those of its description")
    return file, description


def checksum(text: str) -> str:
    """Return the checksum of a reference's description; Parquet has its own for columns."""
    return hashlib.sha256(text.encode()).hexdigest()


def column_digest(values: Array) -> str:
    """Return the digest of a column's bits."""
    content = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return hashlib.sha256(content).hexdigest()[:_DIGEST_DIGITS]


def kept_metadata(recording: Recording) -> dict[str, Any]:
    """Return the part of a recording's metadata that a reference keeps: its origin."""
    metadata = recording.metadata
    kept = {key: metadata[key] for key in _KEPT if key in metadata}
    return {**kept, "processor": processor(), "parameters": metadata.get("parameters", {})}


def _check_run(recording: Recording, summary: Mapping[str, Any]) -> None:
    if not recording.complete:
        raise InputError("the run ended early; it cannot become a reference")
    if not summary.get("as_expected", summary.get("success")):
        missed = [c["name"] for c in summary.get("criteria", ()) if not c["ok"]]
        what = "is not a success" if missed else "is a success, although a failure is expected"
        named = f" ({', '.join(missed)})" if missed else ""
        raise InputError(f"the run {what}{named}; it cannot become a reference")
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
