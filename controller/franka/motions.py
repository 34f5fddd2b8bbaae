"""Motions: what a program commands of the arm, tick by tick, and what the limits bound of it."""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType
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
from ..ik import damped_least_squares, null_space_part, pose_error
from ..linalg import damped_factor
from ..model import FINGERTIPS, ArmModel, HandState, Vector
from .description import LIMITS, ROBOT, rotation, transform
from .wire import Generator, Views, matrix

ELBOW: Final = 2  # the joint whose angle it is
ELBOW_AXIS: Final = np.eye(7)[ELBOW]
DAMPING: Final = 1e-3  # of the inverse kinematics
LEAST_ROOM: Final = 1e-3  # share of the elbow's motion that must be free in the null space
STARTS: Final = 4  # iterations that bring the joints to a first pose


class Kinematics:
    """Where the end effector is, by the robot's own model."""

    def __init__(self) -> None:
        self._arm = ArmModel(ROBOT)
        self.in_hand = transform(np.eye(3), FINGERTIPS)  # pose of the end effector

    def hand(self, q: Vector) -> HandState:
        """Return the hand at joints (7,), in views that the next call overwrites."""
        return self._arm.hand(q, np.zeros(7))

    def end_effector(self, hand: HandState) -> Vector:
        """Return the end effector's pose (4, 4), world frame."""
        pose: Vector = transform(rotation(hand.orientation), hand.position) @ self.in_hand
        return pose

    def towards(self, q: Vector, pose: Vector, elbow: float | None) -> Vector:
        """Return joints (7,), near others, that bring the end effector to a pose."""
        hand = self.hand(q)
        error = difference(pose @ np.linalg.inv(self.in_hand), hand.position, hand.orientation)
        factor = damped_factor(hand.jacobian, DAMPING)
        step = damped_least_squares(hand.jacobian, factor, error, np.zeros(7))
        if elbow is not None:
            free = null_space_part(hand.jacobian, DAMPING, ELBOW_AXIS)
            if free[ELBOW] > LEAST_ROOM:
                step += (elbow - q[ELBOW] - step[ELBOW]) / free[ELBOW] * free
        there: Vector = q + step
        return there


def difference(pose: Vector, position: Vector, orientation: Vector) -> Vector:
    """Return displacement and rotation vector (6,) from a place to a pose (4, 4), world axes."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].reshape(-1))
    return pose_error(pose[:3, 3], quat, position, orientation)


def moved(pose: Vector, displacement: Vector) -> Vector:
    """Return a pose (4, 4) after a displacement and a rotation vector (6,), world axes."""
    quat, angle = np.empty(4), float(np.linalg.norm(displacement[3:]))
    axis = displacement[3:] / angle if angle > 0.0 else ELBOW_AXIS[:3]
    mujoco.mju_axisAngle2Quat(quat, axis, angle)
    return transform(rotation(quat) @ pose[:3, :3], pose[:3, 3] + displacement[:3])


class Motion:
    """The reference that the arm follows, from rest. This one is of torques: it has none."""

    generator = Generator.NONE

    def __init__(self, arm: Kinematics, q: Vector, measured: Vector) -> None:
        self._arm, self._is_first = arm, True
        self._measured = measured  # joints, in the memory of the inputs
        self.q, self.dq, self.ddq = q.copy(), np.zeros(7), np.zeros(7)
        self.twist, self.turn = np.zeros((2, 6))  # of the end effector, and its derivative
        self.elbow = np.array([q[ELBOW], 0.0, 0.0])  # angle, and two derivatives

    def errors(self, command: Views | None) -> list[str]:
        """Follow a command, and return what is refused of it.

        None: it is lost, and the acceleration stays.
        """
        found = refusals(self._follow(command))
        self._is_first = False
        return found

    def _follow(self, command: Views | None) -> Iterator[Measure]:
        """Change the reference, and yield what limits bound."""
        self.q = self._measured.copy()
        yield from ()

    @property
    def pose(self) -> Vector:
        """The end effector's pose (4, 4), world frame."""
        return self._arm.end_effector(self._arm.hand(self.q))

    def end_errors(self) -> list[str]:
        """Return what is refused if the last command was the end."""
        return refusals(end_measures([self.q[None], self.dq[None], self.ddq[None]], LIMITS))

    def _go(self, q: Vector, dq: Vector) -> Iterator[Measure]:
        """Go to joints at a velocity."""
        ddq = (dq - self.dq) / STEP_SIZE
        rates = (q, dq, ddq, (ddq - self.ddq) / STEP_SIZE)
        self.q, self.dq, self.ddq = q, dq, ddq
        return joint_measures([rate[None] for rate in rates], LIMITS)

    def _kept(self) -> Vector:
        """Velocities (7,) of the next tick with the last acceleration."""
        kept: Vector = self.dq + STEP_SIZE * self.ddq
        return kept


