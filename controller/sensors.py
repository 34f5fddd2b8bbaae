"""Sensors between plant and controller: readings of robot and block, with errors.

Errors are applied in the order of a real measuring chain: encoders, the robot's own model of the
hand, the camera, and a transmission with delay and dropouts.
"""

from __future__ import annotations

import numpy as np

from ..assets.fields import Buffer, Vector, as_arrays
from .model import ArmModel
from .sensor_errors import SensorErrors
from .signals import READINGS, TRUTH

_DRAWN = 512  # ticks for which random numbers are drawn at a time


class Sensors:
    """Encoders, the robot's own kinematics, a camera and the line to the controller.

    `update` reads `truth` of the layout `TRUTH` and writes `readings` of the layout `READINGS`; the
    caller may bring their flat arrays (82,) and (131,). Random numbers are a function of seed and
    tick, so the state is the tick and what is on its way.
    """

    def __init__(
        self,
        errors: SensorErrors | None = None,
        truth_values: Vector | None = None,
        reading_values: Vector | None = None,
    ) -> None:
        errors = errors or SensorErrors()
        self.set_errors(errors)
        truth, now = Buffer(TRUTH, truth_values), Buffer(TRUTH)
        readings = Buffer(READINGS, reading_values)
        self.truth_values, self.truth = truth.values, truth.record
        self.reading_values, self.readings = readings.values, readings.record
        self._sent = readings.values[: truth.values.size]
        self._now_values, self._now = now.values, now.views  # measured in this tick
        self._arm = ArmModel(errors.robot)
        self._line = np.zeros((errors.delay, truth.values.size))  # readings on their way
        self._tick, self._drawn_from = 0, -1

    def set_errors(self, errors: SensorErrors) -> None:
        """Change the errors, all but seed, delay and robot; allowed between any two updates."""
        self._errors = as_arrays(errors)
        cos, sin = np.cos(errors.block_yaw_error), np.sin(errors.block_yaw_error)
        self._turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def update(self) -> None:
        """Take one reading, once per tick of 1 ms."""
        self._now_values[:] = self.truth_values
        self._draw()
        self._measure_joints()
        if self._errors.hand_pose_source == "model":
            self._model_hand()
        self._see_block()
        self._send()
        self.readings["mass_matrix"] = self._arm.inertia(self.readings["qpos"])
        self._tick += 1

    def model_start(self) -> None:
        """Leave the readings of the model at the true joints: the start, before any update."""
        self._now_values[:] = self.truth_values
        self._model_hand()
        self._sent[:] = self._now_values
        self.readings["mass_matrix"] = self._arm.inertia(self.readings["qpos"])

    def _measure_joints(self) -> None:
        """Offset, noise and quantisation of the encoders."""
        now, errors, noise = self._now, self._errors, self._normals[self._tick % _DRAWN]
        now.qpos += errors.joint_offset
        now.qpos += errors.joint_noise * noise[:7]
        now.qvel += errors.velocity_noise * noise[7:]
        step = errors.joint_quantisation
        steps = np.where(step > 0.0, step, 1.0)
        now.qpos[:] = np.where(step > 0.0, steps * np.round(now.qpos / steps), now.qpos)

    def _model_hand(self) -> None:
        """Pose, Jacobian and bias force of the robot's own model at the measured joints."""
        now = self._now
        hand = self._arm.hand(now.qpos, now.qvel)
        now.hand_xpos[:], now.hand_xquat[:] = hand.position, hand.orientation
        now.jac[:], now.qfrc_bias[:] = hand.jacobian, hand.bias

    def _see_block(self) -> None:
        """The camera's error of the block's pose."""
        self._now.target_xpos += self._errors.block_position_error
        if self._errors.block_yaw_error:
            self._now.target_xmat[:] = self._turn @ self._now.target_xmat

    def _send(self) -> None:
        """Return the measurement of `delay` ticks ago; if it is lost, the one before."""
        arrived = self._now_values
        if len(self._line):
            if self._tick == 0:
                self._line[:] = arrived  # the robot has been at rest before
            place = self._line[self._tick % len(self._line)]
            arrived, place[:] = place.copy(), arrived
        is_lost = self._chances[self._tick % _DRAWN] < self._errors.dropout
        if self._tick == 0 or not is_lost:  # the first one always arrives
            self._sent[:] = arrived

    def _draw(self) -> None:
        """Draw the numbers of the ticks around this one, normal and uniform ones."""
        part = self._tick // _DRAWN
        if part != self._drawn_from:
            draw = np.random.default_rng((round(self._errors.seed), part))
            self._normals = draw.standard_normal((_DRAWN, 14))
            self._chances = draw.random(_DRAWN)
            self._drawn_from = part

    def get_state(self) -> Vector:
        """Copy all that the next update depends on besides the truth and the last readings."""
        return np.concatenate(([self._tick], self._line.ravel()))

    def set_state(self, state: Vector) -> None:
        """Restore what `get_state` returned, so that a replay gives the same bits."""
        self._tick = int(state[0])
        self._line[:] = state[1:].reshape(self._line.shape)
