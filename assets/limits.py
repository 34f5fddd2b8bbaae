"""What the real robots accept over their control interface: fer.toml, fr3.toml name the sources."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from . import ASSETS
from .fields import Array

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
    data = tomllib.loads((ASSETS / f"{name}.toml").read_text(encoding="utf-8"))
    approach = {key: np.array(value) for key, value in data.pop("approach", {}).items()}
    arrays = {key: np.array(value) for key, value in data.items() if key != "lost_packets"}
    return RobotLimits(**arrays, approach=approach, lost_packets=data["lost_packets"])
