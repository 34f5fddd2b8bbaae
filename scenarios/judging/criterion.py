"""One judged criterion: value, bound, margin, and their text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, Self

from ...fmus.errors import InputError
from ...fmus.messages import excerpt

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
        """Return the criteria of a `summary.json`; reads format 1, too.

        Raises:
            InputError: They are damaged.
        """
        entries = summary.get("criteria", ())
        if not isinstance(entries, list | tuple):
            raise InputError(f"criteria: value {excerpt(entries)}; must be a list")
        return tuple(cls._read(entry) for entry in entries)

    @classmethod
    def _read(cls, entry: Any) -> Self:
        known = {field.name for field in fields(cls)}
        try:
            first = {"direction": "above" if entry["name"].startswith("min_") else "below"}
            read = cls(**(first | {key: entry[key] for key in known & entry.keys()}))
        except (LookupError, TypeError, AttributeError):
            read = None
        if read is None or not read._is_whole():
            raise InputError(f"criteria: value {excerpt(entry)}; must be a judged criterion")
        return read

    def _is_whole(self) -> bool:
        """Whether everything that was read is of its type."""
        texts = (self.name, self.unit, "" if self.reason is None else self.reason)
        numbers = (0.0 if self.value is None else self.value, self.bound, self.margin)
        return (
            all(isinstance(text, str) for text in texts)
            and all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
            and isinstance(self.ok, bool)
            and self.direction in ("above", "below")
        )


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


def margin_text(criterion: Criterion) -> str:
    """Format the margin: as a share of the bound, or in its unit if the bound is zero."""
    if criterion.bound or criterion.value is None or not math.isfinite(criterion.value):
        return f"{criterion.margin:+.0%}"
    sign = -1.0 if criterion.direction == "below" else 1.0
    return quantity(sign * criterion.value + 0.0, criterion.unit)


def miss_text(criterion: Criterion) -> str:
    """Format a missed criterion, such as `tracking_rms 1.3 mm, allowed 0.1 mm`."""
    word = "allowed" if criterion.direction == "below" else "required"
    value = quantity(criterion.value, criterion.unit)
    reason = f" ({criterion.reason})" if criterion.reason else ""
    return f"{criterion.name} {value}{reason}, {word} {quantity(criterion.bound, criterion.unit)}"


def line(criterion: Criterion) -> str:
    """Format a criterion as a line of a test's output."""
    word = "ok    " if criterion.ok else "missed"
    return f"{word}  {miss_text(criterion)}, margin {margin_text(criterion)}"


def missed_text(criteria: Iterable[Criterion]) -> str:
    """List the missed criteria in one line; "" if all hold."""
    return "; ".join(miss_text(criterion) for criterion in criteria if not criterion.ok)


__all__ = [
    "Criterion",
    "Direction",
    "bound_text",
    "line",
    "margin",
    "margin_text",
    "miss_text",
    "missed_text",
    "quantity",
]
