"""Compares the numbers of two summaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

SECTIONS: Final = ("tracking", "orientation", "block", "contact", "limits", "energy", "timing")
SMALL: Final = 1e-3  # in any unit; changes of smaller numbers are judged as if they were this large
# The speed of the machine is not a property of the scenario.
_WALL: Final = ("wall_s", "real_time_factor", "overruns", "worst_lateness_s")


@dataclass(frozen=True)
class Metric:
    """One number of `summary.json`, before and now."""

    name: str  # section and key, as `tracking.rms_mm` or `limits.torque_share[2]`
    before: float | None  # None: not measured
    now: float | None

    @property
    def changed(self) -> bool:
        """Whether the two numbers differ."""
        return self.before != self.now

    @property
    def change(self) -> float | None:
        """The increase; None if one of the values is missing."""
        return None if self.before is None or self.now is None else self.now - self.before

    @property
    def relative(self) -> float:
        """Relative change, see `relative_change`."""
        return relative_change(self.before, self.now)


def relative_change(before: object, now: object) -> float:
    """Return the size of a change, divided by the larger number; 1 if one is not a number.

    Numbers below `SMALL` count as `SMALL`, so that rounding of what is 0 is no large change.
    """
    if before == now:
        return 0.0
    if not (_is_number(before) and _is_number(now)):
        return 1.0
    a, b = float(before), float(now)  # type: ignore[arg-type]
    return abs(b - a) / max(abs(a), abs(b), SMALL)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def compare_metrics(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Metric]:
    """Return all metrics of two summaries, in the file's order."""
    old, new = dict(_flatten(before)), dict(_flatten(now))
    # A metric that older summaries lack and that is 0 now has not changed.
    names = [name for name in {**new, **old} if name in old or new[name]]
    return [Metric(name, old.get(name), new.get(name)) for name in names]


def _flatten(summary: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    for section in SECTIONS:
        content = summary.get(section)
        for key, value in content.items() if isinstance(content, Mapping) else ():
            items = enumerate(value, 1) if isinstance(value, list) else ()
            named = [(f"[{i}]", item) for i, item in items] or [("", value)]
            for index, item in named:
                if key not in _WALL and (item is None or isinstance(item, int | float)):
                    yield f"{section}.{key}{index}", item
