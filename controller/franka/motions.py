"""Motions: what a program commands of the arm, tick by tick, and what the limits bound of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import mujoco
import numpy as np

from ...assets import STEP_SIZE
from ...assets.checks import (
    Measure,
    elbow_measures,
    end_measures,
    hand_measures,
    joint_measures,
    refusals,
    start_measure,
    start_place_measure,
)
from ...assets.fields import Vector
from ..ik import damped_least_squares, null_space_part, pose_error
from ..linalg import damped_factor
from ..model import FINGERTIPS, ArmModel, HandState
from .description import LIMITS, ROBOT, rotation, transform
from .wire import Generator, Message, columns, matrix

ELBOW: Final = 2  # the joint whose angle it is
DAMPING: Final = 1e-3  # of the inverse kinematics
LEAST_ROOM: Final = 1e-3  # share of the elbow's motion that is taken to be free in the null space


class Kinematics:
    """Where the end effector is, by the robot's own model."""

    def __init__(self) -> None:
        self._arm = ArmModel(ROBOT)
        self.set_end_effector(np.eye(4))

    def set_end_effector(self, in_nominal: Vector) -> None:
        """Change the end effector's pose (4, 4) in the nominal one, at the fingertips."""
        self.in_hand = transform(np.eye(3), FINGERTIPS) @ in_nominal
        self._hand_in_it = np.linalg.inv(self.in_hand)

    def hand(self, q: Vector) -> HandState:
        """Return the hand at joints (7,), in views that the next call overwrites."""
        return self._arm.hand(q, np.zeros(7))

    def end_effector(self, q: Vector) -> Vector:
        """Return the end effector's pose (4, 4), world frame."""
        hand = self.hand(q)
        return transform(rotation(hand.orientation), hand.position) @ self.in_hand

    def towards(self, q: Vector, pose: Vector, elbow: float | None) -> Vector:
        """Return joints (7,), near others, that bring the end effector to a pose (4, 4)."""
        hand, there = self.hand(q), pose @ self._hand_in_it
        error = pose_error(there[:3, 3], quaternion(there), hand.position, hand.orientation)
        factor = damped_factor(hand.jacobian, DAMPING)
        step = damped_least_squares(hand.jacobian, factor, error, np.zeros(7))
        if elbow is not None:
            free = null_space_part(hand.jacobian, DAMPING, np.eye(7)[ELBOW])
            step += (elbow - q[ELBOW] - step[ELBOW]) / max(free[ELBOW], LEAST_ROOM) * free
        return step + q


