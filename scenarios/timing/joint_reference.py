"""The joint reference that the controller computes for a trajectory, with an ideal arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...controller.controller import Controller
from ...controller.gains import Gains
from ...controller.model import load_arm
from ..scenario.trajectory import COMMANDS, Trajectory

Array = NDArray[np.float64]

OUT_OF_THE_WAY = 100.0  # times the robot's limits


@dataclass(frozen=True, eq=False)
class JointReference:
    """Joint reference for a trajectory, of an arm that follows it exactly."""

    time: Array  # (n,) [s]
    position: Array  # (n, 7) [rad]
    velocity: Array  # (n, 7) [rad/s]
    # Distance of hand and command (n,) [m], less the lag behind commands without velocity (linear
    # interpolation).
    miss: Array

    def derivatives(self) -> dict[str, Array]:
        """Return velocity, acceleration and jerk, each (n, 7), of the same instants."""
        acceleration = np.diff(self.velocity, axis=0, prepend=self.velocity[:1]) / STEP_SIZE
        jerk = np.diff(acceleration, axis=0, prepend=acceleration[:1]) / STEP_SIZE
        return {"velocity": self.velocity, "acceleration": acceleration, "jerk": jerk}


class _IdealArm:
    """An arm that follows its command exactly, with the controller's own kinematics."""

    def __init__(self) -> None:
        self._model = load_arm()
        self._data: Any = mujoco.MjData(self._model)
        self._hand = self._model.body("hand").id
        self._jac = np.zeros((6, self._model.nv))

    def measure(self, controller: Controller, q: Array) -> None:
        """Set the controller's measured inputs for joint positions (7,) [rad]."""
        model, data, inputs = self._model, self._data, controller.inputs
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, self._jac[:3], self._jac[3:], self._hand)
        inputs["hand_xpos"], inputs["hand_xquat"] = data.xpos[self._hand], data.xquat[self._hand]
        inputs["jac"], inputs["qpos"] = self._jac[:, :7], q


def _without_limits(gains: Gains) -> Gains:
    return replace(
        gains,
        limit_share=OUT_OF_THE_WAY,
        reference_lead=math.pi,
        linear_correction=OUT_OF_THE_WAY,
        angular_correction=OUT_OF_THE_WAY,
        linear_braking=OUT_OF_THE_WAY,
        angular_braking=OUT_OF_THE_WAY,
    )


def joint_reference(
    trajectory: Trajectory, times: Array, gains: Gains, *, limited: bool = False
) -> JointReference:
    """Compute the joint reference of commands at instants (n,), one a tick, starting at `home`.

    Unless `limited`, it is without the controller's limits, and shows what the commands ask for.
    """
    used = gains if limited else _without_limits(gains)
    controller, arm = Controller(used, STEP_SIZE), _IdealArm()
    q = np.array(HOME_Q)
    position, velocity = np.empty((2, len(times), 7))
    miss = np.empty(len(times))
    commands = trajectory.sample(times)
    for tick, command in enumerate(commands):
        controller.input_values[: len(COMMANDS)] = command
        arm.measure(controller, q)
        controller.update()
        position[tick], velocity[tick] = q, controller.outputs["qvel_ref"]
        miss[tick] = np.linalg.norm(command[:3] - controller.inputs["hand_xpos"])
        q = controller.outputs["qpos_ref"] + STEP_SIZE * velocity[tick]
    untold = np.diff(commands[:, :3], axis=0) / STEP_SIZE - commands[:-1, 7:10]
    lag = np.linalg.norm(untold, axis=1).max(initial=0.0) / max(gains.ik_gain, 1e-9)
    return JointReference(times, position, velocity, np.maximum(miss - lag, 0.0))
