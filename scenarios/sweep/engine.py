"""Runs the missing rows of a sweep, part by part, until the table is complete."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ...fmus.errors import InputError
from ...fmus.sources.targets import build
from ..fields import Quantity
from ..run.folders import SUMMARY_FILE, default_folder
from ..work import cores
from .backend import Backend, backend
from .definition import Sweep, load_sweep
from .design import Design, check_design, check_keys, keys_without_effect, make_design
from .row import Done, Job, Row, Task, margin_column
from .scenarios import Loaded, load_scenarios, pack, remark_if_changed, scenario_names
from .search import Search
from .store import Store, origin, schema

# Time between two parts [s], the most a kill can cost. It grows to this share of the sweep's time,
# so that a long sweep has few parts.
FLUSH_SHARE: Final = 0.1
FLUSH_RANGE: Final = (0.2, 30.0)
MAX_PART: Final = 50_000  # rows
MAX_JOBS: Final = 1024


@dataclass(frozen=True)
class Progress:
    """Progress of a sweep."""

    done: int  # completed rows
    total: int  # rows in all
    new: int  # rows of this call
    bad: int  # rows without success
    seconds: float  # since the call


@dataclass(frozen=True)
class SweepResult:
    """A sweep's table.

    Attributes:
        folder: Where it is.
        counts: Number of rows by status.
    """

    folder: Path
    counts: Mapping[str, int]

    @property
    def table(self) -> Any:
        """All rows by index, as a `pyarrow.Table`; `table.to_pandas()` if pandas is installed."""
        return Store(self.folder).table()


def sweep(  # noqa: PLR0913 - options, by keyword
    definition: Sweep | str | Path,
    out: str | Path | None = None,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    time_limit: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    remark: Callable[[str], None] = warnings.warn,
) -> SweepResult:
    """Run a sweep, or resume one that was stopped.

    Args:
        definition: A definition, a shipped one's name, or a TOML file.
        out: Folder; None: a new one in `runs`.
        jobs: Processes on this machine; None: one per core.
        dask: Address of a Dask scheduler, or "local"; None: processes of this machine.
        time_limit: Wall time of a run [s]; None: unlimited.
        progress: Called as rows come in.
        remark: Called with what one must know about the rows: a key that changes nothing, a
            scenario that is no longer as it was swept.

    Returns:
        The table, with a row for each run, including failed ones.

    Raises:
        InputError: An argument cannot be used, or `out` holds another sweep.
    """
    if not isinstance(definition, Sweep):
        definition = load_sweep(definition)
    if time_limit is not None:
        Quantity(1e-3, 1e9, "s").check("time_limit", time_limit)
    if jobs is not None and not 1 <= jobs <= MAX_JOBS:
        raise InputError(f"jobs: value {jobs!r}; must be 1 to {MAX_JOBS}")
    scenarios, design = check_sweep(definition, out)
    fmus = {name: path.read_bytes() for name, path in build().items()}
    keep = "none" if definition.keep.startswith("worst:") else definition.keep
    job = Job(tuple(map(pack, scenarios)), fmus, time_limit, keep)
    begun_with = origin(definition, job.scenarios, job.fmus)
    store = Store(default_folder("sweep") if out is None else out)
    with ExitStack() as stack:
        stack.enter_context(store.claimed())
        content = store.begin(begun_with)
        rows = stack.enter_context(backend(job, jobs or cores(), dask))
        if content is None:
            idle = keys_without_effect(design, scenarios)
            columns = _columns(definition, design, rows.run(_unvaried(scenarios)))
            content = {"origin": begun_with, **columns, "without_effect": idle}
            store.write(content)
        store.keep_scenarios(job.scenarios)
        for key in content["without_effect"]:
            remark(f"vary: {key} changes no start value, no input and no criterion")
        for change in changed_scenarios(store):
            remark(change)
        _Filling(store, definition, design, progress).run(rows)
        _keep_worst(store, definition, scenarios, rows)
    return SweepResult(store.folder, store.count())


def check_sweep(
    definition: Sweep, out: str | Path | None = None
) -> tuple[tuple[Loaded, ...], Design]:
    """Load a sweep's scenarios, as its folder keeps them, and make its design; nothing is run."""
    kept = [] if out is None else Store(out).kept_scenarios(scenario_names(definition))
    scenarios = load_scenarios(definition, kept)
    check_keys(definition.vary)
    ends = {key: each.ends() for key, each in definition.vary.items() if each.ends()}
    check_design(ends, scenarios)  # before many values are drawn, and by the numbers of the file
    if definition.design == "search":  # points follow later
        axes = {key: each.extremes() for key, each in definition.vary.items()}
        design = Design(axes, definition.samples)
    else:
        design = make_design(definition)
        check_keys(design.columns)
    check_design(design.columns, scenarios)
    return scenarios, design


