"""The robots in numbers: limits, servos, start.

The limits are what the real robots accept over their control interface, in fer.toml and fr3.toml,
which name their sources; the rest is of the MJCF files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from . import asset_path

Array = NDArray[np.float64]

LIMIT_FILES: Final = ("fer", "fr3")
LEAST: Final = 1e-3  # [rad/s] that is left at a joint's end (libfranka's kLimitEps)


@dataclass(frozen=True, eq=False)
class RobotLimits:
    """Limits of one robot; its file says what they are."""

    q_min: Array  # (7,) [rad]
    q_max: Array  # (7,) [rad]
    velocity: Array  # (7,) [rad/s], anywhere
    acceleration: Array  # (7,) [rad/s^2]
    jerk: Array  # (7,) [rad/s^3]
    torque: Array  # (7,) [N.m]
    torque_rate: Array  # (7,) [N.m/s]
    translation: Array  # (3,) [m/s], [m/s^2], [m/s^3]
    rotation: Array  # (3,) [rad/s], [rad/s^2], [rad/s^3]
    elbow: Array  # (3,) [rad/s], [rad/s^2], [rad/s^3]
    collision_torque: Array  # (7,) [N.m]
    collision_force: Array  # (6,) [N], [N.m]
    approach: dict[str, Array]  # empty: the velocity does not depend on the position
    lost_packets: int

    def speed(self, q: Array, qd: Array) -> Array:
        """Return the highest speed (n, 7) [rad/s] at positions q, towards where qd leads (n, 7)."""
        if not self.approach:
            return np.broadcast_to(self.velocity, q.shape)
        ends = self.approach
        room = np.where(qd < 0.0, q - ends["low"], ends["high"] - q)
        speed = np.sqrt(2.0 * ends["braking"] * np.maximum(room, 0.0)) - ends["offset"]
        return np.clip(speed, LEAST, self.velocity)


@cache
def robot_limits(name: str) -> RobotLimits:
    """Read the limits of one of `LIMIT_FILES`."""
    data = tomllib.loads(asset_path(f"{name}.toml").read_text(encoding="utf-8"))
    packets = data.pop("packets")["lost"]
    arrays = {s: {key: np.array(v) for key, v in keys.items()} for s, keys in data.items()}
    collision = {f"collision_{key}": value for key, value in arrays["collision"].items()}
    approach = arrays.get("approach", {})
    return RobotLimits(
        **arrays["joint"], **arrays["hand"], **collision, approach=approach, lost_packets=packets
    )


DEFAULT_ROBOT: Final = "panda"
PANDA: Final = robot_limits("fer")
ROBOTS: Final[Mapping[str, RobotLimits]] = {"panda": PANDA, "fr3": robot_limits("fr3")}
Q_MAX, Q_MIN, QD_MAX = PANDA.q_max, PANDA.q_min, PANDA.velocity  # of the default robot
QDD_MAX, QDDD_MAX = PANDA.acceleration, PANDA.jerk
# Of either robot.
TORQUE_MAX: Final = PANDA.torque  # [N.m]
TORQUE_RATE_MAX: Final = PANDA.torque_rate  # [N.m/s]

OPENING_MAX: Final = 0.08  # [m] between the fingertips (Franka Hand data sheet)
GRIP_FORCE_MAX: Final = 30.0  # [N] per finger; the hand's data sheet: 70 N for both, continuously
GRIP_STIFFNESS: Final = 1000.0  # [N/m] of each finger's servo in tabletop.xml
BLOCK_WIDTH: Final = 0.06  # [m] of the scenes' block, between the fingers
FINGER_SPEED_MAX: Final = 0.05  # [m/s] per finger (Franka Hand data sheet)

Seven = tuple[float, float, float, float, float, float, float]
HOME_Q: Final[Seven] = (0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853)  # [rad] keyframe `home`
# The hand's body there, world frame: [m], and (w, x, y, z), 0.1 mrad off a half turn.
HOME_XPOS: Final = (0.5544994780317353, 0.0, 0.6245024294875894)
HOME_XQUAT: Final = (0.0, 0.707141498682236, 0.7070720619862167, 0.0)
CTRL_OPEN: Final = 255.0  # [1] gripper servo target at OPENING_MAX
# Stiffness of the servos [N.m/rad], their damping, and their lag behind a ramp [s]:
# (servo damping + the Panda's joint damping) / stiffness.
SERVO_STIFFNESS: Final[Seven] = (4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0)
SERVO_DAMPING: Final[Seven] = (450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0)  # [N.m.s/rad]
JOINT_DAMPING: Final = {"panda": 1.0, "fr3": 0.21}  # [N.m.s/rad] of each joint
SERVO_LAG = cast(Seven, tuple(0.1 + 1.0 / k for k in SERVO_STIFFNESS))
