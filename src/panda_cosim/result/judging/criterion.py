"""One judged criterion: value, bound, margin, and their text.

A criterion holds, is missed, or was not measured, which is neither: its value and margin are None.
Margins are not limited, so that bad runs can be ranked; whatever draws a bar limits it there.
Rankings put a margin of None below all others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from ...fmus.errors import refuse
from ...task.criteria import Direction

Word = Literal["ok", "missed", "not measured"]


@dataclass(frozen=True)
class Criterion:
    """One condition of success; the margin is the distance to the bound by its size, or by 1.

    A value that is not finite counts as not measured.
    """

    name: str  # key in the section [success], or the name of a [[success.signal]]
    value: float | None  # None: not measured, as the margin
    bound: float
    unit: str  # of value and bound
    ok: bool = field(init=False)  # whether it was measured and holds
    direction: Direction = "below"  # where the value must be, seen from the bound; or equal to it
    margin: float | None = field(init=False, default=None)
    reason: str | None = None  # why it could not be measured

    def __post_init__(self) -> None:
        value, share, reason = self.value, None, None
        if value is None or not math.isfinite(value):
            reason = self.reason or ("nothing to measure" if value is None else f"is {value}")
            value = None
        else:
            distance = self.bound - value if self.direction == "below" else value - self.bound
            share = distance / (abs(self.bound) or 1.0)
        is_ok = share is not None and share >= 0.0
        vars(self).update(value=value, ok=is_ok, margin=share, reason=reason)

    @property
    def word(self) -> Word:
        """Its outcome."""
        return "ok" if self.ok else "not measured" if self.value is None else "missed"

    @classmethod
    def read(cls, summary: Mapping[str, object]) -> tuple[Self, ...]:
        """Return the criteria of a `summary.json`; reads formats 1 and 2, too."""
        # Margins are computed anew: format 1 has none, and format 2 limited them.
        entries = summary.get("criteria", ())
        if not isinstance(entries, list | tuple):
            refuse("criteria", entries, "must be a list")
        return tuple(cls._read(entry) for entry in entries)

    @classmethod
    def _read(cls, entry: Any) -> Self:
        try:
            name, value = str(entry["name"]), entry["value"]
            numbers = None if value is None else float(value), float(entry["bound"])
            direction = entry.get("direction", "above" if name.startswith("min_") else "below")
            return cls(name, *numbers, str(entry["unit"]), direction, entry.get("reason"))
        except (LookupError, TypeError, AttributeError, ValueError):
            refuse("criteria", entry, "must be a judged criterion")


def verdict_of(criteria: Iterable[Criterion]) -> Word:
    """Return the outcome of all: one that is missed decides, whatever was not measured."""
    words = {criterion.word for criterion in criteria}
    return "missed" if "missed" in words else "not measured" if "not measured" in words else "ok"


def smallest_margin(criteria: Sequence[Criterion]) -> float | None:
    """Return the smallest margin that was measured; None: there is no verdict or no criterion."""
    known = [criterion.margin for criterion in criteria if criterion.margin is not None]
    return None if verdict_of(criteria) == "not measured" else min(known, default=None)


def quantity(value: float | None, unit: str, *, is_bound: bool = False) -> str:
    """Format a value with its unit; lengths in mm, measured ones to 0.1 um."""
    if value is None:
        return "not measured"
    if unit == "m":
        value, unit = value * 1e3 if is_bound else round(value * 1e3, 4), "mm"
    return f"{value:.4g} {unit}" if unit not in ("", "1") else f"{value:.4g}"


def bound_text(criterion: Criterion) -> str:
    """Format the bound with its direction, such as `<= 0.1 mm`."""
    sign = "<=" if criterion.direction == "below" else ">="
    return f"{sign} {quantity(criterion.bound, criterion.unit, is_bound=True)}"


def margin_text(criterion: Criterion) -> str:
    """Format the margin as a share of the bound, or in its unit if the bound is zero."""
    if criterion.margin is None or criterion.value is None:
        return "none"
    if not criterion.bound:
        sign = -1.0 if criterion.direction == "below" else 1.0
        return quantity(sign * criterion.value + 0.0, criterion.unit)
    many = abs(criterion.margin) >= 10.0
    return f"{criterion.margin:+.3g} x" if many else f"{criterion.margin:+.0%}"


def cells(criterion: Criterion) -> tuple[str, str, str, str, str]:
    """Return a row of a table: name, measured, required, margin, outcome."""
    measured = criterion.reason or quantity(criterion.value, criterion.unit)
    required, share = bound_text(criterion), margin_text(criterion)
    return criterion.name, measured, required, share, criterion.word


def miss_text(criterion: Criterion) -> str:
    """Format a criterion that does not hold, such as `tracking_rms 1.3 mm, allowed 0.1 mm`."""
    word = "allowed" if criterion.direction == "below" else "required"
    value = quantity(criterion.value, criterion.unit)
    bound = quantity(criterion.bound, criterion.unit, is_bound=True)
    reason = f" ({criterion.reason})" if criterion.reason else ""
    return f"{criterion.name} {value}{reason}, {word} {bound}"


def line(criterion: Criterion) -> str:
    """Format a criterion as a line of a test's output."""
    return f"{criterion.word:<6}  {miss_text(criterion)}, margin {margin_text(criterion)}"


def missed_text(criteria: Iterable[Criterion]) -> str:
    """List the criteria that are missed or not measured in one line; "" if all hold."""
    return "; ".join(miss_text(criterion) for criterion in criteria if not criterion.ok)
