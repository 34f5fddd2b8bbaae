"""Demands of a trajectory on the robot, as shares of its limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import BLOCK_WIDTH, ROBOTS, SERVO_DAMPING
from ...controller.model import load_arm
from ..scenario.limits import shares
from ..scenario.table import TrajectoryTable
from ..scenario.trajectory import Trajectory
from .joint_reference import JointReference

Array = NDArray[np.float64]
Shares = dict[str, float]

HALF_OPEN: Final = 0.02  # [m] finger position, away from the ends of the range
_STEP_DAMPING: Final = STEP_SIZE * np.array(SERVO_DAMPING)  # [kg.m^2]


@dataclass(frozen=True)
class Timing:
    """A trajectory with new times, and the shares of the limits that it uses."""

    trajectory: Trajectory  # commands at those times
    shares: Shares  # the largest of each limit [1]
    # New rows, in the world, to be interpolated by `spline`; None: the old ones, at the
    # trajectory's times.
    table: TrajectoryTable | None = None

    @property
    def cycle(self) -> float:
        """Time of the last row [s]."""
        return float(self.trajectory.times[-1])


class ArmDynamics:
    """Torques of a robot's arm, with a point mass `load` [kg] between the fingertips."""

    def __init__(self, load: float, robot: str) -> None:
        self.robot = ROBOTS[robot]
        self._model: Any = load_arm(load, robot)
        self._data: Any = mujoco.MjData(self._model)
        self._data.qpos[7:] = HALF_OPEN

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the torques (7,) [N.m] that the servos show, the joints' damping included.

        A servo's torque is measured with the velocity at the beginning of a step, but acts with
        the one at its end: what is measured has damping times the change between them on top.
        Dry friction is left out: its sign would change at once here, however slow the joint is.
        """
        data = self._data
        data.qpos[:7], data.qvel[:7], data.qacc[:7] = q, qd, qdd
        mujoco.mj_inverse(self._model, data)
        torque: Array = data.qfrc_inverse[:7] + data.qfrc_constraint[:7] + _STEP_DAMPING * qdd
        return torque


def joint_demands(
    trajectory: Trajectory, reference: JointReference, load: float
) -> dict[str, Array]:
    """Return the share of each limit of the joints at each tick (n, 7).

    `load` is the mass of what the closed fingers carry [kg].
    """
    rates = reference.derivatives()
    closed = trajectory.sample(reference.time)[:, 13] < BLOCK_WIDTH
    # The block's weight is taken up gradually, so the switch of loads is not a torque rate.
    empty = _torques(reference, rates["acceleration"], 0.0, ~closed)
    full = _torques(reference, rates["acceleration"], load, closed)
    torque = np.where(closed[:, None], full, empty)
    torque_rate = np.where(closed[:, None], _rates(full), _rates(empty))
    used = {**rates, "torque": torque, "torque rate": torque_rate}
    robot = reference.robot
    demanded = {quantity: shares(quantity, values, robot) for quantity, values in used.items()}
    velocity = reference.velocity / ROBOTS[robot].speed(reference.position, reference.velocity)
    return demanded | {"velocity": velocity}


def demands(trajectory: Trajectory, reference: JointReference, load: float) -> dict[str, Array]:
    """Return the share of each limit at each tick (n, 7), or (n, 1) for the hand's."""
    commands = trajectory.sample(reference.time)
    velocity = commands[:, 7:10]
    acceleration = np.diff(velocity, axis=0, prepend=velocity[:1]) / STEP_SIZE
    return {
        **joint_demands(trajectory, reference, load),
        "hand speed": shares("hand speed", _lengths(velocity), reference.robot),
        "hand acceleration": shares("hand acceleration", _lengths(acceleration), reference.robot),
        "hand turn": shares("hand turn", _lengths(commands[:, 10:13]), reference.robot),
    }


def _lengths(vectors: Array) -> Array:
    lengths: Array = np.linalg.norm(vectors, axis=1, keepdims=True)
    return lengths


def _rates(values: Array) -> Array:
    """Rate of change of values (n, 7) per second; 0 in the first row."""
    return np.diff(values, axis=0, prepend=values[:1]) / STEP_SIZE


def _torques(
    reference: JointReference, acceleration: Array, load: float, asked: NDArray[np.bool_]
) -> Array:
    """Return the torques (n, 7) [N.m] that a joint reference needs, at accelerations (n, 7).

    They are computed for the instants (n,) that are asked for and those before them.
    """
    arm, torques = ArmDynamics(load, reference.robot), np.zeros_like(acceleration)
    for i in np.flatnonzero(asked | np.append(asked[1:], False)):
        torques[i] = arm.torque(reference.position[i], reference.velocity[i], acceleration[i])
    return torques


def largest(demanded: dict[str, Array]) -> Shares:
    """Return the largest share of each limit over all ticks [1]."""
    return {name: float(np.abs(share).max()) for name, share in demanded.items()}
