"""Units, by their SI base units, and conversion; those of our FMUs are in units.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

Units = Mapping[str, "Unit"]
PLAIN: Final = (1.0, 0.0)  # factor and offset that change nothing
BASES: Final = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # FMI counts rad among them
_OURS: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
DISPLAY_UNITS: Final[Mapping[str, tuple[str, float]]] = _OURS["display"]
NOMINALS: Final[Mapping[str, float]] = _OURS["nominal"]


@dataclass(frozen=True)
class Unit:
    """A unit: a value in base units is factor * value + offset."""

    exponents: tuple[int, ...]  # of the `BASES`
    factor: float = 1.0
    offset: float = 0.0

    def attributes(self) -> dict[str, float | None]:
        """FMI's and SSP's attributes of a unit; None where it is as usual."""
        exponents = {base: e or None for base, e in zip(BASES, self.exponents, strict=True)}
        factor = None if self.factor == 1.0 else self.factor
        return {**exponents, "factor": factor, "offset": self.offset or None}


OUR_UNITS: Final[Units] = {
    name: Unit(tuple(exponents.get(base, 0) for base in BASES))
    for name, exponents in _OURS["base"].items()
}


def conversion(
    source: str, sources: Units, target: str, targets: Units
) -> tuple[float, float] | None:
    """Factor and offset from one unit to another by both sides' definitions; None: there are none.

    Without both definitions, values are taken as they are; `doubt` says why that may be wrong.
    """
    one, other = sources.get(source), targets.get(target)
    if one is None or other is None:
        return PLAIN
    if one.exponents != other.exponents:
        return None
    return one.factor / other.factor, (one.offset - other.offset) / other.factor


def doubt(source: str, sources: Units, target: str, targets: Units) -> str:
    """Say what is not known about a conversion; "" if nothing is, or it makes no difference."""
    if source == target or {source, target} <= {"", "1"}:
        return ""
    if not (source and target):
        return "only one side has a unit"
    undefined = [s for s, units in ((source, sources), (target, targets)) if s not in units]
    return f"no definition of {' and '.join(undefined)}" if undefined else ""
