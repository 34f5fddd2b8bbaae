"""What the robot knows of its arm: measurements, external torques, frames and its load."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Final

import mujoco
import numpy as np

from ...assets import STEP_SIZE
from ...assets.checks import (
    Measure,
    arm_measures,
    hand_velocity_measure,
    refusals,
    touch_measures,
)
from ...assets.fields import Buffer, Vector, Views
from ..gains import Gains
from ..touch import Touch
from .description import LIMITS, ROBOT, end_effector, rotation, transform
from .motions import Kinematics, elbow_of
from .wire import Message, columns, matrix

GRAVITY: Final = (0.0, 0.0, -9.81)  # [m/s^2] of the base


class Measured:
    """The arm's measurements of a tick, and what a program has said of end effector and load."""

    def __init__(self, inputs: Views) -> None:
        self.inputs, self.arm = inputs, Kinematics()
        self.q, self.fingers, self.dq = inputs.qpos[:7], inputs.qpos[7:], inputs.qvel
        self.bias = np.zeros(7)  # what carries arm and load [N.m]
        self.lower = self.upper = LIMITS.collision_torque, LIMITS.collision_force
        self._nominal = self._stiffness = np.eye(4)
        self._load, self._centre = (0.0, np.zeros(3), np.zeros(9)), np.zeros(3)
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
        x, y, _ = rotation(self.inputs.hand_xquat) @ self._centre  # from the hand, world axes
        jac, weight = self.inputs.jac, -GRAVITY[2] * self._load[0]
        return np.asarray(weight * (jac[2] + jac[3] * y - jac[4] * x))

    def errors(self) -> list[str]:
        """Return what the arm's limits, and the thresholds of collisions, refuse."""
        return refusals(self._measures())

    def _measures(self) -> Iterator[Measure]:
        x, touch = self.inputs, self._touch
        torque = x.actuator_force[None, :7]
        yield from arm_measures(self.q[None], self.dq[None], torque, LIMITS)
        external, force = touch.external_torque[None], touch.external_force[None]
        yield from touch_measures(external, force, *self.upper)
        twist, turned = x.jac @ self.dq, np.empty(3)
        lever = rotation(x.hand_xquat) @ self.arm.in_hand[:3, 3]
        mujoco.mju_cross(turned, twist[3:], lever)
        yield hand_velocity_measure((twist[:3] + turned)[None], LIMITS)

    def set_thresholds(self, *thresholds: Vector) -> None:
        """Change the lower and upper thresholds of torques (2, 7) and forces (2, 6).

        Those while accelerating come first of each; this robot knows those without alone.
        """
        self.lower, self.upper = zip(thresholds[1], thresholds[3], strict=True)

    def set_end_effector(self, in_nominal: Vector) -> None:
        """Change the end effector's pose in the nominal one, by columns (16,)."""
        self._nominal = matrix(in_nominal)
        self.arm.set_end_effector(self._nominal)

    def set_stiffness_frame(self, in_end_effector: Vector) -> None:
        """Change the pose, by columns (16,), of the frame about which forces are told."""
        self._stiffness = matrix(in_end_effector)

    def set_load(self, mass: float, centre: Vector, inertia: Vector) -> None:
        """Change the load: mass [kg], centre in the flange's frame (3,) [m], inertia (9,)."""
        self._load = mass, centre, inertia
        self._centre = (np.linalg.inv(end_effector().hand) @ np.append(centre, 1.0))[:3]

    def fill(self, state: Message) -> None:
        """Write what is measured into a state."""
        x = self.inputs
        pose = transform(rotation(x.hand_xquat), x.hand_xpos) @ self.arm.in_hand
        state["O_T_EE"] = columns(pose)
        state["q"] = state["theta"] = self.q
        state["dq"] = state["dtheta"] = self.dq
        torque = x.actuator_force[:7]
        state["tau_J"] = torque if torque.any() else self.bias  # at rest, before the first step
        state["elbow"] = elbow_of(self.q)
        self._fill_forces(state, pose @ self._stiffness)

    def fill_frames(self, state: Message) -> None:
        """Write what changes only by requests into a state."""
        tool = end_effector()
        state["F_T_NE"], state["NE_T_EE"] = columns(tool.tips), columns(self._nominal)
        state["F_T_EE"] = columns(tool.tips @ self._nominal)
        state["EE_T_K"], state["O_ddP_O"] = columns(self._stiffness), GRAVITY
        state["m_ee"], state["F_x_Cee"] = tool.mass, tool.centre
        state["I_ee"] = tool.inertia.reshape(-1)
        state["m_load"], state["F_x_Cload"], state["I_load"] = self._load

    def _fill_forces(self, state: Message, frame: Vector) -> None:
        """Write external forces about a frame, as the robot exerts them on what is around it."""
        torque, force = -self._touch.external_torque, -self._touch.external_force
        moment = np.empty(3)
        mujoco.mju_cross(moment, frame[:3, 3] - self.inputs.hand_xpos, force[:3])
        force[3:] -= moment
        state["tau_ext_hat_filtered"], state["O_F_ext_hat_K"] = torque, force
        state["K_F_ext_hat_K"] = (force.reshape(2, 3) @ frame[:3, :3]).reshape(-1)
        for kind, most in (("contact", self.lower), ("collision", self.upper)):
            state[f"joint_{kind}"] = np.abs(torque) > most[0]
            state[f"cartesian_{kind}"] = np.abs(force) > most[1]
