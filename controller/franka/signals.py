"""What the robot reads and writes in a tick, and how it is set up; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import bounded, switch

INPUTS: Final = np.dtype([
    ("qpos", float, 9), ("qvel", float, 7), ("hand_xpos", float, 3), ("hand_xquat", float, 4),
    ("jac", float, (6, 7)), ("qfrc_bias", float, 7), ("actuator_force", float, 8),
])  # fmt: skip
OUTPUTS: Final = np.dtype([
    ("ctrl", float, 8), ("grip_cmd", float), ("robot_mode", float), ("motion_generator", float),
    ("controller_mode", float), ("errors", float), ("success_rate", float), ("q_c", float, 7),
    ("dq_c", float, 7), ("O_T_EE_c", float, 16), ("tau_J_d", float, 7),
])  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """Where the robot listens, and the line between it and the program.

    `fmus/interface/franka.toml` says what each of them is.
    """

    address: str = switch("127.0.0.1")
    port: float = bounded(1337.0, "1", 1.0, 65535.0, 1.0)
    gripper_port: float = bounded(1338.0, "1", 1.0, 65535.0, 1.0)
    connection_timeout: float = bounded(0.0, "s", 0.0, 1e6)
    delay: float = bounded(0.0, "s", 0.0, 0.1, STEP_SIZE)
    dropout: float = bounded(0.0, "1", 0.0, 1.0)
    seed: float = bounded(0.0, "1", 0.0, 2.0**32 - 1, 1.0)
