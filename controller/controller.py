"""The control law: from a commanded hand pose to servo targets."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..assets.franka import CTRL_OPEN, OPENING_MAX
from . import linalg
from .gains import DEFAULT, Gains
from .ik import Dexterity, rotation_error
from .matrices import wish_matrix
from .reference import ReferenceLaw
from .signals import (
    INPUTS,
    MEASURED,
    OF_WISHES,
    OUTPUTS,
    POSES,
    SIGNALS,
    WISHES,
    Buffers,
    Memory,
)
from .tutorial import TutorialLaw

Vector = NDArray[np.float64]
WITH_REFERENCE, TUTORIAL = 1.0, 2.0  # laws, as the state names the one that works; 0: none does yet


class Law(Protocol):
    """How outputs are made once the pose error is known."""

    def tune(self, gains: Gains) -> None:
        """Take over gains."""

    def begin(self) -> None:
        """Begin, whatever another law has left."""

    def restore(self) -> None:
        """Go on from signals that have been set."""

    def update(self, smallest: float, /) -> None:
        """Make the outputs of one period; given is the Jacobian's smallest singular value."""


class Controller:
    """Differential inverse kinematics with a PID a joint, for position servos.

    With reference (`gains.use_reference`), e the pose error and T the period:

        v      = twist_cmd, half a period ahead, + ik_gain e
        qd_ref = argmin |J qd - v|^2 + damping^2 |qd - posture_gain (posture - q_ref)|^2, in limits
        ctrl   = q_ref + servo_lag qd_ref + (bias + M qdd_ref) / servo_stiffness + PID(q_ref - q)
        q_ref  = q_ref + T qd_ref

    The damping is 0 but near singularities (`singular_damping`) and where limits bind
    (`ik_damping`). The mass matrix M is that of a hundredth of a second ago at most.

    Without reference, the tutorial's law: ctrl = base_ctrl + PID(pinv(J) e).

    Args:
        gains: Gains and switches.
        period: Time between two updates [s].
        input_values: Buffer (84,) to read inputs from; None: a new one.
        output_values: Buffer (38,) to leave outputs in; None: a new one.

    Attributes:
        inputs: What `update` reads, by names, see `controller.signals.INPUTS`.
        outputs: What it leaves, by names, see `OUTPUTS`.
        input_values: The inputs' flat array.
        output_values: The outputs' flat array.
        signals: What it remembers and computes with, see `SIGNALS`.

    Raises:
        ValueError: The period is not above 0, or a buffer is of another size.
    """

    def __init__(
        self,
        gains: Gains = DEFAULT,
        period: float = 0.001,
        input_values: Vector | None = None,
        output_values: Vector | None = None,
    ) -> None:
        if not (math.isfinite(period) and period > 0):
            raise ValueError(f"period: {period!r} s must be above 0 s")
        self.period = period
        inputs, outputs = Memory(INPUTS, input_values), Memory(OUTPUTS, output_values)
        signals = Memory(SIGNALS)
        self._buffers = Buffers(inputs, outputs, signals)
        self.signals = signals
        self.input_values, self.inputs = inputs.values, inputs.fields
        self.output_values, self.outputs = outputs.values, outputs.fields

        self._begun, self._opening = signals.scalars("law"), signals.scalars("opening")
        self._gripper, self._grip_cmd = signals.scalars("gripper"), inputs.scalars("grip_cmd")
        self._manipulability = outputs.scalars("manipulability")
        self._from_wishes = wish_matrix(gains)
        self._look = linalg.chain(
            linalg.copy(signals.part(*POSES), inputs.part(*POSES)),
            linalg.copy(signals.part(*MEASURED), inputs.part(*MEASURED)),
            *rotation_error(signals["rotation"], inputs["quat_cmd"], inputs["hand_xquat"]),
            linalg.multiply(signals.part(*WISHES), self._from_wishes, signals.part(*OF_WISHES)),
        )
        self._dexterity = Dexterity(inputs["jac"], signals["weakest"])
        self._laws: dict[float, Law] = {
            WITH_REFERENCE: ReferenceLaw(self._buffers, self._dexterity, period),
            TUTORIAL: TutorialLaw(self._buffers, period),
        }
        self.gains = gains
        self.reset()

    @property
    def gains(self) -> Gains:
        """Gains and switches; may be changed between updates."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains = gains
        self._from_wishes[:] = wish_matrix(gains)
        self._number = WITH_REFERENCE if gains.use_reference else TUTORIAL
        self._law = self._laws[self._number]
        self._law.tune(gains)
        if not any(gains.ki + gains.kd):  # then the law does without their state
            self._forget_pids()

    def reset(self) -> None:
        """Forget all that has been."""
        for memory in self._buffers:
            memory.values[:] = 0.0
        signals = self.signals
        signals.fields["one"], signals.fields["gripper"] = 1.0, CTRL_OPEN
        signals.fields["opening"] = math.nan  # marks the first update
        self._forget_pids()
        self.outputs["ctrl"] = [*self._gains.base_ctrl, CTRL_OPEN]
        self._law.restore()

    def update(self) -> None:
        """Make the outputs of one period from the inputs."""
        if self._begun[0] != self._number:
            self._begin()
        if self._grip_cmd[0] != self._opening[0]:
            self._grip()
        self._look()
        self._manipulability[0], smallest = self._dexterity.measure()
        self._law.update(smallest)

    def get_state(self) -> Vector:
        """Copy all that the next update depends on besides inputs and gains.

        Returns:
            State (n,), to be given to `set_state`.
        """
        return np.concatenate((self.signals.values, self.output_values))

    def set_state(self, state: Vector) -> None:
        """Restore a state so that a replay gives the same bits.

        Args:
            state: What `get_state` returned (n,).

        Raises:
            ValueError: The state has another size.
        """
        signals = self.signals.values
        if state.shape != (signals.size + self.output_values.size,):
            raise ValueError(f"state: shape {state.shape} is not that of a controller's state")
        signals[:] = state[: signals.size]
        self.output_values[:] = state[signals.size :]
        self._law.restore()

    def _begin(self) -> None:
        """Begin with a law at what is measured."""
        self._begun[0] = self._number
        self._forget_pids()
        self._dexterity.begin()
        self._law.begin()

    def _forget_pids(self) -> None:
        integral, derivative, previous = self.signals["pid"]
        integral[:], derivative[:], previous[:] = 0.0, 0.0, math.nan  # marks the first update

    def _grip(self) -> None:
        """Move the gripper's target towards the command at the fingers' speed."""
        wanted, opening = min(max(self._grip_cmd[0], 0.0), OPENING_MAX), self._opening[0]
        speed = self._gains.finger_speed
        if speed > 0 and not math.isnan(opening):  # two fingers move
            step = 2.0 * speed * self.period
            wanted = min(max(wanted, opening - step), opening + step)
        self._opening[0] = wanted
        self._gripper[0] = CTRL_OPEN * (wanted / OPENING_MAX)
