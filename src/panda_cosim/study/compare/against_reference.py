"""Compares a run with its reference recording: a tube around each signal, and other checks.

A value may lie anywhere between the smallest and the largest value of the reference within `time`
of its instant, widened by the signal's tolerance:

    min r(t') - tol <= x(t) <= max r(t') + tol,  |t' - t| <= time

A text must be one of those of the reference within `time`; any other, and a value that is not
finite, is infinitely far away.
The largest distance from the reference, divided by the tolerance, is the signal's `share`; above 1
the comparison fails. The other checks find signals that are missing, new or of another unit or
type, a different time axis or verdict and, on request, different bits.
What else differs, parameters, models, versions and FMUs, is no problem, but the cause of one: see
`causes`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import InputError
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...task.tolerances import Tolerances, signal_of
from .differences import LEAST_SHARE, Row
from .reference import Reference, column_digest
from .tubes import TIME_SLACK, Rows, distances, extent_of, holds_constant, shown_at, widths
from .wording import instant, measure, multiple, precise, signal_names

LISTED: Final = 20  # signals that are missing or new
COARSEST: Final = 0.2  # of a tolerance: the reference's rounding step, half of which widens tubes


def verdict_problems(summary: Summary, reference: Reference) -> list[str]:
    """Check that the verdict is that of the reference, and what the scenario expects."""
    if summary.success == reference.summary.success:
        return [] if summary.as_expected else [summary.detail]
    words = {True: "a success", False: "not a success"}
    now, before = (words[each.success] for each in (summary, reference.summary))
    return [f"is {now}, the reference is {before} ({summary.detail})"]


def event_problems(summary: Summary, reference: Reference, steps: int) -> Iterator[str]:
    """Check that the same events happened, earlier or later by so many steps at most."""
    for name, now in summary.events.items():
        before = reference.summary.events.get(name, now)
        apart = np.ptp(np.array([now, before], float))  # NaN: only one of them has it
        if now != before and not apart <= (steps + TIME_SLACK) * reference.step_size:
            times = ["never" if at is None else f"at {instant(at)} s" for at in (now, before)]
            told = f"event {name} happens {times[0]}, in the reference {times[1]}"
            yield f"{told}; may move by {steps} steps"


def signal_problems(recording: Recording, reference: Reference) -> Iterator[str]:
    """Check that the signals and their units are those of the reference."""
    now, before = recording.types, reference.types
    for what, names in (("missing", before.keys() - now), ("new", now.keys() - before)):
        if names:
            yield f"{len(names)} columns are {what}: {signal_names(sorted(names), LISTED)}"
    units, types = (recording.units, reference.units), (recording.types, reference.types)
    for what, (now, before) in (("unit", units), ("type", types)):
        for name, word in now.items():
            if before.get(name, word) != word:
                yield f"{name} has the {what} {word!r}, the reference {before[name]!r}"


def time_problems(time: Array, reference: Reference) -> list[str]:
    """Check that the time axis is that of the reference."""
    expected, slack = reference.time, TIME_SLACK * reference.step_size
    if len(time) == len(expected) and np.allclose(time, expected, rtol=0.0, atol=slack):
        return []
    now, before = (
        f"{len(each)} rows from {precise(each[0])} to {precise(each[-1])} s"
        for each in (time, expected)
    )
    return [f"has {now}, the reference {before}; all instants must be the same"]


def bit_problems(recording: Recording, reference: Reference) -> list[str]:
    """Check that all columns have the same bits."""
    differing = [
        name
        for name, bits in reference.digests.items()
        if name in recording.types and column_digest(recording[name]) != bits
    ]
    return [f"bits differ: {signal_names(differing)}"] if differing else []


@dataclass(frozen=True)
class Deviation:
    """Deviation of one column from its reference."""

    name: str
    unit: str
    tolerance: float  # half-width of its tube, in its unit
    share: float
    distance: float  # the largest, in its unit
    time: float  # of that distance [s]
    first: float | None  # time at which it first leaves the tube [s]; None: never
    outside: int  # ticks outside the tube
    extent: float = 0.0  # of the reference: its largest value less its smallest; 1 of texts
    constant: bool = False  # whether a constant would stay inside the tube
    found: str = ""  # what it is, and the reference, where it is infinitely far away

    @property
    def ok(self) -> bool:
        """Whether it stays inside its tube."""
        return self.share <= 1.0

    @property
    def of_range(self) -> float:
        """The largest distance by the reference's range; of a constant, by its tolerance."""
        return self.distance / max(self.extent, self.tolerance)

    @property
    def text(self) -> str:
        """Size and time of the largest distance."""
        size = f"{measure(self.distance, self.unit)} at {instant(self.time)} s"
        return self.found or f"{size}, {multiple(self.share)} times its tolerance"

    @property
    def described(self) -> str:
        """Where the column is furthest from its reference."""
        return f"{self.name} {'is' if self.found else 'off by'} {self.text}"


