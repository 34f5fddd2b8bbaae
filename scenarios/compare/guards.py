"""The checks of a comparison besides the tubes.

Each function returns its problems, one line each: a run that ended early, signals that are
missing, new or in another unit, values that are not finite, a different time axis or verdict and,
on request, different bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.messages import did_you_mean
from ..judging.criterion import Criterion, missed_text
from ..recording import Recording
from .formats import precise
from .reference import Reference, column_digest, kept_metadata

Array = NDArray[np.float64]
Columns = Mapping[str, Array]

TIME_SLACK: Final = 1e-9  # [s] rounding of k * dt
NAMED: Final = 5  # signals named in a message
# Recorded by every run today; older references may lack them.
LATER: Final = frozenset({"plant.unwanted_contact_force", "plant.support_force"})


@dataclass(frozen=True)
class Problem:
    """One difference between a run and its reference."""

    kind: str  # `end`, `verdict`, `signals`, `values`, `time`, `span`, `tube` or `bits`
    text: str  # what, where and how much, in one line


def end_problems(recording: Recording) -> list[Problem]:
    """Check that the run is complete."""
    if recording.complete:
        return []
    return [Problem("end", f"ended early: {recording.reason}")]


def verdict_problems(summary: Mapping[str, Any], reference: Reference) -> list[Problem]:
    """Check that the run's verdict is that of the reference."""
    before, now = bool(reference.summary["success"]), bool(summary["success"])
    if before == now:
        return unexpected_problems(summary)
    missed = missed_text(Criterion.read(summary))
    words = {True: "a success", False: "not a success"}
    reasons = f" ({missed})" if missed else ""
    return [Problem("verdict", f"is {words[now]}, the reference is {words[before]}{reasons}")]


def unexpected_problems(summary: Mapping[str, Any]) -> list[Problem]:
    """Check that the verdict is what the scenario expects."""
    if summary.get("as_expected", True):
        return []
    return [Problem("verdict", unexpected_text(summary))]


def unexpected_text(summary: Mapping[str, Any]) -> str:
    """Describe in one line how a verdict differs from the expected one."""
    if not summary["complete"]:
        return f"ended early: {summary['reason']}"
    if summary["success"]:
        return f"is a success, but a failure is expected: {summary['expect_reason']}"
    return missed_text(Criterion.read(summary))


def signal_problems(recording: Recording, reference: Reference) -> list[Problem]:
    """Check that the signals and their units are those of the reference."""
    missing = _by_signal(name for name in reference.units if name not in recording.units)
    added = _by_signal(name for name in recording.units if name not in reference.units)
    problems = []
    for signal, names in missing.items():
        near = did_you_mean(signal, added).replace("; did you mean", ", perhaps renamed to")
        shown = names[0] if len(names) == 1 else f"{signal} ({len(names)} columns)"
        problems.append(Problem("signals", f"signal {shown} is missing{near.rstrip('?')}"))
    for signal, names in added.items():
        if signal in LATER:
            continue
        shown = names[0] if len(names) == 1 else f"{signal} ({len(names)} columns)"
        problems.append(Problem("signals", f"signal {shown} is new"))
    for name, unit in recording.units.items():
        before = reference.units.get(name, unit)
        if unit != before:
            problems.append(
                Problem("signals", f"{name} has the unit {unit!r}, the reference {before!r}")
            )
    return problems


def _by_signal(names: Iterable[str]) -> dict[str, list[str]]:
    signals: dict[str, list[str]] = {}
    for name in names:
        signals.setdefault(name.partition("[")[0], []).append(name)
    return signals


def value_problems(columns: Columns) -> list[Problem]:
    """Check that every value is finite, in all columns, compared or not."""
    problems = []
    time = columns["time"]
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            at, more = time[bad[0]], f" and at {len(bad) - 1} more ticks" if len(bad) > 1 else ""
            problems.append(Problem("values", f"{name} is {values[bad[0]]} at {at:.3f} s{more}"))
    return problems


def time_problems(time: Array, reference: Reference) -> list[Problem]:
    """Check that the time axis is that of the reference."""
    problems = []
    back = np.flatnonzero(~(np.diff(time) > 0.0))
    if len(back):
        row = int(back[0]) + 1
        what = "repeats" if time[row] == time[row - 1] else "does not increase"
        problems.append(Problem("time", f"time {what}: {time[row]:.9f} s in row {row + 1}"))
    end = (reference.rows - 1) * reference.step_size
    last = float(time[-1]) if len(time) else math.nan
    if not abs(last - end) <= TIME_SLACK or (len(time) and abs(time[0]) > TIME_SLACK):
        first = float(time[0]) if len(time) else math.nan
        span = f"{precise(first)} to {precise(last)} s"
        text = f"goes from {span}, the reference from 0 to {precise(end)} s"
        problems.append(Problem("span", text))
    elif len(time) != reference.rows:
        text = f"has {len(time)} rows, the reference {reference.rows}"
        problems.append(Problem("span", text))
    elif not problems:
        off = np.flatnonzero(np.abs(time - reference.time) > TIME_SLACK)
        if len(off):
            row, at = int(off[0]) + 1, time[off[0]]
            text = f"time is {at:.9f} s in row {row}, must be {reference.time[off[0]]:.9f} s"
            problems.append(Problem("time", text))
    return problems


def bit_problems(recording: Recording, columns: Columns, reference: Reference) -> list[Problem]:
    """Check that all columns have the same bits; add possible causes of a difference."""
    differing = [
        name
        for name, bits in reference.digests.items()
        if name in columns and column_digest(columns[name]) != bits
    ]
    if not differing:
        return []
    signals = list(dict.fromkeys(name.partition("[")[0] for name in differing))
    more = f" and {len(signals) - NAMED} more" if len(signals) > NAMED else ""
    text = f"bits differ: {', '.join(signals[:NAMED])}{more}"
    changes = environment_changes(reference.metadata, kept_metadata(recording))
    if changes:
        text += f" (made with another {', another '.join(changes)})"
    return [Problem("bits", text)]


def environment_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the differences in machine and versions, which may change bits."""
    changes = [key for key in ("platform", "processor") if before.get(key) != now.get(key)]
    old, new = before.get("versions", {}), now.get("versions", {})
    return changes + [name for name in new if old.get(name) != new[name]]


def all_columns(recording: Recording) -> dict[str, Array]:
    """Read all columns at once, each (n,)."""
    blocks = [np.empty((0, len(recording.columns))), *recording.blocks()]
    values = np.ascontiguousarray(np.concatenate(blocks).T)
    return dict(zip(recording.columns, values, strict=True))
