"""Judges criteria over signals (a recorded signal, norm or difference), and poses of bodies.

A signal is reduced over a window. A reduction takes times (n,) [s], values (n,) and the criterion
with its band, target and level, and returns the number, or raises ValueError. n is at least 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...fmus.errors import located, refuse
from ...task.criteria import (
    BLOCK,
    BOUNDS,
    REDUCTIONS,
    SLACK,
    BodyCriterion,
    Direction,
    Instant,
    Signal,
    SignalCriterion,
    names_of,
    split_instant,
)
from ..recording import Recording, by_rows
from ..recording.reader import shapes_of
from .block import POSE
from .criterion import Criterion
from .holds import Events

Reduction = Callable[[Array, Array, SignalCriterion], float]
AT_TARGET: Final = 1e-6  # share of the largest deviation within which a signal starts at its target
_POSE: Final = "_xquat[4]"  # end of a column's name, where a body's pose is recorded


def judge_signals(
    criteria: Iterable[SignalCriterion], recording: Recording, events: Events
) -> Iterator[Criterion]:
    """Judge a run by each criterion; a criterion with two bounds gives two results."""
    units = recording.units | {a: recording.units[n] for a, n in recording.addresses.items()}
    for criterion in criteria:
        unit, reason, length = "", None, 0.0
        values: list[float] = []
        try:
            unit = unit_of(criterion.signal, shapes_of(recording.columns), units)
            unit = "s" if REDUCTIONS[criterion.reduce].is_time else unit
            values, length = _measure(criterion, recording, events)
        except ValueError as error:
            reason = str(error)
        for direction, name in criterion.labels.items():
            bound = getattr(criterion, direction)
            # The worst of several elements counts: for an upper bound, the largest.
            value = (max if direction == "below" else min)(values, default=None)
            if value is not None and criterion.reduce == "settle" and length < value <= bound:
                value, reason = None, f"does not settle within its window of {length:g} s"
            yield Criterion(name, value, bound, unit, direction, reason)


def _measure(
    criterion: SignalCriterion, recording: Recording, events: Events
) -> tuple[list[float], float]:
    """Reduce each element; also return the window's length [s]."""
    time = recording.time
    start, stop = (time_of(each, events) for each in (criterion.from_, criterion.to))
    rows = (time >= start - _slack(time)) & (time <= stop + _slack(time))
    if not rows.any():
        raise ValueError(f"no samples from {start:g} to {stop:g} s")
    signal = by_rows(recording, partial(evaluate, criterion.signal), *criterion.names)
    if not np.isfinite(signal)[rows].all():
        raise ValueError("is not finite")
    within = time[rows]
    values = [REDUCE[criterion.reduce](within, column[rows], criterion) for column in signal.T]
    return values, float(within[-1] - within[0])


def row_at(instant: Instant, time: Array, events: Events) -> int:
    """Return the row of an instant."""
    at = time_of(instant, events)
    rows = np.flatnonzero(time <= at + _slack(time))
    if not len(rows) or at > time[-1] + _slack(time):
        raise ValueError(f"no sample at {at:g} s")
    return int(rows[-1])


def _slack(time: Array) -> float:
    """Rounding of k * dt [s]: a millionth of the shortest step."""
    return min(SLACK, 1e-6 * float(np.diff(time).min(initial=1.0)))


def time_of(instant: Instant, events: Events) -> float:
    """Return the time of an instant [s]."""
    if not isinstance(instant, str):
        return instant
    event, offset = split_instant(instant)
    at = events.get(event)
    if at is None:
        raise ValueError(f"no {event} in this run")
    return at + offset


def _settle(time: Array, values: Array, criterion: SignalCriterion) -> float:
    """Time from the window's start until the signal stays in the band."""
    # If it ends outside, the row after the window's last: it settles then at the earliest.
    target = values[-1] if criterion.target is None else criterion.target
    outside = np.flatnonzero(~(np.abs(values - target) <= (criterion.band or 0.0)))
    if not len(outside):
        return 0.0
    if len(time) == 1:
        raise ValueError("has a window of one row, in which nothing settles")
    after = np.append(time, 2.0 * time[-1] - time[-2])
    return float(after[outside[-1] + 1] - time[0])


def _overshoot(_time: Array, values: Array, criterion: SignalCriterion) -> float:
    """Largest deviation from the target on its far side, seen from the first value."""
    # A signal that starts at the target has no far side: its largest deviation counts.
    target = values[-1] if criterion.target is None else criterion.target
    beyond = values - target
    if abs(beyond[0]) <= AT_TARGET * np.abs(beyond).max():
        return float(np.abs(beyond).max())
    return max(float((-np.sign(beyond[0]) * beyond).max()), 0.0)


def _duration(time: Array, inside: NDArray[np.bool_]) -> float:
    """Total time of the steps that begin inside."""
    return float(np.diff(time)[inside[:-1]].sum())


