"""Errors of the sensors between plant and controller; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

from ..assets.fields import bounded, switch
from ..assets.franka import DEFAULT_ROBOT, ROBOTS, Seven

_ZERO = (0.0,) * 7


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the readings; with all of them zero, readings equal the truth.

    `fmus/interface/sensors.toml` says what each of them is.
    """

    seed: float = bounded(0.0, "1", 0.0, 2.0**32 - 1, 1.0)
    joint_offset: Seven = bounded(_ZERO, "rad", -0.5, 0.5)
    joint_noise: Seven = bounded(_ZERO, "rad", 0.0, 0.1)
    joint_quantisation: Seven = bounded(_ZERO, "rad", 0.0, 0.1)
    velocity_noise: Seven = bounded(_ZERO, "rad/s", 0.0, 10.0)
    # Here in ticks; what describes it is about the FMU's parameter.
    delay: int = bounded(0, "s", 0.0, 0.1, 0.001)
    dropout: float = bounded(0.0, "1", 0.0, 1.0)
    hand_pose_source: str = switch("plant", ("plant", "model"))
    block_position_error: tuple[float, ...] = bounded((0.0, 0.0, 0.0), "m", -0.5, 0.5)
    block_yaw_error: float = bounded(0.0, "rad", -3.2, 3.2)
    robot: str = switch(DEFAULT_ROBOT, ROBOTS)
