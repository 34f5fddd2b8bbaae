"""One judged criterion: value, bound, margin, and their text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, Self

Direction = Literal["below", "above"]


@dataclass(frozen=True)
class Criterion:
    """One condition of success.

    Attributes:
        name: Key in the section [success], or the name of a [[success.signal]].
        value: Measured value; None if it could not be measured.
        bound: Required bound.
        unit: Unit of value and bound.
        ok: Whether it holds.
        direction: The value must be `below` or `above` the bound, or equal to it.
        margin: Distance of the value from the bound, divided by the bound's magnitude (or by 1 if
            that is 0), within [-1, 1]; negative if the criterion is missed, -1 if nothing could
            be measured.
        reason: Why it could not be measured, or None.
    """

    name: str
    value: float | None
    bound: float
    unit: str
    ok: bool
    direction: Direction = "below"
    margin: float = 0.0
    reason: str | None = None

    @classmethod
    def judge(  # noqa: PLR0913 - what a criterion consists of
        cls,
        name: str,
        value: float | None,
        bound: float,
        unit: str,
        direction: Direction,
        reason: str | None = None,
    ) -> Self:
        """Compare a value with its bound."""
        share = margin(value, bound, direction)
        measured = value is not None and math.isfinite(value)
        if not measured:
            reason = reason or ("nothing to measure" if value is None else f"is {value}")
        return cls(
            name=name,
            value=value,
            bound=bound,
            unit=unit,
            ok=measured and share >= 0.0,
            direction=direction,
            margin=share,
            reason=None if measured else reason,
        )

    @classmethod
    def read(cls, summary: Mapping[str, Any]) -> tuple[Self, ...]:
        """Return the criteria of a `summary.json`; reads format 1, too."""
        known = {field.name for field in fields(cls)}
        return tuple(
            cls(**{"direction": _direction(entry), **{k: entry[k] for k in known & entry.keys()}})
            for entry in summary.get("criteria", ())
        )


def _direction(entry: Mapping[str, Any]) -> Direction:
    """Return the direction by the name's first letters, as in format 1."""
    return "above" if str(entry["name"]).startswith("min_") else "below"


def margin(value: float | None, bound: float, direction: Direction) -> float:
    """Return the margin of a value to its bound, within [-1, 1]; negative if missed."""
    if value is None or not math.isfinite(value):
        return -1.0
    distance = bound - value if direction == "below" else value - bound
    return min(1.0, max(-1.0, distance / (abs(bound) or 1.0)))


def quantity(value: float | None, unit: str) -> str:
    """Format a value with its unit; lengths in mm."""
    if value is None:
        return "not measured"
    if unit == "m":
        return f"{value * 1e3:.4g} mm"
    return f"{value:.4g} {unit}" if unit not in ("", "1") else f"{value:.4g}"


def bound_text(criterion: Criterion) -> str:
    """Format the bound with its direction, such as `<= 0.1 mm`."""
    sign = "<=" if criterion.direction == "below" else ">="
    return f"{sign} {quantity(criterion.bound, criterion.unit)}"


def miss_text(criterion: Criterion) -> str:
    """Format a missed criterion, such as `tracking_rms 1.3 mm, allowed 0.1 mm`."""
    word = "allowed" if criterion.direction == "below" else "required"
    value = quantity(criterion.value, criterion.unit)
    reason = f" ({criterion.reason})" if criterion.reason else ""
    return f"{criterion.name} {value}{reason}, {word} {quantity(criterion.bound, criterion.unit)}"


def line(criterion: Criterion) -> str:
    """Format a criterion as a line of a test's output."""
    word = "ok    " if criterion.ok else "missed"
    return f"{word}  {miss_text(criterion)}, margin {criterion.margin:+.0%}"


def missed_text(criteria: Iterable[Criterion]) -> str:
    """List the missed criteria in one line; "" if all hold."""
    return "; ".join(miss_text(criterion) for criterion in criteria if not criterion.ok)


__all__ = [
    "Criterion",
    "Direction",
    "bound_text",
    "line",
    "margin",
    "miss_text",
    "missed_text",
    "quantity",
]
