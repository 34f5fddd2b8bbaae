"""One row: a run with its values and metrics, and the command that repeats it."""

from __future__ import annotations

import os
import pickle
import shlex
import shutil
import time
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from ...fmus.atomic import write_whole
from ...fmus.errors import CosimError, one_line, refuse
from ...fmus.interface.parameters import ParameterValue
from ...result.judging.summary import Summary
from ...result.judging.verdicts import VERDICTS
from ...run.execution import Execution
from ...run.finished import Run
from ...run.folder import write_files
from ...run.options import Options
from ...run.prepare import prepare
from ...run.stopping import StopRequest
from ..work import processor
from .packed import Loaded, read_files, unpack

# Columns of words; all others hold numbers, which a report shows.
TEXTS: Final = ("scenario", "status", "missed", "error", "processor", "command",
                "recording_sha256")  # fmt: skip
MARGIN: Final = "margin"  # column with the smallest; `margin.NAME` has that of a criterion
# As `run` would end: as expected (0), a criterion missed (3), all of them hold though a failure is
# expected (3), none missed and one not measured (3), a failed simulation (1), or stopped by the
# time limit.
STATUSES: Final = tuple(dict.fromkeys(verdict.status for verdict in VERDICTS))
UNJUDGED: Final = ("unmeasured", "failed", "timeout")  # of which there is no margin
JOB_FILE: Final = "job"

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """What all rows of a sweep share: `sweep` packs it once, and each worker unpacks it once."""

    scenarios: tuple[Loaded, ...]
    fmus: Mapping[str, bytes]  # content of our own FMUs' files by instance
    time_limit: float | None = None  # wall time of a row [s]
    keep: str = "none"  # which recordings are kept: none, failures, all
    engines: Mapping[str, Job] = field(default_factory=dict)  # for values of the key `mujoco`


@dataclass(frozen=True)
class Task:
    """A row to run."""

    index: int
    scenario: int  # which of the sweep's
    values: Mapping[str, ParameterValue]  # by key


@dataclass(frozen=True)
class Done:
    """A finished row: its columns, and kept files of the run by path in its folder."""

    task: Task
    row: Row
    files: Mapping[str, bytes] = field(default_factory=dict)


def unpack_job(job: Job, folder: Path) -> None:
    """Write a job and its files into a folder, where `run_rows` finds them."""
    write_files(folder, {f"{name}.fmu": content for name, content in job.fmus.items()})
    scenarios = (unpack(each, folder / f"scenario-{i}") for i, each in enumerate(job.scenarios))
    for engine, other in job.engines.items():
        unpack_job(other, folder / engine)
    fmus = dict.fromkeys(job.fmus, b"")
    kept = replace(job, scenarios=tuple(scenarios), fmus=fmus, engines={})
    write_whole(folder / JOB_FILE, pickle.dumps(kept))


def run_rows(work: tuple[Path, Sequence[Task]]) -> list[Done]:
    """Run tasks of the job in a folder, one after the other."""
    folder, tasks = work
    return [_run_row(folder, task) for task in tasks]


@cache
def _job_in(folder: Path) -> Job:
    job: Job = pickle.loads((folder / JOB_FILE).read_bytes())  # noqa: S301 - our own
    return job


def _run_row(folder: Path, task: Task) -> Done:
    """Run a row, of failures that are kept once more, to have their recording."""
    job = _job_in(folder)
    done = _run(folder, task, writes=job.keep == "all")
    if job.keep == "failures" and done.row["status"] not in ("success", "timeout"):
        again = _run(folder, task, writes=True)
        # A full disk is not the row's fault.
        return again if again.row["status"] == done.row["status"] else done
    return done


def _run(folder: Path, task: Task, *, writes: bool) -> Done:
    """Run a row, in memory or in a folder whose files are kept; a failed run is a row, too."""
    job, place = _job_in(folder), folder / f"run-{os.getpid()}"
    row, values = first_columns(job, task), dict(task.values)
    if "mujoco" in values:  # which the scenarios of that engine's job have
        folder /= str(values.pop("mujoco"))
        job = _job_in(folder)
    fmus = {name: folder / f"{name}.fmu" for name in job.fmus}
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():  # an overflow is a failure of the run soon
            warnings.simplefilter("ignore", RuntimeWarning)
            scenario = job.scenarios[task.scenario].scenario.changed(values)
            prepared = prepare(scenario, Options(fmus=fmus, time_limit=job.time_limit))
            stop = StopRequest()
            with Execution(prepared, place, writes=writes) as execution:
                execution.advance(execution.ticks, stop)
                row |= measured(execution.close(stop=stop))
    except CosimError as error:
        row |= {"status": "failed", "error": str(error)}
    except Exception as error:  # reported in the row; the sweep goes on
        reason = f"unexpected {type(error).__name__}: {one_line(error)}"
        row |= {"status": "failed", "error": reason}
    row["wall_s"] = time.perf_counter() - began
    files = read_files(place)
    shutil.rmtree(place, ignore_errors=True)
    return Done(task, row, files)


def first_columns(job: Job, task: Task) -> Row:
    """Return the columns known before the run."""
    loaded = job.scenarios[task.scenario]
    return {
        "index": task.index,
        "scenario": loaded.label,
        **task.values,
        "missed": None,
        "error": None,
        MARGIN: None,
        "processor": processor(),
        "command": command(loaded.name, task.values),
    }


def measured(run: Run) -> Row:
    """Return the columns measured in a run."""
    summary, criteria = run.summary, run.summary.criteria
    row: Row = {"status": run.verdict.status, **dict(metrics(summary))}
    if not summary.complete:
        return {**row, "error": summary.reason}
    unknown = [f"{c.name} is not measured: {c.reason}" for c in criteria if c.value is None]
    return {
        **row,
        "missed": next((c.name for c in criteria if c.word == "missed"), None),
        "error": "; ".join(unknown) or None,
        MARGIN: summary.margin,
        **{f"{MARGIN}.{c.name}": c.margin for c in criteria},
        "recording_sha256": run.recording.sha256(),
    }


def margin_column(criterion: str, columns: Collection[str]) -> str:
    """Return the column with the margin of a criterion; of "", with the smallest of all."""
    name = f"{MARGIN}.{criterion}" if criterion else MARGIN
    if name not in columns:
        valid = [c.partition(".")[2] for c in columns if c.startswith(f"{MARGIN}.")]
        refuse("criterion", criterion, f"must be one of {', '.join(valid) or 'none'}", valid)
    return name


def metrics(summary: Summary) -> Iterator[tuple[str, float | None]]:
    """Yield the numbers of a summary by path, such as `summary.tracking.rms_mm`."""
    yield from ((f"event.{name}", instant) for name, instant in summary.events.items())
    for name, value in summary.numbers():
        yield f"summary.{name}", None if value is None else float(value)


def command(scenario: str, values: Mapping[str, ParameterValue]) -> str:
    """Return the command that repeats a row; the repr of a float reads back as the same bits."""
    words = ["panda-cosim", "run", f"./{scenario}" if scenario.startswith("-") else scenario]
    for key, value in values.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        words += ["--set", f"{key}={text}"]
    return shlex.join(words)
