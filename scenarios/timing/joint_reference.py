"""The joint reference that the controller computes for a trajectory, with an ideal arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...controller.controller import Controller
from ...controller.gains import Gains
from ...controller.model import ArmModel
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
    gains = replace(gains, reading_delay=0.0)  # readings are of their instant here
    controller = Controller(gains if limited else _without_limits(gains), STEP_SIZE)
    arm, inputs = ArmModel(), controller.inputs
    q, still = np.array(HOME_Q), np.zeros(7)
    position, velocity = np.empty((2, len(times), 7))
    miss = np.empty(len(times))
    commands = trajectory.sample(times)
    for tick, command in enumerate(commands):
        controller.input_values[: len(COMMANDS)] = command
        hand = arm.hand(q, still)
        inputs["hand_xpos"], inputs["hand_xquat"] = hand.position, hand.orientation
        inputs["jac"], inputs["qpos"] = hand.jacobian, q
        controller.update()
        position[tick], velocity[tick] = q, controller.outputs["qvel_ref"]
        miss[tick] = np.linalg.norm(command[:3] - inputs["hand_xpos"])
        q = controller.outputs["qpos_ref"] + STEP_SIZE * velocity[tick]
    untold = np.diff(commands[:, :3], axis=0) / STEP_SIZE - commands[:-1, 7:10]
    lag = np.linalg.norm(untold, axis=1).max(initial=0.0) / max(gains.ik_gain, 1e-9)
    return JointReference(times, position, velocity, np.maximum(miss - lag, 0.0))
