"""The robot's limits in one table, and values as shares of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ..assets import franka
from ..assets.fields import Array


@dataclass(frozen=True, eq=False)
class Limit:
    """A limit of the robot."""

    bound: Array  # largest magnitude, one per joint (7,), finger (2,) or hand (1,)
    unit: str


# Joint positions have a range instead, `Q_MIN` to `Q_MAX`.
LIMITS_OF: Final = {
    name: {
        "velocity": Limit(robot.velocity, "rad/s"),  # at any position; see `RobotLimits.speed`
        "acceleration": Limit(robot.acceleration, "rad/s^2"),
        "jerk": Limit(robot.jerk, "rad/s^3"),
        "torque": Limit(franka.TORQUE_MAX, "N.m"),
        "torque rate": Limit(franka.TORQUE_RATE_MAX, "N.m/s"),
        "finger speed": Limit(np.full(2, franka.FINGER_SPEED_MAX), "m/s"),
        "hand speed": Limit(np.full(1, robot.translation[0]), "m/s"),
        "hand acceleration": Limit(np.full(1, robot.translation[1]), "m/s^2"),
        "hand turn": Limit(np.full(1, robot.rotation[0]), "rad/s"),
    }
    for name, robot in franka.ROBOTS.items()
}
LIMITS: Final = LIMITS_OF[franka.DEFAULT_ROBOT]


def shares(quantity: str, values: Array, robot: str = franka.DEFAULT_ROBOT) -> Array:
    """Return values (n, joints, fingers or 1), in a limit's unit, as shares of it [1]."""
    return values / LIMITS_OF[robot][quantity].bound


def robot_of(metadata: Mapping[str, Any]) -> str:
    """Return the name of a recording's robot; older ones do not tell, as there was but one."""
    return str(metadata.get("robot", franka.DEFAULT_ROBOT))
