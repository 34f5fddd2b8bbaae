"""Errors of the sensors between plant and controller; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ..assets.franka import DEFAULT_ROBOT

HAND_POSE_SOURCES: Final = ("plant", "model")
_ZEROS = (0.0,) * 7


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the readings; with all of them zero, readings equal the truth.

    Attributes:
        seed: Seed of all random numbers.
        joint_offset: Offset of each encoder [rad].
        joint_noise: Noise of each encoder, root mean square [rad].
        joint_quantisation: Resolution of each encoder [rad]; 0: unlimited.
        velocity_noise: Noise of each joint velocity, root mean square [rad/s].
        delay: Delay of the readings [ticks].
        dropout: Share of ticks without a reading, in which the last one is repeated [1].
        hand_pose_source: "plant": the true pose of the hand, its Jacobian and the bias force;
            "model": those of the robot's own model at the measured joints.
        block_position_error: Position error of the camera, world frame [m].
        block_yaw_error: Angular error of the camera about the world's z axis [rad].
        robot: Whose model "model" is, one of `franka.ROBOTS`.
    """

    seed: float = 0.0
    joint_offset: tuple[float, ...] = _ZEROS
    joint_noise: tuple[float, ...] = _ZEROS
    joint_quantisation: tuple[float, ...] = _ZEROS
    velocity_noise: tuple[float, ...] = _ZEROS
    delay: int = 0
    dropout: float = 0.0
    hand_pose_source: str = "plant"
    block_position_error: tuple[float, ...] = (0.0, 0.0, 0.0)
    block_yaw_error: float = 0.0
    robot: str = DEFAULT_ROBOT