class JointPositions(Motion):
    """Follows positions of the joints, of which the first is the start."""

    generator = Generator.JOINT_POSITION

    def _follow(self, command: Views | None) -> Iterator[Measure]:
        if command is None:
            kept = self._kept()
            yield from self._go(self.q + STEP_SIZE * kept, kept)
            return
        q = command.q_c.copy()
        if self._is_first:
            yield start_measure((q - self._measured)[None], LIMITS)
            self.q = q
        yield from self._go(q, (q - self.q) / STEP_SIZE)


class JointVelocities(Motion):
    """Follows velocities of the joints."""

    generator = Generator.JOINT_VELOCITY

    def _follow(self, command: Views | None) -> Iterator[Measure]:
        dq = self._kept() if command is None else command.dq_c.copy()
        return self._go(self.q + STEP_SIZE * dq, dq)


class CartesianMotion(Motion):
    """What motions of the end effector have in common."""

    def __init__(self, arm: Kinematics, q: Vector, measured: Vector) -> None:
        super().__init__(arm, q, measured)
        self._pose = super().pose

    @property
    def pose(self) -> Vector:
        """The pose (4, 4) that is commanded."""
        return self._pose

    def errors(self, command: Views | None) -> list[str]:
        """Follow a command; those of the joints have other names here."""
        prefixes = "joint_motion_generator_", "cartesian_motion_generator_joint_"
        return [name.replace(*prefixes, 1) if name.startswith(prefixes[0]) else name
                for name in super().errors(command)]  # fmt: skip

    def _reach(self, pose: Vector, twist: Vector, command: Views | None) -> Iterator[Measure]:
        """Bring the end effector to a pose, with a twist."""
        turn = (twist - self.twist) / STEP_SIZE
        rates = [rate[None] for rate in (twist, turn, (turn - self.turn) / STEP_SIZE)]
        self._pose, self.twist, self.turn = pose, twist, turn
        yield from hand_measures([r[:, :3] for r in rates], [r[:, 3:] for r in rates], LIMITS)
        elbow = None
        if command is not None and command.has_elbow:
            elbow = float(command.elbow_c[0])
            yield from self._bend(elbow)
        q = self._arm.towards(self.q, pose, elbow)
        yield from self._go(q, (q - self.q) / STEP_SIZE)

    def _bend(self, angle: float) -> Iterator[Measure]:
        """Take over the elbow's angle."""
        before = np.array([angle, 0.0, 0.0]) if self._is_first else self.elbow
        rates = [angle]
        for last in before:
            rates.append((rates[-1] - last) / STEP_SIZE)
        self.elbow = np.array(rates[:3])
        return elbow_measures([np.array([[rate]]) for rate in rates], LIMITS)

    def _kept_twist(self) -> Vector:
        kept: Vector = self.twist + STEP_SIZE * self.turn
        return kept


class CartesianPoses(CartesianMotion):
    """Follows poses of the end effector, of which the first is the start."""

    generator = Generator.CARTESIAN_POSE

    def _follow(self, command: Views | None) -> Iterator[Measure]:
        if command is None:
            kept = self._kept_twist()
            yield from self._reach(moved(self._pose, STEP_SIZE * kept), kept, None)
            return
        pose = matrix(command.O_T_EE_c)
        if self._is_first:
            there = self._arm.end_effector(self._arm.hand(self._measured))
            yield start_place_measure((pose - there)[None, :3, 3], LIMITS)
            self._start(pose)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, self._pose[:3, :3].reshape(-1))
        twist = difference(pose, self._pose[:3, 3], quat) / STEP_SIZE
        yield from self._reach(pose, twist, command)

    def _start(self, pose: Vector) -> None:
        self._pose = pose
        for _ in range(STARTS):
            self.q = self._arm.towards(self.q, pose, None)


class CartesianVelocities(CartesianMotion):
    """Follows twists of the end effector."""

    generator = Generator.CARTESIAN_VELOCITY

    def _follow(self, command: Views | None) -> Iterator[Measure]:
        twist = self._kept_twist() if command is None else command.O_dP_EE_c.copy()
        return self._reach(moved(self._pose, STEP_SIZE * twist), twist, command)


MOTIONS: Final = MappingProxyType({
    each.generator: each
    for each in (Motion, JointPositions, JointVelocities, CartesianPoses, CartesianVelocities)
})  # fmt: skip
