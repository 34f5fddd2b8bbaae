"""Parameters of a plant, with their ranges, and names in its model; needs no MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches

from ..assets import SCENES

ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
ARM_AND_PALM = (*(f"link{i}" for i in range(8)), "hand")  # bodies that should touch nothing
FINGERS = ("left_finger", "right_finger")
BLOCK, TABLE = "obj", "work_space"
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
    """Parameters of a plant.

    Attributes:
        scene: Name of the MJCF scene, one of `assets.SCENES`.
        block_pos: Where the block's centre starts, x and y in the world frame [m].
        block_yaw: Turn of the block about the world's z axis at the start [rad].
        block_mass: Mass of the block [kg].
        block_friction: Sliding friction of each contact of the block [1].
        joint_friction: Coulomb friction that each joint has beyond the model's [N.m].
        joint_viscous: Viscous friction that each joint has beyond the model's [N.m.s/rad].
        link_mass_scale: Mass and inertia of each link, as a share of the model's [1].
        servo_scale: Stiffness and damping of each servo, as a share of the model's [1].
        torque_limit_scale: Largest torque of each servo, as a share of the model's [1].
        payload: Point mass at the hand's centre of mass [kg].

    Raises:
        ValueError: A value is out of its range or the scene is unknown.
    """

    scene: str = "tabletop"
    block_pos: tuple[float, float] = (0.4, -0.2)
    block_yaw: float = 0.0
    block_mass: float = 0.18
    block_friction: float = 1.0
    joint_friction: Seven = _ZEROS
    joint_viscous: Seven = _ZEROS
    link_mass_scale: Seven = _ONES
    servo_scale: Seven = _ONES
    torque_limit_scale: Seven = _ONES
    payload: float = 0.0

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            near = get_close_matches(self.scene, SCENES, n=1, cutoff=0.0)
            raise ValueError(
                f"scene: {self.scene!r} is not a scene; valid: {', '.join(SCENES)} "
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