def _unvaried(scenarios: tuple[Loaded, ...]) -> list[Task]:
    return [Task(-1 - number, number, {}) for number in range(len(scenarios))]


def _columns(definition: Sweep, design: Design, runs: Iterable[Done | None]) -> dict[str, Any]:
    """Return the table's keys and columns, from a run of each scenario unvaried."""
    rows = [done.row for done in runs if done is not None]
    rows.sort(key=lambda row: -int(row["index"]))
    for row in rows:
        if row["status"] in ("failed", "timeout"):
            raise InputError(f"scenario {row['scenario']}: it fails unvaried: {row['error']}")
    columns = list(dict.fromkeys(name for row in rows for name in row))
    margin = margin_column(definition.criterion, columns)  # refuses one that the runs lack
    if definition.design == "search" and rows[0][margin] is None:
        why = rows[0]["error"] or "it has no criteria"
        raise InputError(f"scenario {rows[0]['scenario']}: no margin to search by: {why}")
    nominal = {row["scenario"]: {k: v for k, v in row.items() if k != "index"} for row in rows}
    return {
        "keys": list(design.columns),
        "rows": len(design),
        "columns": columns,
        "nominal": nominal,
    }


class _Filling:
    """Adds what is missing to a table."""

    def __init__(
        self,
        store: Store,
        definition: Sweep,
        design: Design,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self._store, self._design, self._tell = store, design, progress
        self._schema = schema(design.values(0), store.content["columns"])
        self._there = store.done()
        self._search = Search(definition, store) if definition.design == "search" else None
        self._bad = len(self._there) - store.count().get("success", 0)
        self._new = 0
        self._rows: list[Row] = []  # not yet in the table
        self._began = self._flushed = time.monotonic()

    def run(self, rows: Backend) -> None:
        """Run the missing rows; those done are in the table, whatever ends this."""
        tasks = self._missing() if self._search is None else self._search.tasks()
        try:
            for done in rows.run(tasks):
                if done is not None:
                    self._take(done)
                if self._is_due():
                    self._flush()
                if self._tell is not None:
                    self._tell(self._progress())
        finally:
            self._flush()

    def _missing(self) -> Iterable[Task]:
        for index in range(len(self._design)):
            if index not in self._there:
                yield Task(index, self._design.scenario(index), self._design.values(index))

    def _take(self, done: Done) -> None:
        self._new += 1
        self._bad += done.row["status"] != "success"
        if done.files:
            self._store.keep(done)
        if self._search is not None:
            self._search.tell(done)
        self._rows.append(done.row)

    def _is_due(self) -> bool:
        low, high = FLUSH_RANGE
        now = time.monotonic()
        interval = min(max(FLUSH_SHARE * (now - self._began), low), high)
        return now - self._flushed > interval or len(self._rows) >= MAX_PART

    def _flush(self) -> None:
        self._store.add(self._rows, self._schema)
        self._rows, self._flushed = [], time.monotonic()

    def _progress(self) -> Progress:
        seconds, done = time.monotonic() - self._began, len(self._there) + self._new
        return Progress(done, len(self._design), self._new, self._bad, seconds)


def _keep_worst(
    store: Store, definition: Sweep, scenarios: tuple[Loaded, ...], rows: Backend
) -> None:
    """Run the worst rows once more, to keep their recordings."""
    if not definition.keep.startswith("worst:"):
        return
    keys, labels = store.content["keys"], [each.label for each in scenarios]
    tasks = [
        Task(row["index"], labels.index(row["scenario"]), {k: row[k] for k in keys}, keep=True)
        for row in store.worst(int(definition.keep.partition(":")[2]), keys)
        if not (store.run_folder(row["index"]) / SUMMARY_FILE).exists()  # written last
    ]
    for done in rows.run(tasks):
        if done is not None and done.files:
            store.keep(done)


def changed_scenarios(store: Store) -> list[str]:
    """Return a remark on each scenario that is no longer as it was swept."""
    swept = store.content["origin"]["scenarios"]
    remarks = (
        remark_if_changed(name, digest, store.kept_scenario(number, name))
        for number, (name, digest) in enumerate(swept.items())
    )
    return list(filter(None, remarks))
