"""Parameters of a plant, with their ranges, and names and places in its scene; needs no MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches

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
MASS_RANGE = (0.001, 3.0)  # [kg] up to the arm's rated payload (Franka data sheet)
FRICTION_RANGE = (0.01, 5.0)  # [1] sliding friction; MuJoCo's lower bound is 1e-5
POSITION_RANGE = (-1.0, 1.0)  # [m] the floor's half size (scene files)
YAW_RANGE = (-math.pi, math.pi)  # [rad]
JOINT_FRICTION_RANGE = (0.0, 100.0)  # [N.m]
JOINT_VISCOUS_RANGE = (0.0, 1000.0)  # [N.m.s/rad]
SCALE_RANGE = (0.1, 10.0)  # [1] relative to the model
PAYLOAD_RANGE = (0.0, 5.0)  # [kg]
Seven = tuple[float, float, float, float, float, float, float]
_ZEROS: Seven = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ONES: Seven = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
_RANGES = {
    "joint_friction": (JOINT_FRICTION_RANGE, "N.m"),
    "joint_viscous": (JOINT_VISCOUS_RANGE, "N.m.s/rad"),
    "link_mass_scale": (SCALE_RANGE, "1"),
    "servo_scale": (SCALE_RANGE, "1"),
    "torque_limit_scale": (SCALE_RANGE, "1"),
}


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of a plant; a ValueError refuses unknown scenes and values out of their range."""

    scene: str = "tabletop"  # one of `assets.SCENES`
    robot: str = DEFAULT_ROBOT  # one of `assets.franka.ROBOTS`
    block_pos: tuple[float, float] = (0.4, -0.2)  # [m] x and y of its centre at the start, world
    block_yaw: float = 0.0  # [rad] turn of the block about the world's z axis at the start
    block_mass: float = 0.18  # [kg]
    block_friction: float = 1.0  # [1] sliding friction of each contact of the block
    joint_friction: Seven = _ZEROS  # [N.m] Coulomb friction of each joint beyond the model's
    joint_viscous: Seven = _ZEROS  # [N.m.s/rad] viscous friction of each beyond the model's
    link_mass_scale: Seven = _ONES  # [1] mass and inertia of each link, share of the model's
    servo_scale: Seven = _ONES  # [1] stiffness and damping of each servo, share of the model's
    torque_limit_scale: Seven = _ONES  # [1] largest torque of each servo, share of the model's
    payload: float = 0.0  # [kg] point mass at the hand's centre of mass

    def __post_init__(self) -> None:
        for kind, name, names in (("scene", self.scene, SCENES), ("robot", self.robot, ROBOTS)):
            if name not in names:
                near = get_close_matches(name, names, n=1, cutoff=0.0)
                raise ValueError(
                    f"{kind}: {name!r} is not a {kind}; valid: {', '.join(names)} "
                    f"(did you mean {near[0]!r}?)"
                )
        _check("block_pos[1]", self.block_pos[0], POSITION_RANGE, "m")
        _check("block_pos[2]", self.block_pos[1], POSITION_RANGE, "m")
        _check("block_yaw", self.block_yaw, YAW_RANGE, "rad")
        _check("block_mass", self.block_mass, MASS_RANGE, "kg")
        _check("block_friction", self.block_friction, FRICTION_RANGE, "1")
        _check("payload", self.payload, PAYLOAD_RANGE, "kg")
        for name, (bounds, unit) in _RANGES.items():
            for i, value in enumerate(getattr(self, name), start=1):
                _check(f"{name}[{i}]", value, bounds, unit)


def _check(name: str, value: float, bounds: tuple[float, float], unit: str) -> None:
    """Refuse a value that is not finite or not within its bounds."""
    low, high = bounds
    if not low <= value <= high:  # false for NaN, too
        raise ValueError(f"{name}: {value!r} {unit} is out of range [{low:g}, {high:g}] {unit}")


def block_start_height(x: float, y: float) -> float:
    """Height of the block's centre [m] where it stands on floor or table at (x, y), world [m]."""
    over_table = all(
        abs(place - centre) <= half
        for place, centre, half in zip((x, y), TABLE_CENTRE, TABLE_HALF_SIZE, strict=True)
    )
    return BLOCK_HALF_HEIGHT + (TABLE_TOP if over_table else 0.0)
