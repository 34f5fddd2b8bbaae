"""A sweep's folder: what its rows depend on, the parts of its table, and the kept runs.

`sweep.json` says what the rows depend on; `results/part-*.parquet` are one data set with one
schema; `runs/INDEX` are kept runs. A part appears only when complete, so a kill costs the rows
since the last one. `scenarios/N/NAME` is the sweep's Nth scenario, as it was swept.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import reduce
from importlib.metadata import PackageNotFoundError, requires
from operator import or_
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel

from ...fmus.atomic import held, replacing, temporary_folder, write_whole, writing
from ...fmus.build.identity import code_digest, digest, package_version
from ...fmus.errors import InputError, one_line
from ...run.folder import write_files
from ...task.fields import validated
from ...task.files import read_text
from ...task.scenario import Scenario, load_scenario
from ...task.tolerances import flattened
from ...task.writer import write_scenario
from ..compare.differences import differing
from .definition import Sweep
from .packed import Loaded, identity, pack, scenario_names
from .row import TEXTS, Done, Row

SWEEP_FILE: Final = "sweep.json"
FORMAT: Final = 2
KEPT: Final = "scenarios"
# What rows do not depend on: what stands above sweeps. All other code and data of the package
# counts; shipped scenarios have a hash of their own.
ABOVE: Final = ("cli", "study/check")
_TOOLS: Final = re.compile(r'extra == "(test|docs|importers)"')  # extras that no row depends on
_MAX_BYTES: Final = 64 * 1024 * 1024


Origin = dict[str, Any]  # sections of plain values, see `origin`


class Content(BaseModel, strict=True):
    """What sweep.json must have."""

    format: Literal[2]
    origin: Origin
    keys: list[str]  # that are varied
    rows: int
    columns: list[str]
    nominal: dict[str, Row]  # of each scenario, the row of a run without varied values
    without_effect: list[str]  # keys


def origin(sweep: Sweep, packed: Sequence[Loaded], fmus: Mapping[str, bytes]) -> Origin:
    """Return all that the rows depend on, as plain values; for files, their SHA-256."""
    no_matter = ("keep", "min_success", "confidence")  # they change no row
    definition = {name: value for name, value in asdict(sweep).items() if name not in no_matter}
    vary = definition.pop("vary")
    definition["file"] = digest(sweep.file.read_bytes()) if sweep.file else None
    definition["scenario"] = scenario_names(sweep.scenario)
    plain: Origin = json.loads(json.dumps({
        "definition": definition,
        "vary": vary,
        "scenarios": {each.name: identity(each) for each in packed},
        "fmus": {name: digest(content) for name, content in fmus.items()},
        "code": {"panda-cosim": code_digest(ABOVE)[:16]},
        "versions": dict(_versions()),
    }))  # fmt: skip
    return plain


def _versions() -> Iterator[tuple[str, str]]:
    """Yield the versions of Python and of all packages that rows can use, as far as they exist."""
    yield "python", platform.python_version()
    for requirement in ("panda-cosim", *(requires("panda-cosim") or ())):
        name = re.split(r"[^\w.-]", requirement)[0]
        with suppress(PackageNotFoundError):
            if not _TOOLS.search(requirement):
                yield name, package_version(name)


def changes(old: Origin, new: Origin) -> Iterator[str]:
    """Describe what has changed between two origins."""
    for row in differing([dict(flattened(each)) for each in (old, new)]):
        yield str(row).removeprefix("definition.")


class Store:
    """A sweep's folder, through which all of its files are written and read.

    `sweep` fills it; reports may read it meanwhile, as each call reads the files again. Cells of
    the table that a page needs in several ways are in `Results`.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.results = self.folder / "results"

    @property
    def content(self) -> Content:
        """Content of sweep.json."""
        path = self.folder / SWEEP_FILE
        if not path.exists():
            raise InputError(f"{path}: no such file; must be in the folder of a sweep")
        with validated(path):
            return Content.model_validate_json(read_text(path, _MAX_BYTES))

    def kept_scenarios(self, names: Sequence[str]) -> list[Path]:
        """Return the folders of the scenarios as they were swept; none if others were."""
        there = (self.folder / KEPT).exists()
        if not there or self.content.origin["definition"]["scenario"] != list(names):
            return []
        return [self.kept_scenario(i, name) for i, name in enumerate(names)]

    def kept_scenario(self, number: int, name: str) -> Path:
        """Return the folder of a scenario as it was swept."""
        return self.folder / KEPT / str(number) / Path(name).name

    def kept(self, number: int) -> Scenario:
        """Return a scenario as it was swept; what it would run must be what ran then."""
        name, swept = list(self.content.origin["scenarios"].items())[number]
        scenario = load_scenario(folder := self.kept_scenario(number, name))
        if scenario.has_own_parts and identity(pack(Loaded(name, "", scenario))) != swept:
            raise InputError(f"{folder}: has changed; must be as it was swept, for its FMUs to run")
        return scenario

    def keep_scenarios(self, packed: Sequence[Loaded]) -> None:
        """Keep the scenarios, unless they are; a kill leaves all of them or none."""
        if (self.folder / KEPT).exists():
            return
        with temporary_folder(self.folder) as partial:
            for number, each in enumerate(packed):
                folder = Store(partial).kept_scenario(number, each.name)
                write_scenario(each.scenario, folder)
                write_files(folder, each.files)
            (partial / KEPT).rename(self.folder / KEPT)

    def changed_scenarios(self) -> Iterator[str]:
        """Yield a remark on each scenario that is no longer as it was swept."""
        for number, (name, swept) in enumerate(self.content.origin["scenarios"].items()):
            try:
                if identity(pack(Loaded(name, "", load_scenario(name)))) == swept:
                    continue
                change = "has changed"
            except InputError:
                change = "cannot be used any more"
            place = self.kept_scenario(number, name)
            yield f"scenario {name}: {change} since the sweep began, which uses {place}"

    def begin(self, begun_with: Origin) -> bool:
        """Return whether the folder holds this sweep already; refuse one that holds another."""
        if not (self.folder / SWEEP_FILE).exists():
            if any(self.folder.iterdir()):
                raise InputError(
                    f"{self.folder}: already exists; must be a new folder, or that of this sweep"
                )
            return False
        if changed := list(changes(self.content.origin, begun_with)):
            raise InputError(
                f"{self.folder}: holds another sweep: {'; '.join(changed)}; repeat that one, or "
                "choose another folder with --out"
            )
        return True

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep other sweeps out of the folder: they would run and write the same rows again."""
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        with held(self.folder) as is_ours:
            if not is_ours:
                raise InputError(
                    f"{self.folder}: another sweep is running there; let it end, or choose "
                    "another folder with --out"
                )
            try:
                yield
            finally:
                with suppress(OSError):  # it holds the sweep
                    self.folder.rmdir()

    def write(self, content: Mapping[str, object]) -> None:
        """Write sweep.json."""
        text = json.dumps({"format": FORMAT, **content}, indent=1, allow_nan=False)
        write_whole(self.folder / SWEEP_FILE, text + "\n")
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
        part = self.results / f"part-{number:08d}.parquet"
        with replacing(part) as path, path.open("wb") as file:
            pq.write_table(table, file, write_page_checksum=True)
            os.fsync(file.fileno())

    def keep(self, done: Done) -> None:
        """Write the files of a kept run; they replace those of a killed sweep."""
        if done.files:
            folder = self.run_folder(done.task.index)
            shutil.rmtree(folder, ignore_errors=True)
            write_files(folder, done.files)

    def run_folder(self, index: int) -> Path:
        """Return the folder of a row's run, whether or not it exists."""
        return self.folder / "runs" / f"{index:07d}"

    def scan(self, **selection: Any) -> pa.Table:
        """Return rows and columns of the table, see `pyarrow.dataset.Dataset.to_table`."""
        if not self.parts():
            raise InputError(f"{self.folder}: has no results yet")
        import pyarrow.dataset as pds  # noqa: PLC0415 - imports pandas, which is slow

        options = pds.ParquetFragmentScanOptions(page_checksum_verification=True)
        checked = pds.ParquetFileFormat(default_fragment_scan_options=options)
        try:
            dataset = pds.dataset([str(path) for path in self.parts()], format=checked)
            if dataset.schema.field("index").type != pa.int64():
                raise ValueError("column index has no whole numbers")
            return dataset.to_table(**selection)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise InputError(f"{self.results}: cannot be read: {one_line(error)}") from None

    def table(
        self, columns: Sequence[str] | None = None, indices: Sequence[int] | None = None
    ) -> pa.Table:
        """Return columns, the index among them, of all or some rows in the order of their index."""
        chosen = None if indices is None else pc.field("index").isin(indices)
        return self.scan(columns=columns, filter=chosen).sort_by("index")

    def done(self) -> NDArray[np.int64]:
        """Return the indices of the completed rows, in order."""
        return self.table(["index"])["index"].to_numpy() if self.parts() else np.empty(0, np.int64)

    def row(self, index: int) -> Row:
        """Return one row, with all columns."""
        if index not in (known := self.done()):
            must = f"must be one of its {len(known)} rows, from {known[0]} to {known[-1]}"
            raise InputError(f"{self.folder}: has no row {index}; {must}")
        return self.rows([index])[0]

    def count(self) -> dict[str, int]:
        """Return the number of rows by status."""
        return dict(Counter(self.scan(columns=["status"])["status"].to_pylist()))

    def worst(self, number: int, keys: Sequence[str]) -> list[Row]:
        """Return the worst rows, with some varied values."""
        # First come those without success, and among them those without a margin; they are ordered
        # by margin then. A success without a margin, of a scenario without criteria, is the best.
        table = self.table(["index", "margin", "status"])
        index, margin, status = (column.to_numpy() for column in table.columns)
        success = status == "success"
        rank = np.where(np.isnan(margin), np.where(success, np.inf, -np.inf), margin)
        chosen = index[np.lexsort((index, rank, success))][:number].tolist()
        return self.rows(chosen, ["scenario", *keys])

    def rows(self, indices: Sequence[int], columns: Sequence[str] | None = None) -> list[Row]:
        """Return some rows, with their index and the given columns or all, in the given order."""
        names = None if columns is None else ["index", *columns]
        found = {row["index"]: row for row in self.table(names, indices).to_pylist()}
        return [found[index] for index in indices]

    def beyond_limits(self) -> int | None:
        """Return how many successes exceeded a limit of the robot; None: none was measured."""
        shares = [name for name in self.content.columns
                  if name.startswith("summary.limits.") and "_share" in name]  # fmt: skip
        if not shares:
            return None
        exceeded = reduce(or_, (pc.field(name) > 1.0 for name in shares))
        success = pc.field("status") == "success"
        return int(self.scan(columns=["index"], filter=success & exceeded).num_rows)


def schema(keys: Mapping[str, object], columns: Sequence[str]) -> pa.Schema:
    """Return the schema of all parts, of one value of each key and the columns of a run."""
    types = {bool: pa.bool_(), str: pa.string(), float: pa.float64()}
    fields = {"index": pa.int64(), **{key: types[type(value)] for key, value in keys.items()}}
    for name in columns:
        fields.setdefault(name, pa.string() if name in TEXTS else pa.float64())
    return pa.schema(list(fields.items()))
