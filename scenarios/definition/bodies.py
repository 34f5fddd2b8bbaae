"""Success criteria about bodies by name, the sections [[success.body]] of scenario.toml.

```toml
[[success.body]]
body = "obj"                     # a free body of the scene
position = [0.6, 0.35, 0.35]     # m, of its origin, world frame
tolerance = 0.005                # m around it
max_tilt = 2.0                   # deg of its z axis
at = "end"                       # s, or one of the run's events
```
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from types import MappingProxyType
from typing import Annotated, Any, Final

from pydantic import PlainValidator

from ..fields import Line, Quantity, Vector, checked
from .criteria import ALWAYS, Instant, check_instant, check_within
from .table import POSITION

BLOCK: Final = "obj"  # the body of PandaPlant's block
BOUNDS: Final[Mapping[str, str]] = MappingProxyType(
    {"tolerance": "m", "max_tilt": "deg", "max_shift": "m", "min_lift": "m"}
)
"""Bounds of a body's criteria, with their units."""
_LENGTH = Quantity(0.0, 10.0, "m")


@checked
class BodyCriterion:
    """A criterion on one free body at one instant.

    Attributes:
        body: Its name in the scene.
        position: Where its origin must be, world frame [m].
        tolerance: How near [m].
        max_tilt: Largest angle of its z axis to the world's [deg].
        max_shift: How far its origin may be from where it started [m].
        min_lift: How much higher than at the start it must be [m].
        at: The instant [s], or an event such as "release + 0.5".

    Raises:
        InputError: A value cannot be used.
    """

    body: Annotated[str, Line()]
    position: Annotated[tuple[float, float, float], Vector(3, POSITION)] | None = None
    tolerance: Annotated[float, _LENGTH] | None = None
    max_tilt: Annotated[float, Quantity(0.0, 180.0, "deg")] | None = None
    max_shift: Annotated[float, _LENGTH] | None = None
    min_lift: Annotated[float, Quantity(-10.0, 10.0, "m")] | None = None
    at: Annotated[Instant, PlainValidator(check_instant)] = "end"

    def __post_init__(self) -> None:
        """Check that a position comes with its tolerance, and that there is a bound."""
        if (self.position is None) != (self.tolerance is None):
            raise ValueError("position and tolerance: only one is given; must be both or none")
        if not self.bounds:
            raise ValueError(f"no bound is given; must have one of {', '.join(BOUNDS)}")
        if self.max_tilt == 180.0:
            raise ValueError(f"max_tilt: value 180.0; every body meets it, {ALWAYS}")

    def check_window(self, start: float, end: float) -> None:
        """Check that the instant, unless it is an event's, lies within a run [s].

        Raises:
            ValueError: It does not.
        """
        check_within("at", self.at, start, end)

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that are given."""
        return {name: value for name, value in asdict(self).items()
                if name in BOUNDS and value is not None}  # fmt: skip

    @property
    def signals(self) -> tuple[str, ...]:
        """Recorded signals that hold its pose: position and quaternion, or qpos of the block."""
        if self.body == BLOCK:
            return ("plant.qpos",)
        return (f"plant.{self.body}_xpos", f"plant.{self.body}_xquat")


def body_keys(criterion: BodyCriterion) -> dict[str, Any]:
    """Return a criterion's keys and values as scenario.toml has them."""
    return {key: value for key, value in asdict(criterion).items() if value is not None}