REDUCE: Final[Mapping[str, Reduction]] = {
    "max": lambda _t, x, _c: float(x.max()),
    "min": lambda _t, x, _c: float(x.min()),
    "peak": lambda _t, x, _c: float(np.abs(x).max()),
    "mean": lambda _t, x, _c: float(x.mean()),
    "rms": lambda _t, x, _c: float(np.sqrt(np.mean(x**2))),
    "final": lambda _t, x, _c: float(x[-1]),
    "range": lambda _t, x, _c: float(x.max() - x.min()),
    "settle": _settle,
    "overshoot": _overshoot,
    "duration_above": lambda t, x, c: _duration(t, x > (c.level or 0.0)),
    "duration_below": lambda t, x, c: _duration(t, x < (c.level or 0.0)),
}


def check_signals(criteria: Iterable[SignalCriterion], units: Mapping[str, str]) -> None:
    """Check that each criterion's signals are recorded, and match in shape and unit."""
    shapes = shapes_of(tuple(units))
    for index, criterion in enumerate(criteria, 1):
        with located(f"[[success.signal]] {index}: signal"):
            unit_of(criterion.signal, shapes, units)


def unit_of(signal: Signal, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str]) -> str:
    """Return the unit of a signal; raises ValueError if it is not recorded, or has no one unit."""
    names = names_of(signal)
    columns = [columns_of(name, shapes, units) for name in names]
    kinds = {units[column] for parts in columns for column in parts}
    if len({*map(len, columns)}) > 1:
        sizes = zip(names, map(len, columns), strict=True)
        text = " and ".join(f"{name} has {size}" for name, size in sizes)
        raise ValueError(f"{text} elements; must have the same number")
    if len(kinds) > 1:
        shown = ", ".join(sorted(kinds))
        raise ValueError(f"{' and '.join(names)}: units {shown}; must have the same unit")
    return kinds.pop()


def columns_of(
    name: str, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str]
) -> list[str]:
    """Return the columns of a recorded signal or element; else raises ValueError."""
    if name in units:
        return [name]
    if name not in shapes:
        must = "must be a recorded signal of numbers (`panda-cosim info` lists them)"
        refuse("", name, must, (*shapes, *units), ValueError)
    return [c for c in units if c.startswith(f"{name}[")]


def evaluate(signal: Signal, *operands: Array) -> Array:
    """Return a signal (n, k), with one column per element, of the recorded ones that it needs."""
    parts = [operand.reshape(len(operand), -1) for operand in operands]
    values: Array = parts[0] if len(parts) == 1 else parts[0] - parts[1]
    if not isinstance(signal, str) and signal[0] == "norm":
        values = np.linalg.norm(values, axis=1, keepdims=True)
    return values


def check_bodies(criteria: Iterable[BodyCriterion], units: Mapping[str, str]) -> None:
    """Check that the pose of each body is recorded, else raise `InputError`."""
    posed = [n.removeprefix("plant.").removesuffix(_POSE) for n in units if n.endswith(_POSE)]
    bodies = [name for name in posed if f"plant.{name}_xpos[3]" in units]
    bodies += [BLOCK] if "plant.qpos[16]" in units else []
    must = f"must be a body whose pose is recorded: {', '.join(bodies) or 'there is none'}"
    for index, criterion in enumerate(criteria, 1):
        if criterion.body not in bodies:
            refuse(f"[[success.body]] {index}: body", criterion.body, must, bodies)


def judge_bodies(
    criteria: Iterable[BodyCriterion], recording: Recording, events: Events
) -> Iterator[Criterion]:
    """Judge a run by each bound of each criterion."""
    for criterion in criteria:
        values, reason = {}, None
        try:
            row = row_at(criterion.at, recording.time, events)
            values = _measure_body(criterion, recording, row)
        except ValueError as error:
            reason = str(error)
        for name, bound in criterion.bounds.items():
            direction: Direction = "above" if name.startswith("min_") else "below"
            label, value = criterion.labels[name], values.get(name)
            yield Criterion(label, value, bound, BOUNDS[name], direction, reason)


def _measure_body(criterion: BodyCriterion, recording: Recording, row: int) -> dict[str, float]:
    """Return the value of each bound; raise `ValueError` without a finite pose."""
    at, turn = (f"plant.{criterion.body}_{what}" for what in ("xpos", "xquat"))
    names = [*(f"{at}[{i}]" for i in range(1, 4)), *(f"{turn}[{i}]" for i in range(1, 5))]
    pose = POSE if criterion.body == BLOCK else names  # position, quaternion (w, x, y, z)
    for name in pose:
        if name not in recording:
            raise ValueError(f"{name.partition('[')[0]} is not recorded")
    first, last = np.column_stack([recording[name][[0, row]] for name in pose])
    start, end, (_, x, y, _) = first[:3], last[:3], last[3:].tolist()
    if not (np.isfinite(end).all() and math.isfinite(x * y)):
        raise ValueError("is not finite")
    target = end if criterion.position is None else np.array(criterion.position)
    return {
        "tolerance": float(np.linalg.norm(end - target)),
        "max_tilt": math.degrees(math.acos(min(1.0, max(-1.0, 1 - 2 * (x * x + y * y))))),
        "max_shift": float(np.linalg.norm(end - start)),
        "min_lift": float(end[2] - start[2]),
    }
