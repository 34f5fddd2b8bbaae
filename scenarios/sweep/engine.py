"""Runs the missing rows of a sweep, part by part, until the table is complete."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from ...fmus.errors import InputError
from ...fmus.packaging.build import build
from ..fields import Quantity
from ..running.folders import SUMMARY_FILE, default_folder
from .definition import Loaded, Sweep, load_scenarios, load_sweep, scenario_names
from .design import Design, check_design, check_keys, keys_without_effect, make_design
from .pool import Pool
from .row import Done, Job, Row, Task, margin_column
from .shipping import pack, remark_if_changed
from .store import Store, origin, schema
from .tasks import DesignSource, TaskSource

# Time between two parts [s], the most a kill can cost. It grows to this share of the sweep's time,
# so that a long sweep has few parts.
FLUSH_SHARE: Final = 0.1
FLUSH_RANGE: Final = (0.2, 30.0)
MAX_PART: Final = 50_000  # rows
MAX_JOBS: Final = 1024


class Backend(Protocol):
    """Runs rows: on this machine's pool or on a cluster."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Done | None]:
        """Yield the results of tasks as they end, and None now and then."""

    def close(self) -> None:
        """Stop all running tasks."""


@dataclass(frozen=True)
class Progress:
    """Progress of a sweep.

    Attributes:
        done: Completed rows.
        total: Rows in all.
        new: Rows of this call.
        bad: Rows without success.
        seconds: Time since the call.
    """

    done: int
    total: int
    new: int
    bad: int
    seconds: float


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
        dask: Address of a Dask scheduler, or "local"; None: this machine's pool.
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
    return Execution(definition, out, time_limit, remark).run(jobs or cores(), dask, progress)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_sweep(
    definition: Sweep, out: str | Path | None = None
) -> tuple[tuple[Loaded, ...], Design]:
    """Load a sweep's scenarios and make its design; nothing is built or run.

    Args:
        definition: The sweep.
        out: Its folder; scenarios that it keeps are used.

    Raises:
        InputError: A scenario, a key or an end of its range cannot be used.
    """
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


