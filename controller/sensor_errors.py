"""Errors of the sensors between plant and controller; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ..assets.franka import DEFAULT_ROBOT

HAND_POSE_SOURCES: Final = ("plant", "model")
_ZEROS = (0.0,) * 7


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the readings; with all of them zero, readings equal the truth."""

    seed: float = 0.0  # of all random numbers
    joint_offset: tuple[float, ...] = _ZEROS  # of each encoder [rad]
    joint_noise: tuple[float, ...] = _ZEROS  # of each encoder, root mean square [rad]
    joint_quantisation: tuple[float, ...] = _ZEROS  # of each encoder [rad]; 0: none
    velocity_noise: tuple[float, ...] = _ZEROS  # of each joint, root mean square [rad/s]
    delay: int = 0  # of the readings [ticks]
    dropout: float = 0.0  # share of ticks without a reading; the last one is repeated [1]
    # "plant": the true pose of the hand, its Jacobian and the bias force; "model": those of the
    # robot's own model at the measured joints.
    hand_pose_source: str = "plant"
    block_position_error: tuple[float, ...] = (0.0, 0.0, 0.0)  # of the camera, world frame [m]
    block_yaw_error: float = 0.0  # of the camera, about the world's z axis [rad]
    robot: str = DEFAULT_ROBOT  # whose model "model" is, one of `franka.ROBOTS`
