"""Compares runs with each other: parameters, criteria, metrics and signals.

All runs are compared with the first. Their scenarios, lengths and step sizes may differ; signals
of the same name and unit are compared at the first run's instants, where the times overlap.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import one_line
from ..files import read_integer
from ..judging.criterion import Criterion
from ..recording import Recording
from ..running.folders import SUMMARY_FILE
from ..running.result import Run
from .guards import all_columns
from .metrics import compare_metrics, relative_change

Array = NDArray[np.float64]
Values = tuple[Any, ...]  # one for each run, None where a run has none

# What a range counts as at least, so that noise in an element that hardly moves is a small share.
LEAST_SHARE: Final = 1e-3  # of the largest value among the signal's elements of that unit
LEAST: Final = 1e-9  # in any unit


@dataclass(frozen=True)
class Extent:
    """What a run recorded.

    Attributes:
        begin: Time of its first row [s].
        end: Time of its last row [s].
        rows: Number of rows.
        complete: Whether it ran to its end.
        reason: Why it did not.
    """

    begin: float
    end: float
    rows: int
    complete: bool
    reason: str | None


@dataclass(frozen=True)
class Row:
    """One parameter or metric that differs.

    Attributes:
        name: Such as `controller.kp[1]` or `tracking.rms_mm`.
        values: Value in each run; None: it has none.
    """

    name: str
    values: Values

    @property
    def relative(self) -> float:
        """Largest relative change from the first run; 1 if not numbers."""
        first, *others = self.values
        return max(relative_change(first, other) for other in others)


@dataclass(frozen=True)
class CriterionRow:
    """One criterion in all runs.

    Attributes:
        name: Its name.
        judged: Its result in each run; None: that run does not have it.
    """

    name: str
    judged: tuple[Criterion | None, ...]


@dataclass(frozen=True)
class SignalRow:
    """Distance of one column from the first run's.

    Attributes:
        name: The column.
        unit: Its unit.
        largest: Largest distance of each other run, in the unit.
        times: Time of that distance [s].
        rms: RMS distance of each other run.
        share: The largest of all, divided by the column's range in all runs, which counts as at
            least `LEAST_SHARE` and `LEAST`.
    """

    name: str
    unit: str
    largest: tuple[float, ...]
    times: tuple[float, ...]
    rms: tuple[float, ...]
    share: float


@dataclass(frozen=True)
class RunComparison:
    """Runs against the first of them.

    Attributes:
        names: Names of the runs.
        extents: What each run recorded.
        begin: First of the first run's instants at which all others were compared with it [s].
        end: The last of these [s].
        rows: Their number.
        columns: Number of compared columns.
        parameters: Parameters that differ.
        criteria: All criteria.
        metrics: Metrics that differ, the largest difference first.
        signals: Columns of all runs that differ, the largest difference first.
        missing: Columns that only some runs have.
        other_units: Columns whose unit is not the same in all runs; they are not compared.
        recordings: Recordings of the runs.
    """

    names: tuple[str, ...]
    extents: tuple[Extent, ...]
    begin: float
    end: float
    rows: int
    columns: int
    parameters: tuple[Row, ...]
    criteria: tuple[CriterionRow, ...]
    metrics: tuple[Row, ...]
    signals: tuple[SignalRow, ...]
    missing: tuple[str, ...]
    other_units: tuple[str, ...]
    recordings: tuple[Recording, ...] = field(repr=False)

    @property
    def identical(self) -> bool:
        """Whether all runs recorded the same: signals, instants, and whether they ended early."""
        same_extent = all(extent == self.extents[0] for extent in self.extents)
        return same_extent and not (self.signals or self.missing or self.other_units)

    @property
    def unmet(self) -> bool:
        """Whether a run ended early or missed one of its criteria."""
        judged = [criterion for row in self.criteria for criterion in row.judged]
        missed = any(criterion is not None and not criterion.ok for criterion in judged)
        return missed or not all(extent.complete for extent in self.extents)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        parts = ("extents", "parameters", "criteria", "metrics", "signals")
        plain = ("begin", "end", "rows", "columns", "missing", "other_units")
        return {
            "runs": self.names,
            "identical": self.identical,
            **{name: getattr(self, name) for name in plain},
            **{part: [asdict(row) for row in getattr(self, part)] for part in parts},
        }

    def to_html(self) -> str:
        """Return the comparison as a self-contained page."""
        from .between_runs_page import page  # noqa: PLC0415 - slow to import

        return page(self)

    def _repr_html_(self) -> str:
        from ..view.page import Inline  # noqa: PLC0415 - only in a notebook

        return Inline(self.to_html(), 640)._repr_html_()


def compare(first: Run | str | Path, *others: Run | str | Path) -> RunComparison:
    """Compare runs with the first of them.

    Args:
        first: A run, or its folder.
        others: At least one more.

    Raises:
        InputError: There is no such run, or only one, or they have no signal or span in common.
    """
    if not others:
        raise InputError("compare: one run is given; must be at least two")
    runs = (first, *others)
    recordings = tuple(_recording(run) for run in runs)
    summaries = [_summary(run) for run in runs]
    names = _names(runs)
    columns = [all_columns(recording) for recording in recordings]
    instants = _common_instants(names, [each["time"] for each in columns])
    every = dict.fromkeys(name for c in columns for name in c if name != "time")
    common = [name for name in every if all(name in c for c in columns)]
    units = recordings[0].units
    compared = [name for name in common if all(r.units[name] == units[name] for r in recordings)]
    if not compared:
        raise InputError(f"{', '.join(names)}: nothing to compare: no signal in common")
    ranges = _ranges(compared, units, columns)
    signals = [_signal(name, units[name], columns, ranges[name]) for name in compared]
    return RunComparison(
        names=names,
        extents=tuple(map(_extent, recordings)),
        begin=float(instants[0]),
        end=float(instants[-1]),
        rows=len(instants),
        columns=len(compared),
        parameters=tuple(_differing([_parameters(r) for r in recordings])),
        criteria=_criteria(summaries),
        metrics=tuple(
            sorted(_differing([_metrics(s) for s in summaries]), key=lambda row: -row.relative)
        ),
        signals=tuple(sorted((s for s in signals if s.share > 0.0), key=lambda s: -s.share)),
        missing=tuple(name for name in every if name not in common),
        other_units=tuple(name for name in common if name not in compared),
        recordings=recordings,
    )


def _recording(run: Run | str | Path) -> Recording:
    return run.recording if isinstance(run, Run) else Recording.open(run, in_order=True)


def _summary(run: Run | str | Path) -> Mapping[str, Any]:
    """Return a run's summary; empty if there is none, as for some systems."""
    if isinstance(run, Run):
        return run.summary.to_dict()
    folder = Path(run) if Path(run).is_dir() else Path(run).parent
    path = folder / SUMMARY_FILE
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_int=read_integer)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    if not isinstance(content, dict):
        return {}
    try:
        Criterion.read(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return content


def _names(runs: Sequence[Run | str | Path]) -> tuple[str, ...]:
    """Return the name of each run's folder, or its whole path if names are equal."""
    paths = [run.folder if isinstance(run, Run) else Path(run) for run in runs]
    short = [path.resolve().name for path in paths]
    return tuple(short if len(set(short)) == len(short) else map(str, paths))


def _parameters(recording: Recording) -> dict[str, Any]:
    """Return the settings of a run: scenario, coupling, and each FMU's parameters."""
    metadata = recording.metadata
    told = ("scenario", "system", "coupling", "interpolation", "duration", "step_size")
    values = {name: metadata[name] for name in told if name in metadata}
    for instance, parameters in metadata.get("parameters", {}).items():
        values |= {f"{instance}.{name}": value for name, value in parameters.items()}
    return values


def _metrics(summary: Mapping[str, Any]) -> dict[str, Any]:
    return {metric.name: metric.now for metric in compare_metrics({}, summary)}


def _differing(tables: Sequence[Mapping[str, Any]]) -> list[Row]:
    names = dict.fromkeys(name for table in tables for name in table)
    rows = [Row(name, tuple(table.get(name) for table in tables)) for name in names]
    return [row for row in rows if any(value != row.values[0] for value in row.values)]


def _criteria(summaries: Sequence[Mapping[str, Any]]) -> tuple[CriterionRow, ...]:
    judged = [{c.name: c for c in Criterion.read(summary)} for summary in summaries]
    names = dict.fromkeys(name for run in judged for name in run)
    return tuple(CriterionRow(name, tuple(run.get(name) for run in judged)) for name in names)


def _extent(recording: Recording) -> Extent:
    time = recording.time
    complete, reason = recording.complete, recording.reason
    return Extent(float(time[0]), float(time[-1]), recording.rows, complete, reason)


def _common_instants(names: Sequence[str], times: Sequence[Array]) -> Array:
    """Return the first run's instants within the spans of all runs.

    Raises:
        InputError: There is none.
    """
    first = times[0]
    for name, time in zip(names, times, strict=True):
        if not len(time):
            raise InputError(f"{name}: nothing to compare: it has no rows")
        first = first[(first >= time[0]) & (first <= time[-1])]
    if not len(first):
        raise InputError(f"{', '.join(names)}: nothing to compare: no span of time in common")
    return first


def _ranges(
    names: Sequence[str], units: Mapping[str, str], runs: Sequence[Mapping[str, Array]]
) -> dict[str, float]:
    """Return the range of each column in all runs, or what it counts as at least."""
    ranges, largest = {}, defaultdict[tuple[str, str], float](float)
    signals = {name: (name.partition("[")[0], units[name]) for name in names}
    for name, signal in signals.items():
        finite = np.concatenate([run[name][np.isfinite(run[name])] for run in runs])
        with np.errstate(over="ignore"):
            ranges[name] = float(np.ptp(finite)) if len(finite) else 0.0
        largest[signal] = max(largest[signal], float(np.abs(finite).max(initial=0.0)))
    return {n: max(ranges[n], LEAST_SHARE * largest[s], LEAST) for n, s in signals.items()}


def _signal(name: str, unit: str, runs: Sequence[Mapping[str, Array]], extent: float) -> SignalRow:
    distances = [_distance(name, runs[0], other) for other in runs[1:]]
    largest, times, rms = zip(*distances, strict=True)
    worst = max(largest)
    share = worst / extent if math.isfinite(worst) else math.inf
    return SignalRow(name, unit, largest, times, rms, share)


def _distance(
    name: str, first: Mapping[str, Array], other: Mapping[str, Array]
) -> tuple[float, float, float]:
    """Return the largest distance of two columns, its time [s], and the RMS distance."""
    time, values = first["time"], on_times(name, first["time"], other)
    inside = (time >= other["time"][0]) & (time <= other["time"][-1])
    time, a, b = time[inside], first[name][inside], values[inside]
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.where(a == b, 0.0, np.abs(b - a))
    distance = np.where(
        np.isnan(a) & np.isnan(b), 0.0, np.where(np.isnan(distance), np.inf, distance)
    )
    worst = int(np.argmax(distance))
    with np.errstate(over="ignore"):
        rms = float(np.sqrt(np.mean(distance**2)))
    return float(distance[worst]), float(time[worst]), rms


def on_times(name: str, time: Array, run: Mapping[str, Array]) -> Array:
    """Return a run's column at the instants of another, linearly interpolated."""
    if len(time) == len(run["time"]) and np.array_equal(time, run["time"]):
        return run[name]
    if not len(run["time"]):
        return np.full(len(time), np.nan)
    return np.interp(time, run["time"], run[name])


__all__ = ["CriterionRow", "Extent", "Row", "RunComparison", "SignalRow", "compare", "on_times"]
