"""Errors of the sensors between plant and controller; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..assets.franka import DEFAULT_ROBOT, ROBOTS
from .gains import switch

_ZEROS = (0.0,) * 7


def _error(
    default: Any, unit: str, bounds: tuple[float, float], text: str, part: Any = None
) -> Any:
    """Return the field of an error between two values; `part`: it is a multiple of that."""
    about = {"unit": unit, "range": bounds, "text": text, "multiple_of": part}
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the readings; with all of them zero, readings equal the truth."""

    # fmt: off
    seed: float = _error(0.0, "1", (0.0, 2.0**32 - 1), "Seed of the random numbers, a whole number",
                         1.0)
    joint_offset: tuple[float, ...] = _error(_ZEROS, "rad", (-0.5, 0.5), "Offset of each encoder")
    joint_noise: tuple[float, ...] = _error(_ZEROS, "rad", (0.0, 0.1), "Noise of each encoder, "
                                            "root mean square")
    joint_quantisation: tuple[float, ...] = _error(_ZEROS, "rad", (0.0, 0.1), "Resolution of each "
                                                   "encoder; 0: exact")
    velocity_noise: tuple[float, ...] = _error(_ZEROS, "rad/s", (0.0, 10.0), "Noise of each joint "
                                               "velocity, root mean square")
    # Here in ticks; what describes it is about the FMU's parameter.
    delay: int = _error(0, "s", (0.0, 0.1), "Delay of the measurements", 0.001)
    dropout: float = _error(0.0, "1", (0.0, 1.0), "Share of ticks whose measurement is lost; the "
                            "last one is held")
    hand_pose_source: str = switch("plant", "Where the hand's pose, its Jacobian and the bias "
                                   "force come from: the plant, or the robot's own model at the "
                                   "measured joints", ("plant", "model"))
    block_position_error: tuple[float, ...] = _error((0.0, 0.0, 0.0), "m", (-0.5, 0.5), "Error of "
                                                     "the block's measured position, world frame")
    block_yaw_error: float = _error(0.0, "rad", (-3.2, 3.2), "Error of the block's measured yaw "
                                    "about the world's z axis")
    robot: str = switch(DEFAULT_ROBOT, "Arm whose model gives the hand's pose: panda (Franka "
                        "Emika Panda) or fr3 (Franka Research 3)", tuple(ROBOTS))
    # fmt: on
