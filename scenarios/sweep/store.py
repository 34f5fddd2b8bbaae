"""A sweep's folder: what its rows depend on, the parts of its table, and the kept runs.

`sweep.json` says what the rows depend on; `results/part-*.parquet` are one data set with one
schema; `runs/INDEX` are kept runs. A part appears only when complete, so a kill costs the rows
since the last one. `scenarios/N/NAME` is the sweep's Nth scenario, as it was swept.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import reduce
from importlib.metadata import version
from operator import or_
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.dataset as pds
import pyarrow.parquet as pq
from pydantic import BaseModel, ValidationError

from ...fmus.atomic import replacing
from ...fmus.errors import InputError
from ...fmus.messages import excerpt, one_line
from ..files import read_text
from ..recording.storage import lock
from ..run.run_files import PACKAGES
from ..scenario.writer import write_scenario
from .definition import Sweep
from .row import Done, Row
from .scenarios import Loaded, identity, scenario_names

SWEEP_FILE: Final = "sweep.json"
FORMAT: Final = 2
KEPT: Final = "scenarios"
_TEXT: Final = ("scenario", "status", "missed", "error", "processor", "command",
                "recording_sha256")  # fmt: skip
_PACKAGES: Final = (*PACKAGES, "scipy")
# What simulates and judges a row; what only shows it may change meanwhile.
_CODE: Final = (
    *("assets", "plant", "controller", "fmus"),
    *(
        f"scenarios/{room}"
        for room in ("judging", "recording", "run", "scenario", "system", "timing")
    ),
    *(f"scenarios/{name}.py" for name in ("fields", "files", "rotations")),
    *(f"scenarios/sweep/{name}.py" for name in ("design", "distribution", "row", "search")),
)
_PACKAGE: Final = Path(__file__).parents[2]
_CODE_SUFFIXES: Final = (".py", ".xml", ".c", ".h", ".j2")
_MAX_BYTES: Final = 64 * 1024 * 1024


class _Definition(BaseModel, strict=True, extra="allow"):
    design: str
    samples: int
    scenario: list[str]
    criterion: str
    goal: str


class _Origin(BaseModel, strict=True, extra="allow"):
    definition: _Definition
    vary: dict[str, Any]
    scenarios: dict[str, Any]
    fmus: dict[str, Any]
    versions: dict[str, Any]


class _Content(BaseModel, strict=True, extra="allow"):
    """What sweep.json must have."""

    format: Literal[2]
    origin: _Origin
    keys: list[str]
    rows: int
    columns: list[str]
    nominal: dict[str, Any]
    without_effect: list[str]


Origin = dict[str, Any]


def origin(sweep: Sweep, packed: Sequence[Loaded], fmus: Mapping[str, bytes]) -> Origin:
    """Return all that the rows depend on, as plain values; for files, their SHA-256."""
    definition = asdict(sweep)
    del definition["keep"]  # which recordings are kept changes no row
    vary = definition.pop("vary")
    file = definition["file"]
    definition["file"] = _sha256(Path(file).read_bytes()) if file is not None else None
    definition["scenario"] = scenario_names(sweep)
    plain: Origin = json.loads(json.dumps({
        "definition": definition,
        "vary": vary,
        "scenarios": {each.name: identity(each) for each in packed},
        "fmus": {name: _sha256(content) for name, content in fmus.items()},
        "code": {"panda-cosim": code_digest()},
        "versions": {"python": platform.python_version(), **{p: version(p) for p in _PACKAGES}},
    }))  # fmt: skip
    return plain


def code_digest(package: Path = _PACKAGE) -> str:
    """Return a hash of a package's code that simulates and judges, and its data."""
    content = hashlib.sha256()
    for place in _CODE:
        paths = (package / place).rglob("*") if (package / place).is_dir() else [package / place]
        for path in sorted(p for p in paths if p.suffix in _CODE_SUFFIXES):
            data = path.read_bytes()
            content.update(f"{path.relative_to(package)} {len(data)} ".encode() + data)
    return content.hexdigest()[:16]


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def changes(old: Origin, new: Origin) -> list[str]:
    """Describe what has changed between two origins."""
    words = {"definition": "", "vary": "vary ", "scenarios": "scenario ", "fmus": "FMU ",
             "code": "code of ", "versions": "version of "}  # fmt: skip
    changed = [
        (f"{word}{key}", old.get(section, {}).get(key), new[section].get(key))
        for section, word in words.items()
        for key in dict.fromkeys((*old.get(section, {}), *new[section]))
    ]
    return [_change(*each) for each in changed if each[1] != each[2]]


def _change(what: str, before: Any, now: Any) -> str:
    if all(isinstance(v, int | float) or (isinstance(v, str) and len(v) < 40)
           for v in (before, now)):  # fmt: skip
        return f"{what} (was {before!r}, is {now!r})"
    return what


