"""Touch: external torques on the arm, thresholds on them, and the reaction."""

from __future__ import annotations

from typing import ClassVar, Final

import numpy as np

from ..assets import STEP_SIZE
from ..assets.fields import Layout, Views, as_arrays
from ..assets.franka import JOINT_DAMPING, ROBOTS, SERVO_DAMPING
from .gains import Gains
from .limits import clamp
from .linalg import cholesky_solve, damped_factor, mat_vec
from .model import ArmModel

FREE, CONTACT, COLLISION = 0.0, 1.0, 2.0  # states of a joint
# The plant's servos damp implicitly: by the joint's velocity at the end of a step of the physics,
# while `actuator_force` is that at its beginning. So each acts as if its rotor had this much more
# inertia.
ROTOR: Final = np.array(SERVO_DAMPING) * STEP_SIZE  # [kg.m^2]


class Touch:
    """A momentum observer of the external torques, and what follows from them.

    With r the external torques, M the mass matrix, tau the torques of the servos less the joints'
    damping, T the period and K the gain `observer_gain`:

        r <- r + a (M qdd + bias - tau - r),  a = K T / (1 + K T),  qdd = (qd - qd_before) / T
        F  = argmin |J^T F - r|^2

    r follows the external torques with the time constant 1 / K. F is the force and torque that
    would exert them at the hand. Source: A. De Luca, R. Mattone, "Actuator Failure Detection and
    Isolation Using Generalized Momenta", ICRA 2003.

    A joint is in contact while |r| is above its lower threshold. Above the upper one it has
    collided, and counts as such from then on: the reaction `stop` holds the joints where they are,
    and `yield` lets them give way, held up against gravity alone, until the reaction is `none`.
    """

    STATE: ClassVar[Layout] = np.dtype(
        [
            ("observes", float),  # 1: it has begun
            ("reacts", float),  # 1: the arm is no longer moved by its law
            ("qd_before", float, 7),  # [rad/s]
            ("q_stop", float, 7),  # [rad] where the arm is held
        ]
    )

    def __init__(self, inputs: Views, outputs: Views, state: Views, period: float) -> None:
        self._inputs, self._outputs, self._state = inputs, outputs, state
        self._period = np.array(period)

    def set_gains(self, gains: Gains) -> None:
        """Change the gains; allowed between any two updates."""
        self._gains = as_arrays(gains)
        self._arm, self._robot = ArmModel(gains.robot), ROBOTS[gains.robot]
        gain = gains.observer_gain * float(self._period)
        self._share = gain / (1.0 + gain)

    def takes_over(self) -> bool:
        """Observe and react; whether the arm is moved from here instead of by its law."""
        state, reaction = self._state, self._gains.reaction
        if self._gains.impedance:  # reactions move servos
            reaction = "none"
        if reaction == "none" and not self._gains.observer:
            state.observes[...] = 0.0
            return False
        self._observe()
        if reaction == "none" or not (self._outputs.joint_contact == COLLISION).any():
            return False
        if not state.reacts:
            state.reacts[...], state.q_stop[:] = 1.0, self._inputs.qpos
        self._react()
        return True

    def _observe(self) -> None:
        x, y, state, gains = self._inputs, self._outputs, self._state, self._gains
        if not state.observes:
            state.observes[...], state.qd_before[:] = 1.0, x.qvel
            y.external_torque[:], y.external_force[:], y.joint_contact[:] = 0.0, 0.0, FREE
            return
        qdd = (x.qvel - state.qd_before) / self._period
        state.qd_before[:] = x.qvel
        rotor = 0.0 if gains.impedance else ROTOR
        torque = x.actuator_force[:7] - rotor * qdd - JOINT_DAMPING[gains.robot] * x.qvel
        needed = self._arm.inertia_force(x.qpos, qdd) + x.qfrc_bias
        external = y.external_torque
        external += self._share * (needed - torque - external)
        y.external_force[:] = cholesky_solve(damped_factor(x.jac, 0.0), mat_vec(x.jac, external))
        size = np.abs(external)
        now = np.where(size > gains.lower_torque_threshold, CONTACT, FREE)
        now = np.where(size > gains.upper_torque_threshold, COLLISION, now)
        y.joint_contact[:] = np.where(y.joint_contact == COLLISION, COLLISION, now)

    def _react(self) -> None:
        """Hold the joints, or let them give way; the servos' damping brakes them."""
        x, y = self._inputs, self._outputs
        if self._gains.reaction == "yield":
            self._state.q_stop[:] = x.qpos
        y.qpos_ref[:] = self._state.q_stop
        y.dq[:], y.qvel_ref[:], y.limit[:] = y.qpos_ref - x.qpos, 0.0, 0.0
        ctrl = y.qpos_ref + x.qfrc_bias / self._gains.servo_stiffness
        y.ctrl[:7] = clamp(ctrl, self._robot.q_min, self._robot.q_max)
