"""What the robot knows of its arm: measurements, external torques, frames and its load."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...assets import STEP_SIZE
from ...assets.checks import (
    Measure,
    arm_measures,
    hand_velocity_measure,
    refusals,
    touch_measures,
)
from ..gains import Gains
from ..model import FINGERTIPS, Vector
from ..signals import Buffer, Views
from ..touch import Touch
from .description import LIMITS, ROBOT, end_effector, rotation, transform
from .motions import Kinematics
from .torques import carrying
from .wire import columns

GRAVITY: tuple[float, ...] = (0.0, 0.0, -9.81)  # [m/s^2] of the base


class Measured:
    """The arm's measurements of a tick, and what a program has said of end effector and load."""

    def __init__(self, inputs: Views, arm: Kinematics) -> None:
        self.inputs, self.q, self.dq = inputs, inputs.qpos[:7], inputs.qvel
        self.bias = np.zeros(7)  # what carries arm and load [N.m]
        self.lower = self.upper = LIMITS.collision_torque, LIMITS.collision_force
        self._arm, self._nominal, self._stiffness = arm, np.eye(4), np.eye(4)
        self._load: tuple[float, Vector, Vector] = (0.0, np.zeros(3), np.zeros(9))
        self._touch = SimpleNamespace(
            external_torque=np.zeros(7), external_force=np.zeros(6), joint_contact=np.zeros(7)
        )
        seen = SimpleNamespace(qpos=self.q, qvel=self.dq, jac=inputs.jac, qfrc_bias=self.bias,
                               actuator_force=inputs.actuator_force)  # fmt: skip
        self._observer = Touch(seen, self._touch, Buffer(Touch.STATE).views, STEP_SIZE)
        self._observer.set_gains(Gains(robot=ROBOT, observer=True, impedance=True))

    def update(self) -> None:
        """Take the inputs of a tick."""
        self.bias[:] = self.inputs.qfrc_bias + self.carrying()
        self._observer.takes_over()

    def carrying(self) -> Vector:
        """Return the torques (7,) [N.m] that carry the load."""
        mass, centre, _ = self._load
        in_hand = np.linalg.inv(end_effector().hand) @ np.append(centre, 1.0)
        return carrying(self.inputs.jac, mass, rotation(self.inputs.hand_xquat) @ in_hand[:3])

    def errors(self) -> list[str]:
        """Return what the arm's limits, and the thresholds of collisions, refuse."""
        return refusals(self._measures())

    def _measures(self) -> Iterator[Measure]:
        x, touch = self.inputs, self._touch
        torque = x.actuator_force[None, :7]
        yield from arm_measures(self.q[None], self.dq[None], torque, LIMITS)
        external, force = touch.external_torque[None], touch.external_force[None]
        yield from touch_measures(external, force, *self.upper)
        lever = rotation(x.hand_xquat) @ self._arm.in_hand[:3, 3]
        yield hand_velocity_measure((x.jac @ self.dq)[None], lever[None], LIMITS)

    def set_end_effector(self, in_nominal: Vector) -> None:
        """Change the end effector's pose in the nominal one (4, 4)."""
        self._nominal = in_nominal
        self._arm.in_hand = transform(np.eye(3), FINGERTIPS) @ in_nominal

    def set_stiffness_frame(self, in_end_effector: Vector) -> None:
        """Change the pose (4, 4) of the frame about which forces are told."""
        self._stiffness = in_end_effector

    def set_load(self, mass: float, centre: Vector, inertia: Vector) -> None:
        """Change the load: mass [kg], centre in the flange's frame (3,) [m], inertia (9,)."""
        self._load = mass, centre, inertia

    def fill(self, state: Views) -> None:
        """Write all of it into a state."""
        x, tool = self.inputs, end_effector()
        pose = transform(rotation(x.hand_xquat), x.hand_xpos) @ self._arm.in_hand
        state.O_T_EE[:] = columns(pose)
        state.q[:] = state.theta[:] = self.q
        state.dq[:] = state.dtheta[:] = self.dq
        torque = x.actuator_force[:7]
        state.tau_J[:] = torque if torque.any() else self.bias  # at rest, before the first step
        state.elbow[:] = elbow_of(self.q)
        state.F_T_NE[:], state.NE_T_EE[:] = columns(tool.tips), columns(self._nominal)
        state.F_T_EE[:] = columns(tool.tips @ self._nominal)
        state.EE_T_K[:], state.O_ddP_O[:] = columns(self._stiffness), GRAVITY
        state.m_ee[...], state.F_x_Cee[:] = tool.mass, tool.centre
        state.I_ee[:] = tool.inertia.reshape(-1)
        state.m_load[...], state.F_x_Cload[:], state.I_load[:] = self._load
        self._fill_forces(state, pose @ self._stiffness)

    def _fill_forces(self, state: Views, frame: Vector) -> None:
        """Write external forces about a frame, as the robot exerts them on what is around it."""
        torque, force = -self._touch.external_torque, -self._touch.external_force
        force[3:] -= np.cross(frame[:3, 3] - self.inputs.hand_xpos, force[:3])
        turned = frame[:3, :3].T
        state.tau_ext_hat_filtered[:], state.O_F_ext_hat_K[:] = torque, force
        state.K_F_ext_hat_K[:] = np.concatenate((turned @ force[:3], turned @ force[3:]))
        values = (torque, force)
        for names, most in ((CONTACTS, self.lower), (COLLISIONS, self.upper)):
            for name, value, threshold in zip(names, values, most, strict=True):
                getattr(state, name)[:] = np.abs(value) > threshold


CONTACTS = ("joint_contact", "cartesian_contact")
COLLISIONS = ("joint_collision", "cartesian_collision")


def elbow_of(q: Vector) -> tuple[Any, float]:
    """Return angle [rad] and side of the elbow at joints (7,)."""
    return q[2], -1.0 if q[3] < 0.0 else 1.0
