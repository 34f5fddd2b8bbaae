"""Tolerances of a run against its reference: a tube around each signal, in value and in time.

Each recorded signal has a half-width in its unit. A signal of our own FMUs has that of `OURS`,
which suits an arm that touches nothing. Any other Real has one of its own size: `OF_RANGE` of its
range in the reference, but no less than `OF_SIZE` of its largest value or its nominal one. What is
no Real must be equal. Changing one start value by 1e-10 moves a run by a thousandth of these
half-widths; a proportional gain that is 5 % too low moves it by ten times their size, most visibly
in `controller.dq`, the joint error. Grasping and releasing amplify rounding; `scale` widens all
tubes of such a scenario.
"""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ..fmus.errors import refuse
from .fields import Quantity, Whole

_OWN: Final = {
    "time": Quantity(0.0, 1.0, "s"),  # a wider tube would hide real differences
    "scale": Quantity(1e-3, 1e6),
    "events": Whole(0, 1_000_000),
}
_VALUE = Quantity(1e-15, 1e15)  # in any unit

OF_RANGE: Final = 1e-5  # the largest of a signal's elements of one unit
OF_SIZE: Final = 1e-9
LEAST_SIZE: Final = 1e-3  # in any unit, so that rounding about 0 is no difference
EQUAL: Final = 0.5  # of Integers, Booleans and Enumerations; a text is at 0 or at infinity

# Half-widths of our own FMUs' signals, by unit.
OURS: Final[Mapping[str, Mapping[str, Mapping[str, float]]]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)
_ELEMENT = re.compile(r"(?P<signal>.+)\[[\d,]+\]", re.A)


@dataclass(frozen=True)
class Tolerances:
    """How far a run may be from its reference: a scenario's section [regression].

    A scenario has one; `tubes.py` makes the widths of all signals from it. It does not say whether
    a run succeeds, which is `Success`.
    """

    time: float | None = None  # half-width of all tubes in time [s]; None: a step of the scenario
    scale: float = 1.0  # factor on the defaults [1]
    events: int = 10  # steps by which an event, such as a grasp, may be earlier or later
    # Half-widths in value that replace the defaults, by signal (`plant.hand_xpos`) or element
    # (`plant.qpos[10]`), in the signal's own unit.
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        stated = {name: getattr(self, name) for name in _OWN if getattr(self, name) is not None}
        checked = {n: _OWN[n].check(f"[regression] {n}", each) for n, each in stated.items()}
        values = {n: _VALUE.check(f"[regression] {n}", each) for n, each in self.values.items()}
        vars(self).update(checked, values=values)

    @classmethod
    def of(cls, section: object) -> object:
        """Make them from a scenario file's section: `time`, `scale`, and the values by name."""
        if not isinstance(section, Mapping):
            return section  # it is one, or is refused as no section
        values = {name: value for name, value in flattened(section) if name not in _OWN}
        return cls(**{name: section[name] for name in _OWN if name in section}, values=values)

    @property
    def section(self) -> dict[str, float | None]:
        """What a scenario's file has: what differs from the defaults."""
        own = {name: getattr(self, name) for name in _OWN}
        return {n: v for n, v in own.items() if v != getattr(Tolerances, n)} | {**self.values}

    def check_names(self, columns: Iterable[str]) -> None:
        """Refuse a tolerance of what is not among the columns of numbers that are recorded."""
        known = dict.fromkeys(n for each in columns for n in (signal_of(each), each) if n != "time")
        for name in self.values:
            if name not in known:
                signals = ", ".join((*_OWN, *dict.fromkeys(map(signal_of, known))))
                must = f"must be a number that is recorded: {signals}, or an element of these"
                refuse("[regression] key", name, must, (*_OWN, *known))

    def ticks(self, step_size: float) -> int:
        """Return the half-width of all tubes in time, in steps."""
        return 1 if self.time is None else round(self.time / step_size)


def of_ours(units: Mapping[str, str]) -> dict[str, Mapping[str, float]]:
    """Return the signals of our own FMUs among columns, each with its half-widths by unit."""
    signals = defaultdict[str, set[str]](set)
    for column, unit in units.items():
        signals[signal_of(column)].add(unit)
    found: dict[str, Mapping[str, float]] = {}
    for table in OURS.values():
        first = next(iter(table))
        for instance in [each.removesuffix(first) for each in signals if each.endswith(first)]:
            own = {f"{instance}{name}": by_unit for name, by_unit in table.items()}
            if all(signals.get(name, {""}) <= by_unit.keys() for name, by_unit in own.items()):
                found |= own
    return found


def signal_of(column: str) -> str:
    """Return the signal of a column: its name without the indices of an element."""
    match = _ELEMENT.fullmatch(column)
    return column if match is None else match["signal"]


def flattened(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what nested tables hold, by names with dots."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
