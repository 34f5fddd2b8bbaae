"""Runs the missing rows of a sweep, part by part, until the table is complete."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from ...fmus.errors import InputError
from ...fmus.sources.targets import Target, build
from ...fmus.twins import notice
from ...result.judging.criterion import Criterion
from ...run.execution import Progress
from ...run.folder import default_folder
from ...task.criteria import Success
from ...task.typed import typed
from ..work import cores
from .backend import Backend, Cluster, Local
from .definition import Sweep, load_sweep
from .design import Design, Search, check_design, keys_without_effect
from .packed import Loaded, load_scenarios, pack, scenario_names
from .row import Job, Task, margin_column
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
    scenarios, design = check_sweep(definition, out)
    versions = map(str, dict.fromkeys(design.columns.get("mujoco", ())))
    job = _job(scenarios, versions, time_limit=time_limit, keep=definition.keep)
    begun_with = origin(definition, job.scenarios, job.fmus)
    store, jobs = Store(default_folder("sweep") if out is None else out), jobs or cores()
    with store.claimed():
        is_begun = store.begin(begun_with)
        with Local(job, jobs) if dask is None else Cluster(job, jobs, dask) as rows:
            if not is_begun:
                store.write({"origin": begun_with, **_content(definition, design, scenarios, rows)})
            store.keep_scenarios(job.scenarios)
            idle = [
                f"vary: {key} changes no start value, no input and no criterion"
                for key in store.content.without_effect
            ]
            for text in filter(None, (notice(), *idle, *store.changed_scenarios())):
                remark(text)
            _fill(store, definition, design, rows, progress or (lambda *_: None))
    counts = store.count()
    gate = judge_rate(definition, counts, len(design)) if definition.min_success else None
    return SweepResult(store.folder, counts, gate)


def _job(scenarios: Sequence[Loaded], engines: Iterable[str], **shared: Any) -> Job:
    """Build and pack what rows share, of each version of MuJoCo that is varied, too."""
    engine, *others = {each.scenario.mujoco for each in scenarios}
    files = {} if others else build(target=Target(mujoco=engine))  # one has no other's FMUs
    fmus = {name: path.read_bytes() for name, path in files.items()}
    varied = {
        each: [replace(s, scenario=s.scenario.changed({"mujoco": each})) for s in scenarios]
        for each in engines
    }
    jobs = {each: _job(own, (), **shared) for each, own in varied.items()}
    return Job(tuple(map(pack, scenarios)), fmus, engines=jobs, **shared)


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
    bare = [each.name for each in scenarios if each.scenario.success == Success()]
    if definition.min_success and bare:
        raise InputError(
            f"min_success: scenario {bare[0]} has no criteria, so it would always be met; "
            "must have a section [success]"
        )
    return scenarios, design


def _content(
    definition: Sweep, design: Design, scenarios: Sequence[Loaded], rows: Backend
) -> dict[str, object]:
    """Return the table's keys and columns, from a run of each scenario unvaried."""
    unvaried = [Task(-1 - number, number, {}) for number in range(len(scenarios))]
    found = sorted((done.row for done in rows.run(unvaried) if done), key=lambda row: -row["index"])
    for row in found:
        if row["status"] in ("failed", "timeout"):
            raise InputError(f"scenario {row['scenario']}: it fails unvaried: {row['error']}")
    columns = list(dict.fromkeys(name for row in found for name in row))
    margin = margin_column(definition.criterion, columns)  # refuses one that the runs lack
    if definition.design == "search" and found[0][margin] is None:
        why = found[0]["error"] or "it has no criteria"
        raise InputError(f"scenario {found[0]['scenario']}: no margin to search by: {why}")
    return {
        "keys": list(design.columns),
        "rows": len(design),
        "columns": columns,
        "nominal": {row["scenario"]: row for row in found},
        "without_effect": keys_without_effect(design, scenarios),
    }


def _fill(
    store: Store, definition: Sweep, design: Design, rows: Backend, progress: Progress
) -> None:
    """Run the missing rows; those done are in the table, whatever ends this."""
    there = store.done()
    search = Search(definition, store) if definition.design == "search" else None
    missing = np.setdiff1d(np.arange(len(design)), there).tolist()
    rest = (Task(index, design.scenario(index), design.values(index)) for index in missing)
    columns = schema(design.values(0), store.content.columns)
    new, part = 0, []
    began = flushed = time.monotonic()
    try:
        for done in rows.run(search.tasks() if search else rest):
            if done is not None:
                new += 1
                part.append(done.row)
                store.keep(done)
                if search:
                    search.tell(done)
            now = time.monotonic()
            if now - flushed > np.clip(FLUSH_SHARE * (now - began), *FLUSH_RANGE):
                store.add(part, columns)
                part, flushed = [], time.monotonic()
            progress(len(there) + new, len(design))
    finally:
        store.add(part, columns)
