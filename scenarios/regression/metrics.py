"""Compares the numbers of two summaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

SECTIONS: Final = ("tracking", "orientation", "block", "contact", "limits", "energy", "timing")
NOTHING: Final = 1e-9  # smaller changes are rounding, in any unit
# The speed of the machine is not a property of the scenario.
_WALL: Final = ("wall_s", "real_time_factor", "overruns", "worst_lateness_s")


@dataclass(frozen=True)
class Metric:
    """One number of `summary.json`, before and now.

    Attributes:
        name: Section and key, as `tracking.rms_mm` or `limits.torque_share[2]`.
        before: Value in the reference; None: not measured.
        now: Value in the run.
    """

    name: str
    before: float | None
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
        """Size of the change divided by the larger number; 1 if one is missing."""
        if not self.changed:
            return 0.0
        if self.change is None:
            return 1.0
        if abs(self.change) < NOTHING:
            return 0.0
        return abs(self.change) / max(abs(self.before or 0.0), abs(self.now or 0.0))


def compare_metrics(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Metric]:
    """Return all metrics of two summaries, in the file's order.

    Args:
        before: `summary.json` of the reference.
        now: `summary.json` of the run.
    """
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


__all__ = ["Metric", "compare_metrics"]