class Store:
    """A sweep's folder."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.results = self.folder / "results"

    @property
    def content(self) -> dict[str, Any]:
        """Content of sweep.json."""
        path = self._description()
        try:
            return _Content.model_validate_json(read_text(path, _MAX_BYTES)).model_dump()
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            place = "".join(f"{part}: " for part in problem["loc"])
            raise InputError(f"{path}: {place}{problem['msg']}") from None

    def kept_scenarios(self, names: Sequence[str]) -> list[Path]:
        """Return the folders of the scenarios as they were swept; none if others were."""
        if not (self.folder / SWEEP_FILE).exists() or not (self.folder / KEPT).exists():
            return []
        same = self.content["origin"]["definition"]["scenario"] == list(names)
        return [self.kept_scenario(i, name) for i, name in enumerate(names)] if same else []

    def kept_scenario(self, number: int, name: str) -> Path:
        """Return the folder of a scenario as it was swept."""
        return self.folder / KEPT / str(number) / Path(name).name

    def keep_scenarios(self, packed: Sequence[Loaded]) -> None:
        """Keep the scenarios, unless they are; a kill leaves all of them or none."""
        if (self.folder / KEPT).exists():
            return
        partial = Store(self.folder / f".{KEPT}")
        shutil.rmtree(partial.folder, ignore_errors=True)
        for number, each in enumerate(packed):
            folder = partial.kept_scenario(number, each.name)
            write_scenario(each.scenario, folder)
            for name, data in each.files.items():
                with replacing(folder / name) as path:
                    path.write_bytes(data)
        (partial.folder / KEPT).rename(self.folder / KEPT)
        partial.folder.rmdir()

    def begin(self, begun_with: Origin) -> dict[str, Any] | None:
        """Return the content of sweep.json if the folder holds this sweep already."""
        if not (self.folder / SWEEP_FILE).exists():
            if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
                raise InputError(
                    f"{self.folder}: already exists; must be a new folder, or that of this sweep"
                )
            return None
        content = self.content
        if changed := changes(content["origin"], begun_with):
            raise InputError(
                f"{self.folder}: was begun otherwise: {'; '.join(changed)}; must be as it was, or "
                "--out another folder"
            )
        self._drop_damaged()
        return content

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep other sweeps out of the folder: they would run and write the same rows again."""
        is_new = not self.folder.exists()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            folder = os.open(self.folder, os.O_RDONLY)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be written to: {error.strerror}") from error
        try:
            if not lock(folder):
                raise InputError(
                    f"{self.folder}: another sweep is running there; must end first, or "
                    "--out another folder"
                )
            yield
        finally:
            os.close(folder)
            if is_new:
                with suppress(OSError):  # it holds the sweep
                    self.folder.rmdir()

    def _drop_damaged(self) -> None:
        """Remove parts truncated by a power cut; their rows are run again."""
        for path in self.parts():
            try:
                pq.read_metadata(path)
            except pa.ArrowInvalid:
                path.unlink()

    def write(self, content: Mapping[str, Any]) -> None:
        """Write sweep.json."""
        with replacing(self.folder / SWEEP_FILE) as path:
            text = json.dumps({"format": FORMAT, **content}, indent=1, allow_nan=False)
            path.write_text(text + "\n", encoding="utf-8")
        self.results.mkdir(exist_ok=True)

    def parts(self) -> list[Path]:
        """Return the parts in the order in which they were written."""
        return sorted(self.results.glob("part-*.parquet"))

    def add(self, rows: Sequence[Row], schema: pa.Schema) -> None:
        """Write rows as one more part."""
        if not rows:
            return
        ordered = sorted(rows, key=lambda row: int(row["index"]))
        number = int(self.parts()[-1].stem[5:]) + 1 if self.parts() else 0
        table = pa.Table.from_pylist(ordered, schema=schema)
        with (
            replacing(self.results / f"part-{number:08d}.parquet") as path,
            path.open("wb") as file,
        ):
            pq.write_table(table, file, write_page_checksum=True)
            os.fsync(file.fileno())

    def keep(self, done: Done) -> None:
        """Write the files of a kept run; they replace those of a killed sweep."""
        folder = self.run_folder(done.task.index)
        shutil.rmtree(folder, ignore_errors=True)
        for name, content in done.files.items():
            with replacing(folder / name) as path:
                path.write_bytes(content)

    def run_folder(self, index: int) -> Path:
        """Return the folder of a row's run, whether or not it exists."""
        return self.folder / "runs" / f"{index:07d}"

    def _description(self) -> Path:
        """Return the path of sweep.json, which every sweep's folder has."""
        path = self.folder / SWEEP_FILE
        if not path.exists():
            raise InputError(f"{path}: there is no such file; must be in the folder of a sweep")
        return path

    def scan(self, **selection: Any) -> pa.Table:
        """Return rows and columns of the table, see `pyarrow.dataset.Dataset.to_table`."""
        if not self.parts():
            self._description()
            raise InputError(f"{self.folder}: has no results yet")
        options = pds.ParquetFragmentScanOptions(page_checksum_verification=True)
        checked = pds.ParquetFileFormat(default_fragment_scan_options=options)
        content = self.content
        try:
            dataset = pds.dataset([str(path) for path in self.parts()], format=checked)
            _check_types(dataset.schema, content)
            table = dataset.to_table(**selection)
            for name in {"index", "status"} & set(table.column_names):
                if table[name].null_count:
                    raise ValueError(f"column {name} has no value in a row")
        except (pa.ArrowException, OSError, ValueError, LookupError, TypeError) as error:
            raise InputError(f"{self.results}: cannot be read: {one_line(error)}") from None
        return table

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return columns of all rows, in the order of their index."""
        table = self.scan(columns=list(columns) if columns is not None else None)
        index = table["index"].to_numpy()
        if np.all(index[1:] > index[:-1]):
            return table
        return table.take(np.argsort(index, kind="stable"))

    def done(self) -> set[int]:
        """Return the indices of the completed rows."""
        return set(self.table(["index"])["index"].to_pylist()) if self.parts() else set()

    def row(self, index: int) -> Row:
        """Return one row."""
        rows = self.scan(filter=pds.field("index") == index).to_pylist()
        if not rows:
            known = self.done()
            bounds = f", from {min(known)} to {max(known)}" if known else ""
            raise InputError(
                f"{self.folder}: has no row {index}; must be one of its {len(known)} rows{bounds}"
            )
        return dict(rows[0])

    def count(self) -> dict[str, int]:
        """Return the number of rows by status."""
        if not self.parts():
            return {}
        counts = self.scan(columns=["status"])["status"].value_counts()
        return {str(each["values"]): int(each["counts"]) for each in counts.to_pylist()}

    def worst(self, number: int, keys: Sequence[str]) -> list[Row]:
        """Return the worst rows, with some varied values.

        First come those without success, and among them those without a margin; they are ordered
        by margin then. A success without a margin, of a scenario without criteria, is the best.
        """
        table = self.table(["index", "margin", "status"])
        success = table["status"].to_numpy() == "success"
        margin = table["margin"].to_numpy()
        rank = np.where(np.isnan(margin), np.where(success, np.inf, -np.inf), margin)
        index = table["index"].to_numpy()
        chosen = index[np.lexsort((index, rank, success))][:number].tolist()
        columns = ["index", "scenario", "status", "missed", "error", "margin", "command", *keys]
        rows = self.scan(columns=columns, filter=pds.field("index").isin(chosen)).to_pylist()
        return sorted(rows, key=lambda row: chosen.index(row["index"]))

    def beyond_limits(self) -> int | None:
        """Return how many successes exceeded a limit of the robot; None: none was measured."""
        shares = [name for name in self.content["columns"]
                  if name.startswith("summary.limits.") and "_share" in name]  # fmt: skip
        if not shares:
            return None
        exceeded = reduce(or_, (pds.field(name) > 1.0 for name in shares))
        success = pds.field("status") == "success"
        return int(self.scan(columns=["index"], filter=success & exceeded).num_rows)


def schema(keys: Mapping[str, Any], columns: Sequence[str]) -> pa.Schema:
    """Return the schema of all parts, of one value of each key and the columns of a run."""
    fields = [("index", pa.int64())]
    fields += [(key, _type(value)) for key, value in keys.items()]
    fields += [(name, pa.string() if name in _TEXT else pa.float64())
               for name in columns if name != "index" and name not in keys]  # fmt: skip
    return pa.schema(fields)


def _check_types(parts: pa.Schema, content: Mapping[str, Any]) -> None:
    """Check that the parts have the columns that sweep.json names, each of its type."""
    keys = content["keys"]
    for field in schema(dict.fromkeys(keys, 0.0), content["columns"]):
        if len(parts.get_all_field_indices(field.name)) != 1:
            raise ValueError(f"column {excerpt(field.name)} must be there once")
        valid = (pa.float64(), pa.bool_(), pa.string()) if field.name in keys else (field.type,)
        kind, kinds = parts.field(field.name).type, " or ".join(map(str, valid))
        if kind not in valid:
            raise ValueError(f"column {excerpt(field.name)} has type {kind}; must be {kinds}")


def _type(value: Any) -> Any:
    if isinstance(value, bool):
        return pa.bool_()
    return pa.string() if isinstance(value, str) else pa.float64()
