"""The controller: buffers, gains, state and gripper around the control law that is chosen."""

from __future__ import annotations

from typing import Final

import numpy as np

from ..assets.fields import Buffer, Vector
from ..assets.franka import CTRL_OPEN, OPENING_MAX
from .gains import Gains
from .impedance import ImpedanceLaw
from .reference_law import ReferenceLaw
from .signals import INPUTS, OUTPUTS, Law
from .touch import Touch
from .tutorial_law import TutorialLaw

# By the names that `Gains.law` gives.
LAWS: Final[dict[str, type[Law]]] = {
    "reference": ReferenceLaw,
    "tutorial": TutorialLaw,
    "impedance": ImpedanceLaw,
}
STATE: Final = np.dtype(
    [
        ("law", float),  # place of the active one in `LAWS`, from 1; 0: none has started
        ("opening", float),  # [m] commanded now between the fingertips
        *((name, law.STATE) for name, law in LAWS.items()),
        ("touch", Touch.STATE),
    ]
)


class Controller:
    """Computes servo targets of arm and gripper from a commanded hand pose, once per period.

    The law is chosen by `gains.law`; see the classes in `LAWS` for the formulas. The period between
    two updates is in s. `update` reads `inputs` and writes `outputs`, by name and in the layouts
    `INPUTS` and `OUTPUTS`; `input_values` (109,), `output_values` (65,) and `state_values` are the
    flat arrays, of which the caller may bring the first two.

    `ControllerSlave` makes one in the FMU's memory. A law alone is a `Law`, with views of arrays
    that somebody else keeps: write one to move the arm in another way, not a second controller.
    """

    def __init__(
        self,
        gains: Gains | None = None,
        period: float = 0.001,
        input_values: Vector | None = None,
        output_values: Vector | None = None,
    ) -> None:
        self.period = period
        inputs, outputs = Buffer(INPUTS, input_values), Buffer(OUTPUTS, output_values)
        state = Buffer(STATE)
        self.input_values, self.inputs, self._x = inputs.values, inputs.record, inputs.views
        self.output_values, self.outputs, self._y = outputs.values, outputs.record, outputs.views
        self.state_values, self._state = state.values, state.views
        self._laws = {
            name: law(self._x, self._y, getattr(self._state, name), period)
            for name, law in LAWS.items()
        }
        self._touch = Touch(self._x, self._y, self._state.touch, period)
        self.gains = gains or Gains()
        for values in (self.input_values, self.output_values, self.state_values):
            values[:] = 0.0
        self.outputs["ctrl"] = [*self._gains.base_ctrl, CTRL_OPEN]

    @property
    def gains(self) -> Gains:
        """Gains and switches; may be changed between updates."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains = gains
        self._law, self._law_number = self._laws[gains.law], 1 + list(LAWS).index(gains.law)
        self._law.set_gains(gains)
        self._touch.set_gains(gains)

    def update(self) -> None:
        """Compute the outputs of one period from the inputs."""
        if self._touch.takes_over():
            return
        if self._state.law != self._law_number or self._state.touch.reacts:
            self._start()
        self._move_gripper()
        self._law.update()

    def get_state(self) -> Vector:
        """Copy everything that the next update depends on besides inputs and gains (n,)."""
        return np.concatenate((self.state_values, self.output_values))

    def set_state(self, state: Vector) -> None:
        """Restore what `get_state` returned (n,), so that a replay gives the same bits."""
        size = self.state_values.size
        self.state_values[:], self.output_values[:] = state[:size], state[size:]

    def _start(self) -> None:
        """Start the chosen law, and the gripper if no law has run before."""
        if self._state.law == 0.0:
            self._state.opening[...] = self._grip_cmd()
        self._state.law[...], self._state.touch.reacts[...] = self._law_number, 0.0
        self._law.start()

    def _grip_cmd(self) -> float:
        """Opening to go to [m]: the commanded one, or the one that presses with the force."""
        gains, opening = self._gains, float(self._x.grip_cmd)
        if gains.grip_force > 0.0 and opening < gains.grip_width:
            opening = gains.grip_width - 2.0 * gains.grip_force / gains.grip_stiffness
        return min(max(opening, 0.0), OPENING_MAX)

    def _move_gripper(self) -> None:
        """Move the gripper's target towards its command at the fingers' speed."""
        before, opening = float(self._state.opening), self._grip_cmd()
        if self._gains.finger_speed > 0.0:
            step = 2.0 * self._gains.finger_speed * self.period  # both fingers move
            opening = min(max(opening, before - step), before + step)
        self._state.opening[...] = opening
        self._y.ctrl[7] = CTRL_OPEN * (opening / OPENING_MAX)
