"""The joint reference that the controller computes for a trajectory, with an ideal arm."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...assets.franka import HOME_Q, ROBOTS
from ...controller.gains import RANGES, Gains
from ...controller.model import ArmModel
from ...fmus.interface.controller import COMMANDS, CONTROLLER, POSTURE_COMMANDS
from ...fmus.interface.parameters import expand
from ...fmus.interface.variables import Interface
from ...fmus.master.system import open_system
from ...fmus.master.wiring import System
from ...fmus.sources.targets import Target, build_fmu, own_fmu
from ..trajectory import Trajectory

LAW = "controller"
MEASURED = ("hand_xpos", "hand_xquat", "jac", "qpos")
REFERENCE = ("qpos_ref", "qvel_ref")
AT_END: Final = 0.002  # [rad] from a joint's end
WITHOUT_LIMITS = {  # gains far beyond what any command asks for
    "limit_share": 100.0, "reference_lead": math.pi, "linear_correction": 100.0,
    "angular_correction": 100.0, "linear_braking": 100.0, "angular_braking": 100.0,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class JointReference:
    """Joint reference for a trajectory, of an arm that follows it exactly.

    `joint_reference` computes it with the controller's own FMU; a planned route, which has joint
    positions, makes it of these. It is for limits and reach before a run. What a run commanded is
    in its recording.
    """

    time: Array  # (n,) [s]
    position: Array  # (n, 7) [rad]
    velocity: Array  # (n, 7) [rad/s]
    # Distance of hand and command (n,) [m], less the lag behind commands without velocity (linear
    # interpolation).
    miss: Array
    robot: str

    @property
    def room(self) -> Array:
        """Distance of the joints from the ends of their ranges (n, 7) [rad]."""
        robot = ROBOTS[self.robot]
        return np.minimum(self.position - robot.q_min, robot.q_max - self.position)

    def end_reached(self, tick: int) -> str:
        """Return which joint is at its end and what helps, or nothing."""
        room = self.room[tick]
        if room.min() >= AT_END:
            return ""
        return (
            f"joint {room.argmin() + 1} reaches the end of its range, however slowly it moves; "
            "turn the hand or choose another path, as `panda-cosim route` does"
        )


def rates(values: Array) -> Array:
    """Rate of change of values (n, k) per second; 0 in the first row."""
    return np.diff(values, axis=0, prepend=values[:1]) / STEP_SIZE


@cache
def _law() -> tuple[Path, Interface]:
    """Build the controller's FMU, but with limits that can be put out of the way."""
    free = replace(CONTROLLER.variable("limit_share"), maximum=RANGES["limit_share"][1])
    variables = (free if each.name == free.name else each for each in CONTROLLER.variables)
    interface = replace(CONTROLLER, variables=tuple(variables))
    law = own_fmu(LAW, Target().kind_of(LAW))
    return build_fmu(replace(law, interface=interface)), interface


def joint_reference(
    trajectory: Trajectory, times: Array, gains: Gains, *, limited: bool = False
) -> JointReference:
    """Compute the joint reference of commands at instants (n,), one a tick, starting at `home`.

    Unless `limited`, it is without the controller's limits, and shows what the commands ask for.
    """
    # Readings are of their instant here.
    values = asdict(gains) | {"reading_delay": 0.0} | ({} if limited else WITHOUT_LIMITS)
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