class Execution:
    """One call of `sweep`.

    Args:
        definition: The sweep.
        out: Folder; None: a new one.
        time_limit: Wall time of a run [s]; None: unlimited.
        remark: Called with each thing to know about the rows.
    """

    def __init__(
        self,
        definition: Sweep,
        out: str | Path | None,
        time_limit: float | None,
        remark: Callable[[str], None],
    ) -> None:
        self.sweep = definition
        self.scenarios, self.design = check_sweep(definition, out)
        fmus = {name: path.read_bytes() for name, path in build().items()}
        keep = definition.keep if definition.keep in ("none", "failures", "all") else "none"
        self.job = Job(tuple(map(pack, self.scenarios)), fmus, time_limit, keep)
        self._out, self._remark = out, remark
        self._began = time.monotonic()
        self._bad = self._new = 0

    def run(
        self, jobs: int, dask: str | None, progress: Callable[[Progress], None] | None
    ) -> SweepResult:
        """Run what is missing."""
        begun_with = origin(self.sweep, self.job.scenarios, self.job.fmus)
        store = Store(default_folder("sweep") if self._out is None else self._out)
        with ExitStack() as stack:
            stack.enter_context(store.claimed())
            content = store.begin(begun_with)
            backend = _backend(self.job, jobs, dask)
            stack.callback(backend.close)
            if content is None:
                idle = keys_without_effect(self.design, self.scenarios)
                content = {"origin": begun_with, **self._nominal(backend), "without_effect": idle}
                store.write(content)
            store.keep_scenarios(self.job.scenarios)
            self._say(store, content)
            self._fill(store, content["columns"], backend, progress)
            self._keep_worst(store, backend)
        return SweepResult(store.folder, count(store))

    def _say(self, store: Store, content: Mapping[str, Any]) -> None:
        """Say what one must know about the rows, before they are run."""
        for key in content["without_effect"]:
            self._remark(f"vary: {key} changes no start value, no input and no criterion")
        for remark in changed_scenarios(store):
            self._remark(remark)

    def _nominal(self, backend: Backend) -> dict[str, Any]:
        """Run each scenario unvaried to find the columns of the table."""
        tasks = [Task(-1 - i, i, {}) for i in range(len(self.scenarios))]
        rows = [each.row for each in backend.run(tasks) if each is not None]
        rows.sort(key=lambda row: -int(row["index"]))
        for row in rows:
            if row["status"] in ("failed", "timeout"):
                raise InputError(f"scenario {row['scenario']}: it fails unvaried: {row['error']}")
        columns = list(dict.fromkeys(name for row in rows for name in row))
        margin = margin_column(self.sweep.criterion, columns)  # refuses one that the runs lack
        if self.sweep.design == "search" and rows[0][margin] is None:
            why = rows[0]["error"] or "it has no criteria"
            raise InputError(f"scenario {rows[0]['scenario']}: no margin to search by: {why}")
        kept = {row["scenario"]: _nominal(row) for row in rows}
        return {
            "keys": list(self.design.columns),
            "rows": len(self.design),
            "columns": columns,
            "nominal": kept,
        }

    def _fill(
        self,
        store: Store,
        columns: Sequence[str],
        backend: Backend,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        types = schema(self.design.values(0), columns)
        there = store.done()
        self._bad = sum(count(store).values()) - count(store).get("success", 0)
        rows: list[Row] = []
        begun = flushed = time.monotonic()
        source = self._source(store, there)
        try:
            for done in backend.run(source):
                if done is not None:
                    self._take(store, done)
                    source.tell(done)
                    rows.append(done.row)
                now = time.monotonic()
                if rows and (now - flushed > _interval(now - begun) or len(rows) >= MAX_PART):
                    store.add(rows, types)
                    rows, flushed = [], now
                if progress is not None:
                    progress(self._progress(len(there)))
        finally:
            store.add(rows, types)

    def _source(self, store: Store, there: set[int]) -> TaskSource:
        if self.sweep.design == "search":
            from .search import SearchSource  # noqa: PLC0415 - needs an extra

            return SearchSource(self.sweep, store)
        return DesignSource(self.design, there)

    def _take(self, store: Store, done: Done) -> None:
        self._new += 1
        self._bad += done.row["status"] != "success"
        if done.files:
            store.keep(done)

    def _progress(self, before: int) -> Progress:
        done = before + self._new
        seconds = time.monotonic() - self._began
        return Progress(done, len(self.design), self._new, self._bad, seconds)

    def _keep_worst(self, store: Store, backend: Backend) -> None:
        """Run the worst rows once more, to keep their recordings."""
        if not self.sweep.keep.startswith("worst:"):
            return
        wanted = int(self.sweep.keep.partition(":")[2])
        tasks = [
            self.task_of(row)
            for row in worst(store, wanted, list(self.design.columns))
            if not (store.run_folder(row["index"]) / SUMMARY_FILE).exists()  # written last
        ]
        for done in backend.run(tasks):
            if done is not None and done.files:
                store.keep(done)

    def task_of(self, row: Row) -> Task:
        """Return the task that repeats a row of the table, with its recording kept."""
        labels = [each.label for each in self.scenarios]
        values = {key: row[key] for key in self.design.columns}
        return Task(row["index"], labels.index(row["scenario"]), values, keep=True)


def _interval(seconds: float) -> float:
    low, high = FLUSH_RANGE
    return min(max(FLUSH_SHARE * seconds, low), high)


def _nominal(row: Row) -> Row:
    return {name: value for name, value in row.items() if name != "index"}


def _backend(job: Job, jobs: int, dask: str | None) -> Backend:
    if dask is None:
        return Pool(job, jobs)
    from .cluster import Cluster  # noqa: PLC0415 - needs an extra

    return Cluster(job, jobs, dask)


def count(store: Store) -> dict[str, int]:
    """Return the number of rows by status."""
    if not store.parts():
        return {}
    found = store.scan(columns=["status"])["status"].value_counts()
    return {str(each["values"]): int(each["counts"]) for each in found.to_pylist()}


def worst(store: Store, number: int, columns: Sequence[str]) -> list[Row]:
    """Return the worst rows: first those without success, and among them those without a margin.

    They are ordered by margin then. A success without a margin, of a scenario without criteria, is
    the best.
    """
    table = store.table(["index", "margin", "status"])
    success = table["status"].to_numpy() == "success"
    margin = table["margin"].to_numpy()
    rank = np.where(np.isnan(margin), np.where(success, np.inf, -np.inf), margin)
    index = table["index"].to_numpy()
    chosen = index[np.lexsort((index, rank, success))][:number].tolist()
    wanted = ["index", "scenario", "status", "missed", "error", "margin", "command"]
    found = store.select(chosen, [*wanted, *columns])
    return [found[index] for index in chosen]


def changed_scenarios(store: Store) -> list[str]:
    """Return a remark on each scenario that is no longer as it was swept."""
    swept = store.content["origin"]["scenarios"]
    remarks = (
        remark_if_changed(name, digest, store.kept_scenario(number, name))
        for number, (name, digest) in enumerate(swept.items())
    )
    return list(filter(None, remarks))


__all__ = ["Execution", "Progress", "SweepResult", "check_sweep", "sweep"]
