"""A program on pylibfranka that counts: python .ci/studies/wire.py ADDRESS RESULT.json.

It moves in each way, and writes how many commands a second of wall time have been answered.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pylibfranka import (
    CartesianPose,
    ControllerMode,
    JointPositions,
    RealtimeConfig,
    Robot,
    Torques,
)

TICKS = 4000
WAVE = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.arange(TICKS) / (TICKS - 1)))  # at rest at both ends


def rate(control: Any, command: Callable[[Any, float], Any]) -> float:
    """Commands per second of a motion."""
    first, _ = control.readOnce()
    begin = time.perf_counter()
    for tick in range(TICKS):
        sent = command(first, WAVE[tick])
        sent.motion_finished = tick == TICKS - 1
        control.writeOnce(sent)
        if tick < TICKS - 1:
            control.readOnce()
    return TICKS / (time.perf_counter() - begin)


def joints(first: Any, wave: float) -> JointPositions:
    """Turn joint 1."""
    return JointPositions([first.q_d[0] + 0.3 * wave, *first.q_d[1:]])


def pose(first: Any, wave: float) -> CartesianPose:
    """Lift the end effector."""
    columns = list(first.O_T_EE_c)
    columns[14] += 0.1 * wave
    return CartesianPose(columns)


def main(address: str, result: str) -> None:
    """Move in each way."""
    robot, own = Robot(address, RealtimeConfig.kIgnore), ControllerMode.JointImpedance
    springs = ControllerMode.CartesianImpedance
    robot.set_collision_behavior([100.0] * 7, [100.0] * 7, [100.0] * 6, [100.0] * 6)
    rates = {
        "joint positions": rate(robot.start_joint_position_control(own), joints),
        "poses": rate(robot.start_cartesian_pose_control(own), pose),
        "poses, Cartesian impedance": rate(robot.start_cartesian_pose_control(springs), pose),
        "torques": rate(robot.start_torque_control(), lambda *_: Torques([0.0] * 7)),
    }
    Path(result).write_text(json.dumps(rates))


main(*sys.argv[1:])
