"""Reference recordings: each is a scenario's last approved run.

`reference.parquet` lies beside the scenario and holds all recorded signals at every tick. Real ones
are rounded to a tenth of their tolerance, the quantum: int32, second differences of multiples of
it above the first value, which makes a file of some 100 kB. Others are as they were recorded. The
JSON under `METADATA_KEY` holds the quanta, the origin (versions, machine, FMUs, parameters), a
digest of every column, and the summary.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...assets.fields import Array
from ...fmus.errors import InputError, excerpt, one_line
from ...result.judging.summary import Summary
from ...result.recording import Column, Recording
from ...result.recording.reader import bits
from ...result.recording.storage import (
    METADATA_KEY,
    Source,
    in_one_block,
    literal,
    make_batch,
    parquet_writer,
    values_of,
)
from ...task.files import as_argument
from ...task.tolerances import Tolerances
from ..work import processor
from .tubes import Widths, widths

Models = Mapping[str, Any]  # mjModel of each FMU that is made of one, by its name

FORMAT: Final = 2  # that is written, and alone is read
REFERENCE_FILE: Final = "reference.parquet"
CHECKSUM_KEY: Final = b"panda-cosim.checksum"
TUBES: Final = "tubes"  # in the metadata: where their widths come from, unless from the defaults
QUANTA: Final = 10  # quanta per tolerance
_DIGEST_DIGITS = 16  # hexadecimal digits of a SHA-256; enough to exclude collisions
_LARGEST = 2**31 - 1
_KEPT = ("scenario", "coupling", "step_size", "start_time", "versions", "platform", "fmus")


class Reference(Recording):
    """A reference: the recording of an approved run, rounded, with which runs are compared.

    `of` makes one of a run, and `read` opens a file. It is read as a recording is; each column is
    made when it is used, since all of an hour are 2 GB.

    Attributes:
        quanta: Rounding step of each Real, in its unit.
        digests: Digest of every column's bits as they were recorded.
        step_size: Time between two rows [s].
        summary: Of the approved run.
        noise: Half-widths of its tubes if they come from noise, by column.
        models: What each MuJoCo model held, by instance, see `causes.elements`.
    """

    def __init__(  # noqa: PLR0913 - all that a file holds
        self,
        path: Path,
        source: Source,
        quanta: Mapping[str, float],
        digests: Mapping[str, str],
        summary: Summary,
        models: Models,
    ) -> None:
        super().__init__(path, source)
        self.quanta, self.digests, self.summary, self.models = quanta, digests, summary, models
        self.step_size: float = self.metadata["step_size"]
        self.noise = {n: QUANTA * q for n, q in quanta.items() if TUBES in self.metadata}

    @classmethod
    def of(
        cls,
        recording: Recording,
        summary: Summary,
        tolerances: Tolerances,
        models: Models | None = None,
        noise: Widths | None = None,
    ) -> Self:
        """Make a reference from a run; values are rounded to a tenth of their tolerances."""
        _check_run(recording, summary)
        half = widths(recording, tolerances, noise)
        if not half:
            raise InputError("the run records no signal; it cannot become a reference")
        quanta = {n: width / QUANTA for n, width in half.items() if recording.is_real(n)}

        def column(name: str) -> Array:
            values, quantum = recording[name], quanta.get(name)
            if quantum is None:
                return values
            return np.asarray(values[0] + np.round((values - values[0]) / quantum) * quantum)

        columns = [
            Column(name, recording.units.get(name, ""), "", kind, recording.nominals.get(name))
            for name, kind in recording.types.items()
            if name == "time" or name in half
        ]
        blocks = in_one_block(column)
        metadata = kept_metadata(recording) | ({TUBES: "noise"} if noise else {})
        source = Source(tuple(columns), metadata, recording.rows, blocks)
        digests = {column.name: column_digest(recording[column.name]) for column in columns}
        return cls(recording.path, source, quanta, digests, summary, models or {})

    def write(self, path: Path, recording: Recording) -> None:
        """Write the file atomically, block by block of the recording that it was made of."""
        origins = {name: float(recording[name][0]) for name in self.quanta}
        text = json.dumps(
            {
                "format": FORMAT,
                "rows": self.rows,
                "columns": {
                    name: [self.units.get(name, ""), self.digests[name], kind]
                    for name, kind in self.types.items()
                },
                "quanta": self.quanta,
                "origins": origins,
                "nominals": self.nominals,
                "metadata": self.metadata,
                "summary": self.summary.to_dict(),
                "models": _packed(self.models),
            }
        )
        schema, numbers = _schema(self.quanta, self.types), list(self.quanta)
        options = {"compression_level": 19, "store_schema": False}
        with parquet_writer(path, schema, numbers, **options) as writer:
            for columns in self._blocks(recording, origins):
                writer.write_batch(make_batch(schema, columns))
            writer.add_key_value_metadata({METADATA_KEY: text, CHECKSUM_KEY: checksum(text)})

    def _blocks(self, recording: Recording, origins: Mapping[str, float]) -> Iterator[list[Array]]:
        # Those of other types are not in blocks, which are of float64.
        held = [recording[n] for n in self.types if n != "time" and n not in self.quanta]
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
        origins, nominals = description["origins"], description["nominals"]
        rows, recorded = description["rows"], description["columns"]

        def column(name: str) -> Array:
            if name == "time":
                start = metadata.get("start_time", 0.0)  # only a system's
                return np.asarray(start + metadata["step_size"] * np.arange(rows))
            values = values_of(file.read([name]).column(0).combine_chunks())
            if name not in quanta:
                return values
            steps = values.astype(int).cumsum().cumsum()
            return np.asarray(origins[name] + steps * quanta[name])

        columns = tuple(
            Column(name, unit, "", kind, nominals.get(name))
            for name, (unit, _, kind) in recorded.items()
        )
        source = Source(columns, metadata, rows, in_one_block(column))
        digests = {name: digest for name, (_, digest, _) in recorded.items()}
        summary, models = Summary.read(description["summary"]), _unpacked(description["models"])
        return cls(path, source, quanta, digests, summary, models)


def _packed(models: Models) -> str:
    """Pack what hardly anyone reads: a tenth of its size."""
    return base64.b85encode(zlib.compress(json.dumps(models).encode(), 9)).decode()


def _unpacked(text: str) -> dict[str, Any]:
    return dict(json.loads(zlib.decompress(base64.b85decode(text))))


def _schema(quanta: Mapping[str, float], kinds: Mapping[str, str]) -> Any:
    """Return the schema of a file with these rounded columns, and others as they were recorded."""
    others = {name: kind for name, kind in kinds.items() if name not in ("time", *quanta)}
    types = {**dict.fromkeys(quanta, "int32"), **others}
    fields = [pa.field(n, pa.type_for_alias(kind), nullable=False) for n, kind in types.items()]
    return pa.schema(fields)


def _open(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the file and the description of a reference, if both are whole."""
    try:
        file = pq.ParquetFile(literal(path), page_checksum_verification=True)
        for name in file.schema_arrow.names:
            file.read([name])
        notes = file.metadata.metadata or {}
        if notes[CHECKSUM_KEY].decode() != checksum(notes[METADATA_KEY].decode()):
            raise ValueError("the checksum is wrong")
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        reason = f"has no {error}" if isinstance(error, KeyError) else one_line(error)
        raise InputError(f"{path}: is not a reference: {reason}") from None
    description = json.loads(notes[METADATA_KEY])
    if description["format"] != FORMAT:
        found = f"format {excerpt(description['format'])}"
        raise InputError(f"{path}: {found}; must be {FORMAT}; {how_to_make(path)} renews it")
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
    if not summary.as_expected:
        raise InputError(f"the run cannot become a reference: {summary.brief}")
    for name in recording.columns:
        if not np.isfinite(recording[name]).all():
            raise InputError(f"{name} is not finite; the run cannot become a reference")


def how_to_make(path: Path) -> str:
    """Return the command that makes the reference of one scenario, in backticks."""
    return f"`panda-cosim regress {as_argument(path.parent)} --update`"
