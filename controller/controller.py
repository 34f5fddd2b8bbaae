"""The control law: from a commanded hand pose to servo targets."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from assets.franka import CTRL_OPEN, OPENING_MAX, Q_MAX, Q_MIN
from controller import linalg
from controller.gains import DEFAULT, Gains
from controller.ik import (
    BoxedIk,
    Dexterity,
    pseudo_inverse_step,
    rotation_error,
    shorten,
    small_error,
)
from controller.limits import Joints, LimitBox
from controller.model import ArmModel
from controller.pid import Pid
from controller.signals import (
    INPUTS,
    MEASURED,
    N_INPUTS,
    N_OUTPUTS,
    OF_SUMS,
    OF_WISHES,
    OUTPUTS,
    POSES,
    SHARES,
    SIGNALS,
    SUMMED_OUTPUTS,
    SUMS,
    VELOCITY,
    WISHES,
    Sums,
    part,
    scalars,
    wish_matrix,
)

Vector = NDArray[np.float64]
WEIGHING_PERIOD = 0.01  # [s] after which the inertia is looked at again: it changes slowly
WITH_REFERENCE, TUTORIAL = 1.0, 2.0  # laws, as the state names the one that works; 0: none does yet
GRIPPER = 7  # place of its target among the servos'


class Controller:
    """Differential inverse kinematics with a PID a joint, for position servos.

    With reference (`gains.use_reference`), e the pose error and T the period:

        v      = twist_cmd, half a period ahead, + ik_gain e
        qd_ref = argmin |J qd - v|^2 + damping^2 |qd - posture_gain (posture - q_ref)|^2, in limits
        ctrl   = q_ref + servo_lag qd_ref + (bias + M qdd_ref) / servo_stiffness + PID(q_ref - q)
        q_ref  = q_ref + T qd_ref

    The damping is 0 but near singularities (`singular_damping`) and where limits bind
    (`ik_damping`). The mass matrix M is that of `WEIGHING_PERIOD` ago at most.

    Without reference, the tutorial's law: ctrl = base_ctrl + PID(pinv(J) e).

    Args:
        gains: Gains and switches.
        period: Time between two updates [s].
        input_values: Buffer (84,) to read inputs from; None: a new one.
        output_values: Buffer (38,) to leave outputs in; None: a new one.

    Raises:
        ValueError: The period is not above 0.
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
        self.input_values = np.zeros(N_INPUTS) if input_values is None else input_values
        self.output_values = np.zeros(N_OUTPUTS) if output_values is None else output_values
        self.state_values = np.zeros(SIGNALS.itemsize // 8)
        self.inputs = self.input_values.view(INPUTS)[0]
        self.outputs = self.output_values.view(OUTPUTS)[0]
        self._gains = gains
        self._bind()
        self.gains = gains
        self.reset()

    def _bind(self) -> None:
        """Take views of all that an update touches, and bind the calls that it makes, once."""
        inputs, outputs, signals = self.inputs, self.outputs, self.state_values.view(SIGNALS)[0]
        of_inputs = partial(part, self.input_values, INPUTS)
        of_outputs = partial(part, self.output_values, OUTPUTS)
        of_signals = partial(part, self.state_values, SIGNALS)
        self._signals, self._pid_state = signals, signals["pid"]
        self._qpos, self._qvel, self._jac = inputs["qpos"], inputs["qvel"], inputs["jac"]
        self._twist_in = of_inputs("vel_cmd", "omega_cmd")
        self._summed_out = of_outputs(*SUMMED_OUTPUTS)
        self._limit = outputs["limit"]
        self._error, self._twist = signals["error"], signals["twist"]
        self._motion, self._drift = (signals[name] for name in VELOCITY)
        self._weighed = signals["weighed_qpos"]
        of_one = partial(scalars, self.state_values, SIGNALS)
        self._progress, self._gripper = of_one("law", "opening"), of_one("gripper")
        self._until_weighing = of_one("until_weighing")
        self._grip_cmd = scalars(self.input_values, INPUTS, "grip_cmd")
        self._diagnosis = scalars(self.output_values, OUTPUTS, "manipulability", "singular")

        self._from_wishes, self._sums = wish_matrix(self._gains), Sums()
        self._look = linalg.chain(
            linalg.copy(of_signals(*POSES), of_inputs(*POSES)),
            linalg.copy(of_signals(*MEASURED), of_inputs(*MEASURED)),
            *rotation_error(signals["rotation"], inputs["quat_cmd"], inputs["hand_xquat"]),
            linalg.multiply(of_signals(*WISHES), self._from_wishes, of_signals(*OF_WISHES)),
        )
        self._dexterity = Dexterity(self._jac, signals["weakest"])
        self._ik = BoxedIk(
            self._jac, self._dexterity.factor, self._twist, self._drift, self._motion
        )
        of_sums = partial(part, self._sums.values, SUMS)
        self._sum_up = linalg.multiply(self._sums.values, self._sums.matrix, of_signals(*OF_SUMS))
        self._shares = [of_sums(*names) for names in SHARES]
        self._share, self._other_share = map(linalg.norm, self._shares)
        self._arm_ctrl, self._dq = of_sums("ctrl")[:7], of_sums("dq")
        self._qd = np.zeros(7)
        self._commit = linalg.chain(
            linalg.copy(self._summed_out, of_sums(*SUMMED_OUTPUTS)),
            linalg.copy(of_signals("qvel_before", "qpos_ref"), of_sums("qvel_ref", "qpos_next")),
            linalg.copy(signals["twist_before"], of_signals("vel_cmd", "omega_cmd")),
        )
        self._joints = Joints(signals["qpos_ref"], self._qd, signals["qvel_before"], self._dq)
        self._model = ArmModel(self._weighed)

    @property
    def gains(self) -> Gains:
        """Gains and switches; may be changed between updates."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains = gains
        self._base = np.array(gains.base_ctrl)
        self._pid = Pid(
            np.array(gains.kp),
            np.array(gains.ki),
            np.array(gains.kd),
            gains.derivative_filter,
            np.array(gains.integral_limit),
            self.period,
        )
        if self._pid.is_proportional:  # and so is not updated
            self._pid_state[:2], self._pid_state[2] = 0.0, math.nan
        self._law = WITH_REFERENCE if gains.use_reference else TUTORIAL
        self._box = LimitBox(self.period, gains.limit_share, gains.reference_lead, self._joints)
        self._from_wishes[:] = wish_matrix(gains)
        self._sums.tune(gains, self.period, self._box, small_error(gains))
        self._weigh()
        self._limit_shown = True  # unknown, so that `limit` is written at the next update

    def reset(self) -> None:
        """Forget all that has been."""
        self.input_values[:] = 0.0
        self.output_values[:] = 0.0
        self.state_values[:] = 0.0
        self._pid_state[2] = self._progress[1] = math.nan  # marks the first update
        self._signals["one"] = 1.0
        self._gripper[0] = CTRL_OPEN
        self._summed_out[:8] = *self._base, CTRL_OPEN
        self._forget()

    def update(self) -> None:
        """Make the outputs of one period from the inputs."""
        if self._progress[0] != self._law:
            self._start()
        if self._grip_cmd[0] != self._progress[1]:
            self._grip()
        self._look()
        self._diagnosis[0], smallest = self._dexterity.measure()
        if self._law == WITH_REFERENCE:
            self._follow(smallest)
        else:
            self._regulate()

    def get_state(self) -> Vector:
        """Copy all that the next update depends on besides inputs and gains.

        Returns:
            State (n,), to be given to `set_state`.
        """
        return np.concatenate((self.state_values, self.output_values))

    def set_state(self, state: Vector) -> None:
        """Restore a state so that a replay gives the same bits.

        Args:
            state: What `get_state` returned (n,).

        Raises:
            ValueError: The state has another size.
        """
        split = self.state_values.size
        if state.shape != (split + self.output_values.size,):
            raise ValueError(f"state: shape {state.shape} is not that of a controller's state")
        self.state_values[:] = state[:split]
        self.output_values[:] = state[split:]
        self._weigh()
        self._forget()

    def _forget(self) -> None:
        """Drop what is remembered only to save time."""
        self._box.forget()
        self._limit_shown = True

    def _start(self) -> None:
        """Begin with a law at the measured joints, whatever another law has left."""
        signals = self._signals
        self._progress[0] = self._law
        self._pid_state[:2], self._pid_state[2] = 0.0, math.nan
        self.outputs["qvel_ref"], self.outputs["limit"], self.outputs["singular"] = 0.0, 0.0, 0.0
        signals["qpos_ref"] = self._qpos
        signals["qvel_before"] = self._qvel
        signals["twist_before"] = self._twist_in
        self._dexterity.begin()
        self._until_weighing[0] = 0.0

    def _regulate(self) -> None:
        """The tutorial's law."""
        outputs = self.outputs
        dq = pseudo_inverse_step(self._jac, self._error)
        outputs["dq"], outputs["qpos_ref"] = dq, self._qpos + dq
        outputs["ctrl"][:7] = self._base + self._pid.update(dq, self._pid_state)
        outputs["ctrl"][GRIPPER] = self._gripper[0]

    def _follow(self, smallest: float) -> None:
        """The law with a joint reference.

        Args:
            smallest: Smallest singular value of the Jacobian.
        """
        damping = self._damp(smallest)
        self._ik.solve()
        if self._until_weighing[0] <= 0.0:
            self._weighed[:] = self._qpos
            self._until_weighing[0] = round(WEIGHING_PERIOD / self.period)
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
            self._arm_ctrl += self._pid.update(self._dq, self._pid_state)
            self._clip()
        self._commit()

    def _keep_within(self, damping: float) -> None:
        """Keep what the reference and the servos are to do within the limits.

        Args:
            damping: Of the least squares, without that for joints at their limits.
        """
        box, qd, error = self._box, self._qd, self._error
        allowed = shorten(error, self._gains)
        if (allowed != error).any():
            self._twist += self._gains.ik_gain * (allowed - error)
            self._ik.solve()
        np.add(self._drift, self._motion, out=qd)
        box.update()
        limited = not box.holds()
        if limited:
            # Joints at their limits may leave the others near a singularity of their own.
            damping = math.hypot(damping, self._gains.ik_damping)
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
        self._limit[:], self._limit_shown = kinds, shown

    def _weigh(self) -> None:
        """Take the arm's inertia into account as it is where it was weighed."""
        self._sums.weigh(self._model.mass())

    def _damp(self, smallest: float) -> float:
        """Return the damping of the least squares, 0 but near a singularity, and apply it.

        Args:
            smallest: Smallest singular value of the Jacobian.
        """
        gains, damping = self._gains, 0.0
        singular = smallest < gains.singular_value
        if singular:
            nearness = 1.0 - (smallest / gains.singular_value) ** 2
            damping = gains.singular_damping * math.sqrt(nearness)
            self._dexterity.damp(damping)
        self._diagnosis[1] = float(singular)
        return damping

    def _grip(self) -> None:
        """Move the gripper's target towards the command at the fingers' speed."""
        wanted, opening = min(max(self._grip_cmd[0], 0.0), OPENING_MAX), self._progress[1]
        speed = self._gains.finger_speed
        if speed > 0 and not math.isnan(opening):  # two fingers move
            step = 2.0 * speed * self.period
            wanted = min(max(wanted, opening - step), opening + step)
        self._progress[1] = wanted
        self._gripper[0] = CTRL_OPEN * (wanted / OPENING_MAX)
