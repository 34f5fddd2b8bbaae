"""What differs between runs: settings and metrics side by side, and how far signals are apart."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import InputError
from ...result.recording import Recording
from ...task.tolerances import Tolerances, flattened, signal_of
from .tubes import TIME_SLACK, distances, shown_at, widths
from .wording import DASH, instant, measure, numbers, unit_of

SETTINGS: Final = ("scenario", "system", "coupling", "interpolation", "duration", "step_size")
LONG: Final = 40  # characters of a text, such as a digest
SMALL: Final = 1e-3  # in any unit; changes of smaller numbers are judged as if they were this large

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

    @classmethod
    def of(cls, run: Recording) -> Extent:
        """Return a recording's."""
        return cls(float(run.time[0]), float(run.time[-1]), run.rows, run.complete, run.reason)


@dataclass(frozen=True)
class Row:
    """One parameter, metric or judged criterion."""

    name: str  # such as `controller.kp[1]` or `tracking.rms_mm`
    values: tuple[Any, ...]  # in each run; None: it has none
    unit: str = ""  # unless its name tells it

    def __str__(self) -> str:
        """Say what it is in each run: `controller.kp 8 -> 6`; long texts are cut."""
        texts = (text if len(text) < LONG else f"{text[:12]}..." for text in numbers(self.values))
        return f"{self.name} {' -> '.join(texts)}"

    @property
    def cells(self) -> tuple[str, ...]:
        """Its name, and what it is in each run, with the unit if it is known."""
        unit = self.unit or unit_of(self.name)
        texts = (text if text == DASH else f"{text} {unit}" for text in numbers(self.values))
        return self.name, *map(str.rstrip, texts)

    @property
    def relative(self) -> float:
        """Largest relative change from the first run; 1 if not numbers."""
        first, *others = self.values
        return max(_relative_change(first, other) for other in others)


@dataclass(frozen=True)
class SignalRow:
    """Distance of one column from the first run's, for each other run."""

    name: str
    unit: str
    largest: tuple[float, ...]  # largest distance, in the unit
    times: tuple[float, ...]  # time of that distance [s]
    rms: tuple[float, ...]  # RMS distance, in the unit
    found: tuple[str, ...]  # what each is there, and the first
    share: float = 0.0  # the largest of all, divided by the column's range in all runs
    multiple: float = 0.0  # the largest of all, divided by the default tolerance

    @property
    def texts(self) -> list[str]:
        """Largest distance and its time, for each other run."""
        found = zip(self.largest, self.found, self.times, strict=True)
        return [
            f"{text if math.isinf(size) else measure(size, self.unit)} at {instant(at)} s"
            for size, text, at in found
        ]


def parameters_of(recording: Recording) -> dict[str, object]:
    """Return the settings of a run: scenario, coupling, and each FMU's parameters."""
    settings = {key: recording.metadata[key] for key in SETTINGS if key in recording.metadata}
    return settings | dict(flattened(recording.metadata.get("parameters", {})))


def side_by_side(tables: Sequence[Mapping[str, object]]) -> list[Row]:
    """Return the rows of tables with one value for each name."""
    names = dict.fromkeys(name for table in tables for name in table)
    return [Row(name, tuple(table.get(name) for table in tables)) for name in names]


def differing(tables: Sequence[Mapping[str, object]]) -> list[Row]:
    """Return the rows of the tables whose values differ."""
    return [r for r in side_by_side(tables) if any(value != r.values[0] for value in r.values)]


def _relative_change(before: Any, now: Any) -> float:
    """Return the size of a change by the larger number, at least `SMALL`; 1 if not numbers."""
    if before == now:
        return 0.0
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in (before, now)):
        return 1.0
    return float(abs(now - before) / max(abs(before), abs(now), SMALL))


def joint_instants(names: Sequence[str], times: Sequence[Array]) -> tuple[Array, list[Array]]:
    """Return the instants of all runs within the spans of all, and each run's as they are there."""
    if not all(map(len, times)):
        raise InputError(f"{', '.join(names)}: nothing to compare: one of them has no rows")
    # Rounding of k * dt makes no second instant of one.
    slack = TIME_SLACK * min(float(np.diff(time).min(initial=1.0)) for time in times)
    every = np.unique(np.concatenate(times))
    every = every[np.diff(every, prepend=-np.inf) > slack]
    own = [every[np.searchsorted(every, time, "right") - 1] for time in times]
    first, last = max(time[0] for time in own), min(time[-1] for time in own)
    instants = every[(every >= first) & (every <= last)]
    if not len(instants):
        raise InputError(f"{', '.join(names)}: nothing to compare: no span of time in common")
    return instants, own


def signals_apart(
    names: Sequence[str], runs: Sequence[Recording], instants: Array, times: Sequence[Array]
) -> tuple[SignalRow, ...]:
    """Return the columns that are not equal in all runs, the most default tolerances first."""
    half = [widths(run, Tolerances()) for run in runs]
    extents = defaultdict[tuple[str, str], float](float)
    rows = []
    for name in names:  # one column of each run is in memory at a time
        unit = runs[0].units.get(name, "")
        row, extent, size = _apart(name, unit, instants, times, runs)
        signal = signal_of(name), unit
        extents[signal] = max(extents[signal], LEAST_SHARE * size)
        rows.append((row, extent, max(each[name] for each in half)))
    apart = []
    for row, extent, width in rows:
        worst, least = max(row.largest), max(extents[signal_of(row.name), row.unit], LEAST)
        share = worst / max(extent, least) if math.isfinite(worst) else math.inf
        apart += [replace(row, share=share, multiple=worst / width)] if worst > 0.0 else []
    return tuple(sorted(apart, key=lambda row: -row.multiple))


def _apart(
    name: str, unit: str, instants: Array, times: Sequence[Array], runs: Sequence[Recording]
) -> tuple[SignalRow, float, float]:
    """Return how far other runs' columns are from the first, and range and size in all runs."""
    is_real = all(run.is_real(name) for run in runs)
    columns = [run[name] for run in runs]
    first, *others = (
        on_times(instants, own, values, is_real) for own, values in zip(times, columns, strict=True)
    )
    apart = []
    for other in others:
        distance = distances(other, slice(None), first, 0.0, 0)
        distance[first == other] = 0.0
        if first.dtype.kind == "f":
            distance[np.isnan(first) & np.isnan(other)] = 0.0
        worst, mean = int(np.argmax(distance)), float(np.sqrt(np.mean(distance**2)))
        text = f"{shown_at(other, worst)} instead of {shown_at(first, worst)}"
        apart.append((float(distance[worst]), float(instants[worst]), mean, text))
    largest, at, rms, texts = zip(*apart, strict=True)
    row = SignalRow(name, unit, largest, at, rms, texts)
    if name in runs[0].texts:
        return row, 1.0, 1.0
    finite = (values[np.isfinite(values)].astype(float, copy=False) for values in columns)
    ends = [end for part in finite if len(part) for end in (part.min(), part.max())] or [0.0]
    return row, float(max(ends) - min(ends)), float(max(map(abs, ends)))


def on_times(time: Array, instants: Array, values: Array, is_real: bool) -> Array:
    """Return the values of some instants at later ones: of a Real interpolated, else held."""
    if np.array_equal(time, instants):
        return values
    if is_real:
        return np.interp(time, instants, values)
    return values[np.searchsorted(instants, time, "right") - 1]
