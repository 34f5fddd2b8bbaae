"""Judges a run by the scenario's criteria over signals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..definition.criteria import SLACK, Instant, SignalCriterion, split_instant
from ..recording import Recording
from ..recording.reader import shapes_of
from .criterion import Criterion, Direction
from .events import Events
from .reductions import REDUCE, TIMES
from .signals import evaluate, unit_of

Array = NDArray[np.float64]


class UnmeasuredError(ValueError):
    """A criterion has no value in this run; the message says why."""


def judge_signals(
    criteria: Iterable[SignalCriterion], recording: Recording, events: Events
) -> list[Criterion]:
    """Judge a run by each criterion; a criterion with two bounds gives two results.

    Args:
        criteria: The scenario's criteria.
        recording: The run's recording.
        events: The times of its events [s].
    """
    return [judged for criterion in criteria for judged in _judge(criterion, recording, events)]


def _judge(criterion: SignalCriterion, recording: Recording, events: Events) -> list[Criterion]:
    unit, reason, length = "", None, 0.0
    values: list[float] = []
    try:
        unit = unit_of(criterion, shapes_of(recording.columns), recording.units)
        unit = "s" if criterion.reduce in TIMES else unit
        values, length = _measure(criterion, recording, events)
    except ValueError as error:
        reason = str(error)
    # The worst of several elements counts: for an upper bound, the largest.
    bounds: list[tuple[Direction, Callable[[list[float]], float]]] = [
        ("below", max),
        ("above", min),
    ]
    given = [(d, worst) for d, worst in bounds if getattr(criterion, d) is not None]
    judged = []
    for direction, worst in given:
        bound = cast("float", getattr(criterion, direction))
        value = worst(values) if values else None
        if value is not None and criterion.reduce == "settle" and length < value <= bound:
            value, reason = None, f"does not settle within its window of {length:g} s"
        name = f"{criterion.label} {direction}" if len(given) > 1 else criterion.label
        judged.append(Criterion.judge(name, value, bound, unit, direction, reason))
    return judged


def _measure(
    criterion: SignalCriterion, recording: Recording, events: Events
) -> tuple[list[float], float]:
    """Reduce each element; also return the window's length [s].

    Raises:
        UnmeasuredError: There is no value.
    """
    time = recording.time
    start, stop = (_instant(each, events) for each in (criterion.from_, criterion.to))
    rows = (time >= start - SLACK) & (time <= stop + SLACK)
    if not rows.any():
        raise UnmeasuredError(f"no samples from {start:g} to {stop:g} s")
    signal = evaluate(criterion, recording)[rows]
    if not np.isfinite(signal).all():
        raise UnmeasuredError("is not finite")
    within = time[rows]
    values = [REDUCE[criterion.reduce](within, column, criterion) for column in signal.T]
    if any(value is None for value in values):
        raise UnmeasuredError("has a window of one row, in which nothing settles")
    return cast("list[float]", values), float(within[-1] - within[0])


def row_at(instant: Instant, time: Array, events: Events) -> int:
    """Return the row of an instant.

    Raises:
        UnmeasuredError: The run has none then.
    """
    at = _instant(instant, events)
    rows = np.flatnonzero(time <= at + SLACK)
    if not len(rows) or at > time[-1] + SLACK:
        raise UnmeasuredError(f"no sample at {at:g} s")
    return int(rows[-1])


def _instant(instant: Instant, events: Events) -> float:
    if not isinstance(instant, str):
        return instant
    event, offset = split_instant(instant)
    at = events.get(event)
    if at is None:
        raise UnmeasuredError(f"no {event} in this run")
    return at + offset


__all__ = ["UnmeasuredError", "judge_signals", "row_at"]
