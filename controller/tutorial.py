"""The law of the published tutorial: PIDs on the joint error that the pseudo-inverse gives."""

from __future__ import annotations

import numpy as np

from .gains import Gains
from .ik import pseudo_inverse_step
from .pid import Pid
from .signals import Buffers


class TutorialLaw:
    """See `controller.Controller`.

    Args:
        buffers: Inputs, outputs and signals.
        period: Time between two updates [s].
    """

    def __init__(self, buffers: Buffers, period: float) -> None:
        self._buffers, self._period = buffers, period

    def tune(self, gains: Gains) -> None:
        """Take over gains."""
        self._base = np.array(gains.base_ctrl)
        self._pid = Pid.of(gains, self._period)

    def begin(self) -> None:
        """Show none of what the other law may have left."""
        outputs = self._buffers.outputs
        for name in ("qvel_ref", "limit", "singular"):
            outputs.fields[name] = 0.0

    def restore(self) -> None:
        """Go on from signals that have been set."""

    def update(self, _smallest: float) -> None:
        """Make the outputs of one period."""
        inputs, outputs, signals = self._buffers
        dq = pseudo_inverse_step(inputs["jac"], signals["error"])
        outputs["dq"][:] = dq
        outputs["qpos_ref"][:] = inputs["qpos"] + dq
        outputs["ctrl"][:7] = self._base + self._pid.update(dq, signals["pid"])
        outputs["ctrl"][7:] = signals.fields["gripper"]
