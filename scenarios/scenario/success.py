"""Success conditions of a scenario, [success], and those about bodies by name, [[success.body]]."""

from dataclasses import replace
from typing import Annotated, Final, Self

from pydantic import BeforeValidator, PlainValidator

from ...fmus.messages import excerpt
from ..fields import Line, Quantity, Vector, checked, field_names
from .criteria import Instant, SignalCriterion, check_instant, check_within, from_toml
from .table import POSITION

BLOCK: Final = "obj"  # the body of PandaPlant's block
# Bounds of a body's criteria, with their units.
BOUNDS: Final = {"tolerance": "m", "max_tilt": "deg", "max_shift": "m", "min_lift": "m"}
_LENGTH = Quantity(0.0, 10.0, "m")
_ANGLE = Quantity(0.0, 180.0, "deg")


@checked
class BodyCriterion:
    """A criterion on one free body at one instant."""

    body: Annotated[str, Line()]  # its name in the scene
    # Where its origin must be, world frame [m], and how near.
    position: Annotated[tuple[float, float, float], Vector(3, POSITION)] | None = None
    tolerance: Annotated[float, _LENGTH] | None = None  # [m]
    # Largest angle of its z axis to the world's [deg].
    max_tilt: Annotated[float, _ANGLE] | None = None
    max_shift: Annotated[float, _LENGTH] | None = None  # of its origin from where it started [m]
    min_lift: Annotated[float, Quantity(-10.0, 10.0, "m")] | None = None  # above the start [m]
    at: Annotated[Instant, PlainValidator(check_instant)] = "end"  # [s], or an event

    def __post_init__(self) -> None:
        if (self.position is None) != (self.tolerance is None):
            raise ValueError("position and tolerance: one is missing; must be both or neither")
        if not self.bounds:
            raise ValueError(f"no bound; must have at least one of {', '.join(BOUNDS)}")

    def check_window(self, start: float, end: float) -> None:
        """Check that the instant, unless it is an event's, lies within a run [s]."""
        check_within("at", self.at, start, end)

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that are given."""
        values = {name: getattr(self, name) for name in BOUNDS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def signals(self) -> tuple[str, ...]:
        """Recorded signals that hold its pose: position and quaternion, or qpos of the block."""
        if self.body == BLOCK:
            return ("plant.qpos",)
        return (f"plant.{self.body}_xpos", f"plant.{self.body}_xquat")


@checked
class Success:
    """Conditions for a run to count as a success; those that are None are not judged.

    Raises:
        InputError: A bound is out of range, or a position has no tolerance.
    """

    # Where the block's centre must be half a second after its release (at the end, if it is not
    # released by then), in world [m], and how near [m]. Yaw and tilt are of that instant, too.
    block_position: Annotated[tuple[float, float, float], Vector(3, POSITION)] | None = None
    position_tolerance: Annotated[float, _LENGTH] | None = None
    # Block about z against the world's axes, modulo 90 deg as it is square [deg].
    max_yaw_error: Annotated[float, Quantity(0.0, 45.0, "deg")] | None = None
    # Block's z axis against the world's [deg].
    max_tilt: Annotated[float, _ANGLE] | None = None
    # Distance between hand and command over all ticks, root mean square and maximum [m].
    tracking_rms: Annotated[float, _LENGTH] | None = None
    tracking_max: Annotated[float, _LENGTH] | None = None
    # Angle between hand and command over all ticks, root mean square [deg].
    orientation_rms: Annotated[float, _ANGLE] | None = None
    # How far the block was lifted while it was held [m].
    min_lift: Annotated[float, Quantity(0.0, 2.0, "m")] | None = None
    # How far the block moved in the hand while it was carried [m].
    max_slip: Annotated[float, Quantity(0.0, 1.0, "m")] | None = None
    # How far it fell when it was released [m], and how hard it was set down [N].
    max_drop: Annotated[float, Quantity(0.0, 10.0, "m")] | None = None
    max_set_down_force: Annotated[float, Quantity(0.0, 1e6, "N")] | None = None
    # Largest share of any limit of the robot; 1 is the limit. See `limits` in summary.json.
    max_limit_share: Annotated[float, Quantity(0.0, 1000.0, "1")] | None = None
    # Largest sum of the forces of unwanted contacts, `plant.unwanted_contact_force` [N].
    max_unwanted_force: Annotated[float, Quantity(0.0, 1e6, "N")] | None = None
    # What the real robot that `preflight` names would refuse, see there.
    max_refusals: Annotated[float, Quantity(0.0, 100.0, "1")] | None = None

    # Criteria over recorded signals, [[success.signal]].
    signal: tuple[Annotated[SignalCriterion, BeforeValidator(from_toml)], ...] = ()
    # Criteria about free bodies by name, [[success.body]].
    body: tuple[BodyCriterion, ...] = ()

    def __post_init__(self) -> None:
        if (self.block_position is None) != (self.position_tolerance is None):
            raise ValueError(
                "block_position and position_tolerance: one is missing; must be both or neither"
            )
        taken = set(field_names(Success))
        for criterion in self.signal:
            if criterion.label in taken:
                raise ValueError(f"name {excerpt(criterion.label)} is taken; must be unique")
            taken.add(criterion.label)

    def within(self, end: float) -> Self:
        """Return the criteria that a run from 0 to `end` [s] can measure."""

        def fits(criterion: SignalCriterion | BodyCriterion) -> bool:
            try:
                criterion.check_window(0.0, end)
            except ValueError:
                return False
            return True

        body = tuple(each for each in self.body if fits(each))
        return replace(self, body=body, signal=tuple(each for each in self.signal if fits(each)))

    def check_windows(self, start: float, end: float) -> None:
        """Check that all instants lie within a run from `start` to `end` [s]."""
        for section in ("signal", "body"):
            for number, criterion in enumerate(getattr(self, section), 1):
                try:
                    criterion.check_window(start, end)
                except ValueError as error:
                    raise ValueError(f"[[success.{section}]] {number}: {error}") from None
