"""The checks of a comparison besides the tubes: each returns its problems, one line each.

They find signals that are missing, new or in another unit, values that are not finite, a different
time axis or verdict and, on request, different bits.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.messages import did_you_mean
from ..judging.criterion import Criterion, missed_text
from ..recording import Recording
from .formats import precise, signal_names, signal_of
from .reference import Reference, column_digest, kept_metadata

Array = NDArray[np.float64]

TIME_SLACK: Final = 1e-9  # [s] rounding of k * dt


def verdict_problems(summary: Mapping[str, Any], reference: Reference) -> list[str]:
    """Check that the verdict is that of the reference, and what the scenario expects."""
    before, now = bool(reference.summary["success"]), bool(summary["success"])
    if before == now:
        return [] if summary.get("as_expected", True) else [unexpected_text(summary)]
    missed = missed_text(Criterion.read(summary))
    words = {True: "a success", False: "not a success"}
    reasons = f" ({missed})" if missed else ""
    return [f"is {words[now]}, the reference is {words[before]}{reasons}"]


def unexpected_text(summary: Mapping[str, Any]) -> str:
    """Describe in one line how a verdict differs from the expected one."""
    if not summary["complete"]:
        return f"ended early: {summary['reason']}"
    if summary["success"]:
        return f"is a success, but a failure is expected: {summary['expect_reason']}"
    return missed_text(Criterion.read(summary))


def signal_problems(recording: Recording, reference: Reference) -> list[str]:
    """Check that the signals and their units are those of the reference."""
    missing = _words(name for name in reference.units if name not in recording.units)
    added = _words(name for name in recording.units if name not in reference.units)
    problems = []
    for signal, words in missing.items():
        near = did_you_mean(signal, added).replace("; did you mean", ", perhaps renamed to")
        problems.append(f"signal {words} is missing{near.rstrip('?')}")
    problems += [f"signal {words} is new" for words in added.values()]
    for name, unit in recording.units.items():
        before = reference.units.get(name, unit)
        if unit != before:
            problems.append(f"{name} has the unit {unit!r}, the reference {before!r}")
    return problems


def _words(columns: Iterable[str]) -> dict[str, str]:
    """Name the columns of each signal."""
    signals = defaultdict(list)
    for name in columns:
        signals[signal_of(name)].append(name)
    return {
        signal: names[0] if len(names) == 1 else f"{signal} ({len(names)} columns)"
        for signal, names in signals.items()
    }


def value_problems(recording: Recording) -> list[str]:
    """Check that every value is finite, in all columns, compared or not."""
    problems = []
    time = recording.time
    for name in recording.columns:
        values = recording[name]
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            at, more = time[bad[0]], f" and at {len(bad) - 1} more ticks" if len(bad) > 1 else ""
            problems.append(f"{name} is {values[bad[0]]} at {at:.3f} s{more}")
    return problems


def time_problems(time: Array, reference: Reference) -> list[str]:
    """Check that the time axis is that of the reference."""
    end = reference.time[-1]
    first, last = (float(time[0]), float(time[-1])) if len(time) else (np.nan, np.nan)
    if not (abs(first) <= TIME_SLACK and abs(last - end) <= TIME_SLACK):
        span = f"{precise(first)} to {precise(last)} s"
        return [f"goes from {span}, the reference from 0 to {precise(end)} s"]
    if len(time) != reference.rows:
        return [f"has {len(time)} rows, the reference {reference.rows}"]
    off = np.flatnonzero(~(np.abs(time - reference.time) <= TIME_SLACK))
    return [
        f"time is {time[row]:.9f} s in row {row + 1}, must be {reference.time[row]:.9f} s"
        for row in off[:1]
    ]


def bit_problems(recording: Recording, reference: Reference) -> list[str]:
    """Check that all columns have the same bits; add possible causes of a difference."""
    differing = [
        name
        for name, bits in reference.digests.items()
        if name in recording.units and column_digest(recording[name]) != bits
    ]
    if not differing:
        return []
    text = f"bits differ: {signal_names(differing)}"
    changes = _environment_changes(reference.metadata, kept_metadata(recording))
    if changes:
        text += f" (recorded with another {', another '.join(changes)})"
    return [text]


def _environment_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the differences in machine and versions, which may change bits."""
    changes = [key for key in ("platform", "processor") if before.get(key) != now.get(key)]
    old, new = before.get("versions", {}), now.get("versions", {})
    return changes + [name for name in new if old.get(name) != new[name]]
