"""The law with a joint reference, which is integrated from the commanded velocity."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..assets.franka import Q_MAX, Q_MIN
from . import linalg
from .gains import Gains
from .ik import BoxedIk, Dexterity, shorten, small_error
from .limits import Joints, LimitBox
from .matrices import Sums
from .model import ArmModel
from .pid import Pid
from .signals import OF_SUMS, SHARES, SUMMED_OUTPUTS, Buffers

Vector = NDArray[np.float64]
WEIGHING_PERIOD = 0.01  # [s] after which the inertia is looked at again: it changes slowly


class ReferenceLaw:
    """See `controller.Controller`.

    Args:
        buffers: Inputs, outputs and signals.
        dexterity: Measured before each update; its factor serves the least squares.
        period: Time between two updates [s].
    """

    def __init__(self, buffers: Buffers, dexterity: Dexterity, period: float) -> None:
        inputs, outputs, signals = self._buffers = buffers
        self._dexterity, self._period = dexterity, period
        self._qpos, self._weighed = inputs["qpos"], signals["weighed_qpos"]
        self._pid_state = signals["pid"]
        self._until_weighing = signals.scalars("until_weighing")
        self._singular = outputs.scalars("singular")
        self._motion, self._drift = signals["motion"], signals["drift"]
        self._ik = BoxedIk(
            inputs["jac"], dexterity.factor, signals["twist"], self._drift, self._motion
        )
        self._model, self._sums = ArmModel(self._weighed), Sums()
        sums = self._sums.results
        self._sum_up = linalg.multiply(sums.values, self._sums.matrix, signals.part(*OF_SUMS))
        self._shares = [sums.part(*names) for names in SHARES]
        self._share, self._other_share = map(linalg.norm, self._shares)
        self._arm_ctrl = sums["ctrl"][:7]
        self._joints = Joints(signals["qpos_ref"], np.zeros(7), signals["qvel_before"], sums["dq"])
        self._commit = linalg.chain(
            linalg.copy(outputs.part(*SUMMED_OUTPUTS), sums.part(*SUMMED_OUTPUTS)),
            linalg.copy(
                signals.part("qvel_before", "qpos_ref"), sums.part("qvel_ref", "qpos_next")
            ),
            linalg.copy(signals["twist_before"], signals.part("vel_cmd", "omega_cmd")),
        )

    def tune(self, gains: Gains) -> None:
        """Take over gains."""
        self._gains = gains
        self._box = LimitBox(self._period, gains.limit_share, gains.reference_lead, self._joints)
        self._sums.tune(gains, self._period, self._box, small_error(gains))
        self._pid = Pid.of(gains, self._period)
        self._weigh()
        self._limit_shown = True  # unknown, so that `limit` is written at the next update

    def begin(self) -> None:
        """Begin at the measured joints."""
        inputs, _, signals = self._buffers
        signals["qpos_ref"][:] = inputs["qpos"]
        signals["qvel_before"][:] = inputs["qvel"]
        signals["twist_before"][:] = inputs.part("vel_cmd", "omega_cmd")
        self._until_weighing[0] = 0.0

    def restore(self) -> None:
        """Go on from signals that have been set, and drop what was remembered to save time."""
        self._weigh()
        self._box.forget()
        self._limit_shown = True

    def update(self, smallest: float) -> None:
        """Make the outputs of one period.

        Args:
            smallest: Smallest singular value of the Jacobian.
        """
        singular, damping = smallest < self._gains.singular_value, 0.0
        if singular:
            damping = self._damp(smallest)
        self._singular[0] = singular
        self._ik.solve()
        if self._until_weighing[0] <= 0.0:
            self._weighed[:] = self._qpos
            self._until_weighing[0] = round(WEIGHING_PERIOD / self._period)
            self._weigh()
        self._until_weighing[0] -= 1.0
        self._sum_up()
        # A length below 1 has no number beyond 1, and takes less to see.
        spared = (self._share() < 1.0 and self._other_share() < 1.0) or all(
            bool((np.abs(shares) < 1.0).all()) for shares in self._shares
        )
        if not (spared and self._box.spares()):
            self._keep_within(damping)
        elif self._limit_shown:
            self._tell_limits(0.0, shown=False)
        if not self._pid.is_proportional:
            self._arm_ctrl += self._pid.update(self._joints.lag, self._pid_state)
            self._clip()
        self._commit()

    def _damp(self, smallest: float) -> float:
        """Damp the least squares near a singularity, and return by how much.

        Args:
            smallest: Smallest singular value of the Jacobian.
        """
        nearness = 1.0 - (smallest / self._gains.singular_value) ** 2
        damping = self._gains.singular_damping * math.sqrt(nearness)
        self._dexterity.damp(damping)
        return damping

    def _keep_within(self, damping: float) -> None:
        """Keep what the reference and the servos are to do within the limits.

        Args:
            damping: Of the least squares, without that for joints at their limits.
        """
        box, qd, gains = self._box, self._joints.qd, self._gains
        error, twist = self._buffers.signals["error"], self._buffers.signals["twist"]
        allowed = shorten(error, gains)
        if (allowed != error).any():
            twist += gains.ik_gain * (allowed - error)
            self._ik.solve()
        np.add(self._drift, self._motion, out=qd)
        box.update()
        limited = not box.holds()
        if limited:
            # Joints at their limits may leave the others near a singularity of their own.
            damping = math.hypot(damping, gains.ik_damping)
            self._ik.solve_within(qd, box.low, box.high, damping)
            self._motion[:], self._drift[:] = qd, 0.0
        self._sum_up()
        if limited or self._limit_shown:
            self._tell_limits(box.limits() if limited else 0.0, shown=limited)
        self._clip()

    def _clip(self) -> None:
        """Ask no servo for what is beyond its joint's ends."""
        np.clip(self._arm_ctrl, Q_MIN, Q_MAX, out=self._arm_ctrl)

    def _tell_limits(self, kinds: Vector | float, *, shown: bool) -> None:
        self._buffers.outputs["limit"][:] = kinds
        self._limit_shown = shown

    def _weigh(self) -> None:
        """Take the arm's inertia into account as it is where it was weighed."""
        self._sums.weigh(self._model.mass())
