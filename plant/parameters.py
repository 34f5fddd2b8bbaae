"""Parameters of a plant, with their ranges, and names and places in its scene; needs no MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..assets import SCENES
from ..assets.fields import bounded, switch
from ..assets.franka import DEFAULT_ROBOT, ROBOTS, Seven

ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
ARM_AND_PALM = (*(f"link{i}" for i in range(8)), "hand")  # bodies that should touch nothing
MOVING_LINKS = ARM_AND_PALM[1:-1]
FINGERS = ("left_finger", "right_finger")
BLOCK, TABLE = "obj", "work_space"
TABLE_TOP = 0.2  # [m] height of the table's top above the floor (scene files)
TABLE_CENTRE = (0.65, 0.30)  # [m] x and y in the world frame (scene files)
TABLE_HALF_SIZE = 0.2  # [m] along either side (scene files)
BLOCK_HALF_HEIGHT = 0.05  # [m] (scene files)


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of a plant. The FMU's interface checks their ranges."""

    scene: str = switch("tabletop", SCENES)
    robot: str = switch(DEFAULT_ROBOT, ROBOTS)
    # x and y of its centre at the start, world frame, on the floor (scene files).
    block_pos: tuple[float, float] = bounded((0.4, -0.2), "m", -1.0, 1.0)
    # Turn of the block about the world's z axis at the start.
    block_yaw: float = bounded(0.0, "rad", -math.pi, math.pi)
    block_mass: float = bounded(0.18, "kg", 0.001, 3.0)  # up to the rated payload (data sheet)
    # Sliding friction of each contact of the block; MuJoCo's lower bound is 1e-5.
    block_friction: float = bounded(1.0, "1", 0.01, 5.0)
    joint_friction: Seven = bounded((0.0,) * 7, "N.m", 0.0, 100.0)  # Coulomb, beyond the model's
    joint_viscous: Seven = bounded((0.0,) * 7, "N.m.s/rad", 0.0, 1000.0)  # beyond the model's
    # Shares of the model's.
    link_mass_scale: Seven = bounded((1.0,) * 7, "1", 0.1, 10.0)  # and inertia
    servo_scale: Seven = bounded((1.0,) * 7, "1", 0.1, 10.0)  # stiffness and damping
    torque_limit_scale: Seven = bounded((1.0,) * 7, "1", 0.1, 10.0)  # largest torque
    payload: float = bounded(0.0, "kg", 0.0, 5.0)  # point mass at the hand's centre of mass


def block_start_height(x: float, y: float) -> float:
    """Height of the block's centre [m] where it stands on floor or table at (x, y), world [m]."""
    away = abs(x - TABLE_CENTRE[0]), abs(y - TABLE_CENTRE[1])
    over_table = max(away) <= TABLE_HALF_SIZE
    return BLOCK_HALF_HEIGHT + (TABLE_TOP if over_table else 0.0)