def quaternion(pose: Vector) -> Vector:
    """Return the orientation (w, x, y, z) of a pose (4, 4)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].reshape(-1))
    return quat


def moved(pose: Vector, displacement: Vector) -> Vector:
    """Return a pose (4, 4) after a displacement and a rotation vector (6,), world axes."""
    turn, quat = displacement[3:], np.empty(4)
    angle = mujoco.mju_norm3(turn)
    mujoco.mju_axisAngle2Quat(quat, turn / angle if angle else turn, angle)
    return transform(rotation(quat) @ pose[:3, :3], pose[:3, 3] + displacement[:3])


def elbow_of(q: Vector) -> tuple[float, float]:
    """Return angle [rad] and side of the elbow at joints (7,)."""
    return q[ELBOW], -1.0 if q[ELBOW + 1] < 0.0 else 1.0


class Motion:
    """The reference that the arm follows, from rest. This one is of torques: it has none."""

    def __init__(
        self, arm: Kinematics, q: Vector, measured: Vector, generator: Generator = Generator.NONE
    ) -> None:
        self.generator, self._arm, self._is_first = generator, arm, True
        self._measured = measured  # joints, in the memory of the inputs
        self.q, self.dq, self.ddq = q.copy(), np.zeros(7), np.zeros(7)
        self._pose: Vector | None = None  # of the end effector, if that is commanded
        self._twist, self._turn = np.zeros((2, 6))  # of the end effector, and its derivative
        self._elbow = np.array([q[ELBOW], 0.0, 0.0])  # angle, and two derivatives

    def errors(self, command: Message | None) -> list[str]:
        """Follow a command, and return what is refused of it.

        None: it is lost, and the acceleration stays.
        """
        found = refusals(self._follow(command))
        self._is_first = False
        return found

    def _follow(self, command: Message | None) -> Iterator[Measure]:
        """Change the reference, and yield what limits bound."""
        self.q = self._measured.copy()
        yield from ()

    def end_errors(self) -> list[str]:
        """Return what is refused if the last command was the end."""
        return refusals(end_measures([self.q[None], self.dq[None], self.ddq[None]], LIMITS))

    def _go(self, dq: Vector) -> Iterator[Measure]:
        """Go on at velocities of the joints (7,) [rad/s]."""
        ddq = (dq - self.dq) / STEP_SIZE
        rates = (self.q + STEP_SIZE * dq, dq, ddq, (ddq - self.ddq) / STEP_SIZE)
        self.q, self.dq, self.ddq = rates[:3]
        return joint_measures([rate[None] for rate in rates], LIMITS)

    def fill(self, state: Message) -> None:
        """Write the reference into a state."""
        pose = self._arm.end_effector(self.q) if self._pose is None else self._pose
        state["q_d"], state["dq_d"], state["ddq_d"] = self.q, self.dq, self.ddq
        state["O_T_EE_d"] = state["O_T_EE_c"] = columns(pose)
        state["O_dP_EE_d"] = state["O_dP_EE_c"] = self._twist
        state["O_ddP_EE_c"] = self._turn
        state["elbow_d"] = state["elbow_c"] = elbow_of(self.q)
        state["elbow_c"][0], state["delbow_c"][0], state["ddelbow_c"][0] = self._elbow


class JointMotion(Motion):
    """Follows positions of the joints, of which the first is the start, or velocities."""

    def _follow(self, command: Message | None) -> Iterator[Measure]:
        dq = self.dq + STEP_SIZE * self.ddq
        if command is not None and self.generator == Generator.JOINT_POSITION:
            if self._is_first:
                yield start_measure((command["q_c"] - self._measured)[None], LIMITS)
                self.q = command["q_c"]
            dq = (command["q_c"] - self.q) / STEP_SIZE
        elif command is not None:
            dq = command["dq_c"]
        yield from self._go(dq)


class CartesianMotion(Motion):
    """Follows poses of the end effector, of which the first is the start, or twists."""

    def _follow(self, command: Message | None) -> Iterator[Measure]:
        twist, elbow = self._twist + STEP_SIZE * self._turn, None
        if self._pose is None:
            self._pose = self._arm.end_effector(self.q)
        if command is not None and self.generator == Generator.CARTESIAN_POSE:
            pose = matrix(command["O_T_EE_c"])
            if self._is_first:
                yield self._start(pose)
            here = self._pose[:3, 3], quaternion(self._pose)
            twist = pose_error(pose[:3, 3], quaternion(pose), *here) / STEP_SIZE
        elif command is not None:
            twist = command["O_dP_EE_c"]
        if command is not None and command["has_elbow"]:
            elbow = float(command["elbow_c"][0])
            yield from self._bend(elbow)
        turn = (twist - self._twist) / STEP_SIZE
        yield from _of_hand((twist, turn, (turn - self._turn) / STEP_SIZE))
        self._twist, self._turn = twist, turn
        self._pose = moved(self._pose, STEP_SIZE * twist)
        q = self._arm.towards(self.q, self._pose, elbow)
        self._go((q - self.q) / STEP_SIZE)  # as the robot's own inverse kinematics is not known

    def end_errors(self) -> list[str]:
        """Return what is refused if the last command was the end."""
        left = self._twist / STEP_SIZE, self._turn / STEP_SIZE  # to brake within a tick
        return refusals(_of_hand((np.zeros(6), *left)))

    def _start(self, pose: Vector) -> Measure:
        """Begin at a pose that is near."""
        away = pose - self._arm.end_effector(self._measured)
        self.q, self._pose = self._arm.towards(self.q, pose, None), pose
        return start_place_measure(away[None, :3, 3], LIMITS)

    def _bend(self, angle: float) -> Iterator[Measure]:
        """Take over the elbow's angle."""
        rates = [angle]
        for last in np.array([angle, 0.0, 0.0]) if self._is_first else self._elbow:
            rates.append((rates[-1] - last) / STEP_SIZE)
        self._elbow = np.array(rates[:3])
        return elbow_measures([np.array([[rate]]) for rate in rates], LIMITS)


def _of_hand(rates: Iterable[Vector]) -> Iterator[Measure]:
    """Yield what limits bound of three derivatives of the end effector's pose (6,)."""
    moving, turning = zip(*((rate[None, :3], rate[None, 3:]) for rate in rates), strict=True)
    return hand_measures(moving, turning, LIMITS)


MOTIONS: Final = {  # by what the program commands
    Generator.JOINT_POSITION: JointMotion,
    Generator.JOINT_VELOCITY: JointMotion,
    Generator.CARTESIAN_POSE: CartesianMotion,
    Generator.CARTESIAN_VELOCITY: CartesianMotion,
    Generator.NONE: Motion,
}
