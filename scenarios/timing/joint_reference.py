"""The joint reference that the controller computes for a trajectory, with an ideal arm."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...controller.gains import RANGES, Gains
from ...controller.model import ArmModel
from ...fmus.interface.controller import COMMANDS, CONTROLLER, MOST, POSTURE_COMMANDS
from ...fmus.interface.parameters import expand
from ...fmus.interface.variables import Interface
from ...fmus.master.system import System, open_system
from ...fmus.sources.targets import build_fmu, own_fmu
from ..scenario.trajectory import Trajectory

Array = NDArray[np.float64]

LAW = "controller"
MEASURED = ("hand_xpos", "hand_xquat", "jac", "qpos")
REFERENCE = ("qpos_ref", "qvel_ref")
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
    robot: str

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


@cache
def _law() -> tuple[Path, Interface]:
    """Build the controller's FMU, but with limits that can be put out of the way."""
    free = tuple(
        replace(variable, maximum=RANGES[variable.name][1]) if variable.name in MOST else variable
        for variable in CONTROLLER.variables
    )
    interface = replace(CONTROLLER, variables=free)
    return build_fmu(replace(own_fmu(LAW, in_python=False), interface=interface)), interface


def joint_reference(
    trajectory: Trajectory, times: Array, gains: Gains, *, limited: bool = False
) -> JointReference:
    """Compute the joint reference of commands at instants (n,), one a tick, starting at `home`.

    Unless `limited`, it is without the controller's limits, and shows what the commands ask for.
    """
    gains = replace(gains, reading_delay=0.0)  # readings are of their instant here
    values = asdict(gains if limited else _without_limits(gains))
    path, interface = _law()
    commanded = COMMANDS if trajectory.postures is None else (*COMMANDS, *POSTURE_COMMANDS)
    signals = (*commanded, *MEASURED)
    inputs = [name for each in signals for name in interface.variable(each).names()]
    system = System({LAW: path}, (), [(LAW, name) for name in inputs])
    start = {LAW: expand(LAW, interface, values)}
    arm, still, q = ArmModel(gains.robot), np.zeros(7), np.array(HOME_Q)
    commands = trajectory.sample(times)
    position, velocity = np.empty((2, len(times), 7))
    miss, given, answer = np.empty(len(times)), np.empty((1, len(inputs))), np.empty((1, 14))
    with open_system(system, start, stop=len(times) * STEP_SIZE) as session:
        law = session.slaves[LAW]
        put = law.bind_set(inputs, given)
        get = law.bind_get([f"{n}[{i}]" for n in REFERENCE for i in range(1, 8)], answer)
        for tick, command in enumerate(commands):
            hand = arm.hand(q, still)
            measured = (command, hand.position, hand.orientation, hand.jacobian.ravel(), q)
            np.concatenate(measured, out=given[0])
            put(0)
            law.step(tick * STEP_SIZE, STEP_SIZE)
            get(0)
            position[tick], velocity[tick] = q, answer[0, 7:]
            miss[tick] = np.linalg.norm(command[:3] - hand.position)
            q = answer[0, :7] + STEP_SIZE * velocity[tick]
    untold = np.diff(commands[:, :3], axis=0) / STEP_SIZE - commands[:-1, 7:10]
    lag = np.linalg.norm(untold, axis=1).max(initial=0.0) / max(gains.ik_gain, 1e-9)
    return JointReference(times, position, velocity, np.maximum(miss - lag, 0.0), gains.robot)
