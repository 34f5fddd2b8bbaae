"""Runs the missing rows of a sweep, part by part, until the table is complete."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from ...fmus.errors import InputError
from ...fmus.sources.targets import Target, build
from ...fmus.twins import notice
from ...result.judging.criterion import Criterion
from ...result.judging.summary import SUMMARY_FILE
from ...run.folder import default_folder
from ...task.criteria import Success
from ...task.typed import typed
from ..work import cores
from .backend import Backend, Cluster, Local
from .definition import Sweep, load_sweep
from .design import Design, Search, check_design, keys_without_effect
from .packed import Loaded, load_scenarios, pack, scenario_names
from .row import Done, Job, Task, margin_column
from .store import Store, origin, schema

# Time between two parts [s], the most a kill can cost. It grows to this share of the sweep's time,
# so that a long sweep has few parts.
FLUSH_SHARE: Final = 0.1
FLUSH_RANGE: Final = (0.2, 30.0)


@dataclass(frozen=True)
class SweepResult:
    """A sweep's table."""

    folder: Path  # where it is
    counts: Mapping[str, int]  # number of rows by status
    gate: Criterion | None = None  # the success rate, judged; None: none is required

    @property
    def table(self) -> Any:
        """All rows by index, as a `pyarrow.Table`; `table.to_pandas()` if pandas is installed."""
        return Store(self.folder).table()


@typed
def sweep(  # noqa: PLR0913 - options, by keyword
    definition: Sweep | str | Path,
    out: str | Path | None = None,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    time_limit: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    remark: Callable[[str], None] = warnings.warn,
) -> SweepResult:
    """Run a sweep, or resume one that was stopped.

    Args:
        definition: A definition, a shipped one's name, or a TOML file.
        out: Folder; None: a new one in `runs`.
        jobs: Processes on this machine; None: one per core.
        dask: Address of a Dask scheduler, or "local"; None: processes of this machine.
        time_limit: Wall time of a run [s]; None: unlimited.
        progress: Called as rows come in, with how many are there, and how many there will be.
        remark: Called with what one must know about the rows: a key that changes nothing, a
            scenario that is no longer as it was swept.

    Returns:
        The table, with a row for each run, including failed ones.

    Raises:
        InputError: An argument cannot be used, or `out` holds another sweep.
    """
    if not isinstance(definition, Sweep):
        definition = load_sweep(definition)
    if jobs is not None and jobs < 1:
        raise InputError(f"jobs: value {jobs!r}; must be at least 1")
    scenarios, design = check_sweep(definition, out)
    keep = "none" if definition.keep.startswith("worst:") else definition.keep
    job = _job(scenarios, time_limit, keep)
    engines = {}
    for each in dict.fromkeys(map(str, design.columns.get("mujoco", ()))):
        own = [replace(s, scenario=s.scenario.changed({"mujoco": each})) for s in scenarios]
        engines[each] = _job(own, time_limit, keep)
    job = replace(job, engines=engines)
    begun_with = origin(definition, job.scenarios, job.fmus)
    store = Store(default_folder("sweep") if out is None else out)
    with store.claimed(), ExitStack() as stack:
        for instead in filter(None, [notice()]):
            remark(instead)
        is_begun = store.begin(begun_with)
        jobs = jobs or cores()
        backend = Local(job, jobs) if dask is None else Cluster(job, jobs, dask)
        rows = stack.enter_context(backend)
        if not is_begun:
            unvaried = [Task(-1 - number, number, {}) for number in range(len(scenarios))]
            columns = _columns(definition, design, rows.run(unvaried))
            idle = keys_without_effect(design, scenarios)
            store.write({"origin": begun_with, **columns, "without_effect": idle})
        store.keep_scenarios(job.scenarios)
        for key in store.content.without_effect:
            remark(f"vary: {key} changes no start value, no input and no criterion")
        for change in store.changed_scenarios():
            remark(change)
        _fill(store, definition, design, rows, progress)
        _keep_worst(store, definition, rows)
    counts = store.count()
    gate = judge_rate(definition, counts, len(design)) if definition.min_success else None
    return SweepResult(store.folder, counts, gate)


def _job(scenarios: Sequence[Loaded], time_limit: float | None, keep: str) -> Job:
    """Build the FMUs of scenarios, and pack them; our own if all have the same MuJoCo."""
    engine, *others = {each.scenario.mujoco for each in scenarios}
    files = {} if others else build(target=Target(mujoco=engine))
    fmus = {name: path.read_bytes() for name, path in files.items()}
    return Job(tuple(map(pack, scenarios)), fmus, time_limit, keep)


def judge_rate(definition: Sweep, counts: Mapping[str, int], rows: int) -> Criterion:
    """Compare the share of successes in all rows, or its lower bound, with what is required."""
    good, confidence = counts.get("success", 0), definition.confidence
    name, rate = "success rate", good / rows
    if confidence:
        name += f" (lower bound at {confidence:.6g} confidence)"
        test = scipy.stats.binomtest(good, rows, alternative="greater")
        rate = float(test.proportion_ci(confidence, "exact").low)
    return Criterion(name, 100.0 * rate, 100.0 * definition.min_success, "%", "above")


def check_sweep(
    definition: Sweep, out: str | Path | None = None
) -> tuple[tuple[Loaded, ...], Design]:
    """Load a sweep's scenarios, as its folder keeps them, and make its design; nothing is run."""
    kept = [] if out is None else Store(out).kept_scenarios(scenario_names(definition.scenario))
    scenarios, design = load_scenarios(definition, kept), Design(definition)
    check_design(definition, design.columns, scenarios)
    for each in scenarios:
        if definition.min_success and each.scenario.success == Success():
            raise InputError(
                f"min_success: scenario {each.name} has no criteria, so it would always be met; "
                "must have a section [success]"
            )
    return scenarios, design


def _columns(definition: Sweep, design: Design, runs: Iterable[Done | None]) -> dict[str, object]:
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


def _fill(
    store: Store,
    definition: Sweep,
    design: Design,
    rows: Backend,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Run the missing rows; those done are in the table, whatever ends this."""
    there = store.done()
    search = Search(definition, store) if definition.design == "search" else None
    missing = np.setdiff1d(np.arange(len(design)), there).tolist()
    rest = (Task(index, design.scenario(index), design.values(index)) for index in missing)
    tasks = rest if search is None else search.tasks()
    columns = schema(design.values(0), store.content.columns)
    new, part = 0, []
    began = flushed = time.monotonic()
    try:
        for done in rows.run(tasks):
            if done is not None:
                new += 1
                part.append(done.row)
                store.keep(done)
                if search is not None:
                    search.tell(done)
            seconds = time.monotonic() - began
            if time.monotonic() - flushed > np.clip(FLUSH_SHARE * seconds, *FLUSH_RANGE):
                store.add(part, columns)
                part, flushed = [], time.monotonic()
            if progress is not None:
                progress(len(there) + new, len(design))
    finally:
        store.add(part, columns)


def _keep_worst(store: Store, definition: Sweep, rows: Backend) -> None:
    """Run the worst rows once more, to keep their recordings."""
    if not definition.keep.startswith("worst:"):
        return
    keys, labels = store.content.keys, list(store.content.nominal)
    tasks = [
        Task(row["index"], labels.index(row["scenario"]), {k: row[k] for k in keys}, keep=True)
        for row in store.worst(int(definition.keep.partition(":")[2]), keys)
        if not (store.run_folder(row["index"]) / SUMMARY_FILE).exists()  # written last
    ]
    for done in rows.run(tasks):
        if done is not None:
            store.keep(done)