@dataclass(frozen=True)
class Comparison:
    """A run against its reference, as `compare_with_reference` finds it.

    It goes from process to process, so it holds numbers and texts, but no recording. Runs are
    compared with each other by `RunComparison`, which knows no tubes.
    """

    problems: tuple[str, ...]  # one line each, the most important first
    deviations: tuple[Deviation, ...]  # of each compared column, the worst first
    engines: tuple[str, str] = ("", "")  # versions of MuJoCo: the run's, the reference's
    causes: tuple[Row, ...] = ()  # what the run was made with differently, the likeliest first

    @property
    def ok(self) -> bool:
        """Whether the run matches its reference within tolerances."""
        return not self.problems

    @property
    def worst(self) -> Deviation | None:
        """The column with the largest deviation."""
        return next(iter(self.deviations), None)

    @property
    def first(self) -> Deviation | None:
        """The column that leaves its tube first."""
        outside = [each for each in self.deviations if each.first is not None]
        return min(outside, key=lambda each: each.first or 0.0, default=None)

    @property
    def compared(self) -> int:
        """Number of compared columns."""
        return len(self.deviations)

    @property
    def constant_fits(self) -> list[str]:
        """Columns that vary, but in whose tube a constant stays, too."""
        extents = defaultdict[tuple[str, str], float](float)
        for d in self.deviations:
            key = signal_of(d.name), d.unit
            extents[key] = max(extents[key], d.extent)
        return [
            d.name
            for d in self.deviations
            if d.constant and d.extent > LEAST_SHARE * extents[signal_of(d.name), d.unit]
        ]

    @property
    def count(self) -> str:
        """Say how many columns were compared, and how many of them a constant would match, too."""
        fits = f", {len(self.constant_fits)} loose" if self.constant_fits else ""
        return f"{self.compared} columns{fits}"

    @property
    def scope(self) -> str:
        """Say what was compared, and which signals a constant would match, too."""
        loose = signal_names(sorted(self.constant_fits))
        return f"Compared: {self.count}{f' (as a constant would match: {loose})' if loose else ''}."


def compare_with_reference(
    recording: Recording,
    summary: Summary,
    reference: Reference,
    tolerances: Tolerances,
    *,
    exact: bool = False,
) -> Comparison:
    """Compare a run with its reference; `exact`: each bit of each signal must match, too."""
    half = widths(reference, tolerances, reference.noise)
    ticks = tolerances.ticks(reference.step_size)
    _check_precision(reference, half)
    deviations = sorted(_deviations(recording, reference, half, ticks), key=lambda d: -d.share)
    problems = [
        *signal_problems(recording, reference),
        *time_problems(recording.time, reference),
        *verdict_problems(summary, reference),
        *event_problems(summary, reference, tolerances.events),
        *_tube_problems(deviations),
    ]
    if not deviations:
        problems.append("no signal was compared")
    if exact:
        problems += bit_problems(recording, reference)
    run, made = (each.metadata.get("versions", {}) for each in (recording, reference))
    engines = (run.get("mujoco", ""), made.get("mujoco", ""))
    return Comparison(tuple(problems), tuple(deviations), engines)


def _check_precision(reference: Reference, half: Mapping[str, float]) -> None:
    """Refuse a reference whose rounding would widen its tubes noticeably."""
    for name, quantum in reference.quanta.items():
        unit, tolerance = reference.units[name], half[name]
        if quantum > COARSEST * tolerance:
            raise InputError(
                f"{name}: the reference is rounded to {measure(quantum, unit)}, too coarse for a "
                f"tolerance of {measure(tolerance, unit)}; must be recorded again with --update"
            )


def _deviations(
    recording: Recording, reference: Reference, half: Mapping[str, float], ticks: int
) -> Iterator[Deviation]:
    """Yield how far each column of both is from the reference's, at the instants of both."""
    rows = matching_rows(recording.time, reference)
    matched = rows >= 0
    rows, time = rows[matched], recording.time[matched]
    common = [name for name in recording.types if name in half and len(rows)]
    for name in common:
        if (name in recording.texts) != (name in reference.texts):
            continue
        values, expected, tolerance = recording[name][matched], reference[name], half[name]
        distance = distances(values, rows, expected, reference.quanta.get(name, 0.0) / 2, ticks)
        worst, outside = int(np.argmax(distance)), np.flatnonzero(distance > tolerance)
        now, before = shown_at(values, worst), shown_at(expected, int(rows[worst]))
        found = f"{now} at {instant(time[worst])} s, {before} in the reference"
        yield Deviation(
            name=name,
            unit=reference.units.get(name, ""),
            tolerance=tolerance,
            share=float(distance[worst]) / tolerance,
            distance=float(distance[worst]),
            time=float(time[worst]),
            first=float(time[outside[0]]) if len(outside) else None,
            outside=len(outside),
            extent=extent_of(expected),
            constant=holds_constant(expected, tolerance, ticks),
            found=found if math.isinf(distance[worst]) else "",
        )


def matching_rows(time: Array, reference: Reference) -> Rows:
    """Return the reference's row at each instant, -1 if it has none."""
    ticks = np.rint((time - reference.time[0]) / reference.step_size).astype(np.int64)
    return np.where((ticks >= 0) & (ticks < reference.rows), ticks, -1)


def _tube_problems(deviations: Sequence[Deviation]) -> list[str]:
    """Describe the worst column, name what left its tube before it, and the other signals."""
    failed = sorted((d for d in deviations if not d.ok), key=lambda d: (d.first, -d.of_range))
    if not failed:
        return []
    first, worst = failed[0], max(failed, key=lambda d: d.share)
    began = instant(first.first or 0.0)
    led = "" if first is worst else f"; {first.name} left its tube first, at {began} s"
    others = signal_names(d.name for d in failed if d not in (first, worst))
    more = f"; {len(failed) - 1} more outside, in this order: {others}" if others else ""
    return [f"{worst.described}{led}{more}"]
