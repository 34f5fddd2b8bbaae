"""The robot's own controllers, which make torques of a motion's reference."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Buffer, Vector
from ..gains import Gains
from ..impedance import ImpedanceLaw
from ..signals import INPUTS, OUTPUTS
from .description import ROBOT
from .measured import Measured
from .motions import Motion

# Of the joints' springs [N.m/rad] and dampers [N.m.s/rad]: a fast and well damped arm.
STIFFNESS: Final = np.array([3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0])
DAMPING: Final = np.array([110.0, 110.0, 80.0, 70.0, 30.0, 25.0, 20.0])


class JointImpedance:
    """A spring and a damper between each joint and its reference."""

    def __init__(self) -> None:
        self.set_stiffness(STIFFNESS)

    def set_stiffness(self, stiffness: Vector) -> None:
        """Change the springs (7,) [N.m/rad]; the dampers keep the damping ratio."""
        self._stiffness, self._damping = stiffness, DAMPING * np.sqrt(stiffness / STIFFNESS)

    def torque(self, measured: Measured, motion: Motion) -> Vector:
        """Return the torques (7,) [N.m], without those that carry the arm."""
        spring: Vector = self._stiffness * (motion.q - measured.q)
        spring += self._damping * (motion.dq - measured.dq)
        return spring


class CartesianImpedance:
    """The hand on springs and dampers: the project's impedance law."""

    def __init__(self, measured: Measured) -> None:
        self._arm, x = measured.arm, measured.inputs
        self._inputs, self._outputs = Buffer(INPUTS).views, Buffer(OUTPUTS).views
        seen = {name: getattr(x, name) for name in ("hand_xpos", "hand_xquat", "jac", "qfrc_bias")}
        vars(self._inputs).update(seen, qpos=measured.q, qvel=measured.dq)
        state = Buffer(ImpedanceLaw.STATE).views
        self._law = ImpedanceLaw(self._inputs, self._outputs, state, STEP_SIZE)
        self._gains = Gains(robot=ROBOT, impedance=True, follow_posture=True, limit_share=1.0)
        self._law.set_gains(self._gains)

    def set_stiffness(self, stiffness: Vector) -> None:
        """Change the springs (6,) [N/m, N.m/rad]."""
        self._gains = replace(self._gains, stiffness=tuple(stiffness.tolist()))
        self._law.set_gains(self._gains)

    def start(self, motion: Motion) -> None:
        """Start from rest."""
        self._command(motion)
        self._law.start()

    def torque(self, motion: Motion) -> Vector:
        """Return the torques (7,) [N.m], without those that carry the arm."""
        self._command(motion)
        self._law.update()
        return np.asarray(self._outputs.motor_torque - self._inputs.qfrc_bias)

    def _command(self, motion: Motion) -> None:
        hand, inputs = self._arm.hand(motion.q), self._inputs
        twist = hand.jacobian @ motion.dq
        inputs.pos_cmd[:], inputs.quat_cmd[:] = hand.position, hand.orientation
        inputs.vel_cmd[:], inputs.omega_cmd[:] = twist[:3], twist[3:]
        inputs.posture_cmd[:] = motion.q
