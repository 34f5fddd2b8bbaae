"""Units, by their SI base units, and conversion between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

PLAIN: Final = (1.0, 0.0)  # factor and offset that change nothing
BASES: Final = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # FMI counts rad among them


@dataclass(frozen=True)
class Unit:
    """A unit: a value in base units is factor * value + offset."""

    exponents: tuple[int, ...]  # of the `BASES`
    factor: float = 1.0
    offset: float = 0.0


Units = Mapping[str, Unit]


def conversion(
    source: str, sources: Units, target: str, targets: Units
) -> tuple[float, float] | None:
    """Factor and offset from one unit to another by both sides' definitions, or None."""
    # Equal names need no definition, and values without a unit are taken as they are.
    if source == target or not (source and target):
        return PLAIN
    one, other = sources.get(source), targets.get(target)
    if one is None or other is None or one.exponents != other.exponents:
        return None
    return one.factor / other.factor, (one.offset - other.offset) / other.factor
