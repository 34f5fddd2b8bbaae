"""Parameters of a plant, with their ranges, and names and places in its scene; needs no MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Final

from ..assets import SCENES
from ..assets.franka import DEFAULT_ROBOT, ROBOTS

ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
ARM_AND_PALM = (*(f"link{i}" for i in range(8)), "hand")  # bodies that should touch nothing
MOVING_LINKS = ARM_AND_PALM[1:-1]
FINGERS = ("left_finger", "right_finger")
BLOCK, TABLE = "obj", "work_space"
TABLE_TOP = 0.2  # [m] height of the table's top above the floor (scene files)
TABLE_CENTRE = (0.65, 0.30)  # [m] x and y in the world frame (scene files)
TABLE_HALF_SIZE = (0.2, 0.2)  # [m] (scene files)
BLOCK_HALF_HEIGHT = 0.05  # [m] (scene files)
Seven = tuple[float, float, float, float, float, float, float]
_ZEROS: Seven = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ONES: Seven = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def _within(default: Any, low: float, high: float, unit: str) -> Any:
    """Return the field of a parameter, or of several, between two values."""
    return field(default=default, metadata={"range": (low, high), "unit": unit})


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of a plant; a ValueError refuses unknown scenes and values out of their range."""

    scene: str = "tabletop"  # one of `assets.SCENES`
    robot: str = DEFAULT_ROBOT  # one of `assets.franka.ROBOTS`
    # x and y of its centre at the start, world frame, on the floor (scene files).
    block_pos: tuple[float, float] = _within((0.4, -0.2), -1.0, 1.0, "m")
    # Turn of the block about the world's z axis at the start.
    block_yaw: float = _within(0.0, -math.pi, math.pi, "rad")
    block_mass: float = _within(0.18, 0.001, 3.0, "kg")  # up to the rated payload (data sheet)
    # Sliding friction of each contact of the block; MuJoCo's lower bound is 1e-5.
    block_friction: float = _within(1.0, 0.01, 5.0, "1")
    joint_friction: Seven = _within(_ZEROS, 0.0, 100.0, "N.m")  # Coulomb, beyond the model's
    joint_viscous: Seven = _within(_ZEROS, 0.0, 1000.0, "N.m.s/rad")  # beyond the model's
    link_mass_scale: Seven = _within(_ONES, 0.1, 10.0, "1")  # and inertia, share of the model's
    servo_scale: Seven = _within(_ONES, 0.1, 10.0, "1")  # stiffness and damping, the same
    torque_limit_scale: Seven = _within(_ONES, 0.1, 10.0, "1")  # largest torque, the same
    payload: float = _within(0.0, 0.0, 5.0, "kg")  # point mass at the hand's centre of mass

    def __post_init__(self) -> None:
        for kind, name, names in (("scene", self.scene, SCENES), ("robot", self.robot, ROBOTS)):
            if name not in names:
                raise ValueError(f"{kind}: {name!r} is not a {kind}; valid: {', '.join(names)}")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            for i, number in enumerate(value if isinstance(value, tuple) else (value,), start=1):
                if not low <= number <= high:  # false for NaN, too
                    place = f"{name}[{i}]" if isinstance(value, tuple) else name
                    unit = UNITS[name]
                    raise ValueError(
                        f"{place}: {number!r} {unit} is out of range [{low:g}, {high:g}] {unit}"
                    )


_BOUNDED: Final = [p for p in fields(PlantParameters) if p.metadata]
RANGES: Final[dict[str, tuple[float, float]]] = {p.name: p.metadata["range"] for p in _BOUNDED}
UNITS: Final = {p.name: p.metadata["unit"] for p in _BOUNDED}


def block_start_height(x: float, y: float) -> float:
    """Height of the block's centre [m] where it stands on floor or table at (x, y), world [m]."""
    over_table = all(
        abs(place - centre) <= half
        for place, centre, half in zip((x, y), TABLE_CENTRE, TABLE_HALF_SIZE, strict=True)
    )
    return BLOCK_HALF_HEIGHT + (TABLE_TOP if over_table else 0.0)
