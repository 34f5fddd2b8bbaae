"""What differs between runs: settings, metrics, and how far their signals are from the first's."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ..judging.criterion import Criterion
from ..recording import Recording
from .formats import measure
from .metrics import compare_metrics, relative_change

Array = NDArray[np.float64]
Values = tuple[Any, ...]  # one for each run, None where a run has none

# What a range counts as at least, so that noise in an element that hardly moves is a small share.
LEAST_SHARE: Final = 1e-3  # of the largest value among the signal's elements of that unit
LEAST: Final = 1e-9  # in any unit


@dataclass(frozen=True)
class Extent:
    """What a run recorded."""

    begin: float  # time of its first row [s]
    end: float  # time of its last row [s]
    rows: int
    complete: bool  # whether it ran to its end
    reason: str | None  # why it did not


@dataclass(frozen=True)
class Row:
    """One parameter or metric that differs."""

    name: str  # such as `controller.kp[1]` or `tracking.rms_mm`
    values: Values  # in each run; None: it has none

    @property
    def relative(self) -> float:
        """Largest relative change from the first run; 1 if not numbers."""
        first, *others = self.values
        return max(relative_change(first, other) for other in others)


@dataclass(frozen=True)
class CriterionRow:
    """One criterion in all runs."""

    name: str
    judged: tuple[Criterion | None, ...]  # in each run; None: that run does not have it


@dataclass(frozen=True)
class SignalRow:
    """Distance of one column from the first run's, for each other run."""

    name: str
    unit: str
    largest: tuple[float, ...]  # largest distance, in the unit
    times: tuple[float, ...]  # time of that distance [s]
    rms: tuple[float, ...]  # RMS distance, in the unit
    share: float  # the largest of all, divided by the column's range in all runs, see `ranges_of`

    @property
    def texts(self) -> list[str]:
        """Largest distance and its time, for each other run."""
        largest = zip(self.largest, self.times, strict=True)
        return [f"{measure(distance, self.unit)} at {t:.3f} s" for distance, t in largest]


def parameters_of(recording: Recording) -> dict[str, Any]:
    """Return the settings of a run: scenario, coupling, and each FMU's parameters."""
    metadata = recording.metadata
    told = ("scenario", "system", "coupling", "interpolation", "duration", "step_size")
    values = {name: metadata[name] for name in told if name in metadata}
    for instance, parameters in metadata.get("parameters", {}).items():
        values |= {f"{instance}.{name}": value for name, value in parameters.items()}
    return values


def metrics_of(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metrics of a summary by name."""
    return {metric.name: metric.now for metric in compare_metrics({}, summary)}


def differing(tables: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return the rows of the tables whose values differ."""
    names = dict.fromkeys(name for table in tables for name in table)
    rows = [Row(name, tuple(table.get(name) for table in tables)) for name in names]
    return [row for row in rows if any(value != row.values[0] for value in row.values)]


def criteria_of(summaries: Sequence[Mapping[str, Any]]) -> tuple[CriterionRow, ...]:
    """Return all criteria of the runs."""
    judged = [{c.name: c for c in Criterion.read(summary)} for summary in summaries]
    names = dict.fromkeys(name for run in judged for name in run)
    return tuple(CriterionRow(name, tuple(run.get(name) for run in judged)) for name in names)


def extent_of(recording: Recording) -> Extent:
    """Return what a run recorded."""
    time = recording.time
    complete, reason = recording.complete, recording.reason
    return Extent(float(time[0]), float(time[-1]), recording.rows, complete, reason)


def common_instants(names: Sequence[str], times: Sequence[Array]) -> Array:
    """Return the first run's instants within the spans of all runs."""
    first = times[0]
    for name, time in zip(names, times, strict=True):
        if not len(time):
            raise InputError(f"{name}: nothing to compare: it has no rows")
        first = first[(first >= time[0]) & (first <= time[-1])]
    if not len(first):
        raise InputError(f"{', '.join(names)}: nothing to compare: no span of time in common")
    return first


def ranges_of(
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


def distances(
    name: str, unit: str, runs: Sequence[Mapping[str, Array]], extent: float
) -> SignalRow:
    """Return how far the other runs' column is from the first one's."""
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
    """Return a run's column at the instants of another, linearly interpolated; else NaN."""
    if len(time) == len(run["time"]) and np.array_equal(time, run["time"]):
        return run[name]
    if not len(run["time"]):
        return np.full(len(time), np.nan)
    return np.interp(time, run["time"], run[name], left=np.nan, right=np.nan)
