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
    LEAST_DAMPING,
    BoxedIk,
    Dexterity,
    PoseError,
    pseudo_inverse_step,
)
from controller.limits import Joints, LimitBox
from controller.model import ArmModel
from controller.pid import Pid
from controller.signals import (
    INPUTS,
    MEASURED,
    N_INPUTS,
    N_OUTPUTS,
    OUTPUTS,
    SIGNALS,
    STATE,
    WISHES,
    CtrlMatrix,
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

    The mass matrix M is that of `WEIGHING_PERIOD` ago at most.

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
        self.state_values = np.zeros(STATE.itemsize // 8)
        self.inputs = self.input_values.view(INPUTS)[0]
        self.outputs = self.output_values.view(OUTPUTS)[0]
        self._gains = gains
        self._bind()
        self.gains = gains
        self.reset()

    def _bind(self) -> None:
        """Take views of all that an update touches, and bind the calls that it makes, once."""
        inputs, outputs, state = self.inputs, self.outputs, self.state_values.view(STATE)[0]
        of_inputs = partial(part, self.input_values, INPUTS)
        of_outputs = partial(part, self.output_values, OUTPUTS)
        of_state = partial(part, self.state_values, STATE)
        self._state, self._pid_state = state, state["pid"]
        self._qpos, self._qvel, self._jac = inputs["qpos"], inputs["qvel"], inputs["jac"]
        self._arm_ctrl, self._dq, self._limit = outputs["ctrl"][:7], outputs["dq"], outputs["limit"]
        self._q_ref, self._qd_ref, qd_before = (
            state[name] for name in ("qpos_ref", "qvel_ref", "qvel_before")
        )
        self._ref_out = of_outputs("qpos_ref", "qvel_ref")
        self._twist_in = of_inputs("vel_cmd", "omega_cmd")
        self._twist_before = state["twist_before"]
        self._grip_cmd = scalars(self.input_values, INPUTS, "grip_cmd")
        self._ctrl = scalars(self.output_values, OUTPUTS, "ctrl")
        self._diagnosis = scalars(self.output_values, OUTPUTS, "manipulability", "singular")
        self._progress = scalars(self.state_values, STATE, "law", "opening")
        self._weighed = state["weighed_qpos"]
        self._until_weighing = scalars(self.state_values, STATE, "until_weighing")

        self._error = state["error"]
        commanded = inputs["pos_cmd"], inputs["quat_cmd"]
        measured = inputs["hand_xpos"], inputs["hand_xquat"]
        self._pose_error = PoseError(*commanded, *measured, self._error)
        self._dexterity = Dexterity(self._jac, state["weakest"])
        wanted, self._from_wishes = np.zeros(13), wish_matrix(self._gains, LEAST_DAMPING)
        self._ik = BoxedIk(LEAST_DAMPING, self._jac, wanted, self._qd_ref)
        # From the twist that is wanted to the reference's velocity, as if there were no limits.
        self._move = linalg.chain(
            linalg.copy(state["twist_cmd"], self._twist_in),
            linalg.multiply(wanted, self._from_wishes, of_state(*WISHES)),
            linalg.copy(self._twist_before, state["twist_cmd"]),
            linalg.subtract(self._dq, self._q_ref, self._qpos),
            linalg.copy(qd_before, self._qd_ref),
            self._ik.solve,
            linalg.copy(of_state(*MEASURED), of_inputs(*MEASURED)),
        )
        self._joints = Joints(self._q_ref, self._qd_ref, qd_before, self._dq)
        self._model = ArmModel()
        self._to_ctrl = CtrlMatrix()
        self._sum_up = linalg.multiply(self._arm_ctrl, self._to_ctrl.matrix, of_state(*SIGNALS))
        offset = np.zeros(7)
        self._see_offset = linalg.subtract(offset, self._arm_ctrl, self._q_ref)
        self._offset = linalg.norm(offset)
        self._integrate = linalg.chain(
            linalg.copy(self._ref_out, of_state("qpos_ref", "qvel_ref")),
            linalg.add_scaled(self._q_ref, self._qd_ref, self.period),
        )

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
            self._pid_state[:2], self._pid_state[2] = 0.0, np.nan
        self._box = LimitBox(self.period, gains.limit_share, gains.reference_lead, self._joints)
        self._damping = max(gains.ik_damping, LEAST_DAMPING)
        self._set_damping(self._damping)
        self._pose_error.tune(gains)
        self._to_ctrl.tune(gains, self.period)
        self._weigh()
        self._limit_shown = True  # unknown, so that `limit` is written at the next update

    def reset(self) -> None:
        """Forget all that has been."""
        self.input_values[:] = 0.0
        self.output_values[:] = 0.0
        self.state_values[:] = 0.0
        self._pid_state[2] = self._progress[1] = math.nan  # marks the first update
        self._state["one"] = 1.0
        self._arm_ctrl[:] = self._base
        self._ctrl[GRIPPER] = CTRL_OPEN
        self._forget()

    def update(self) -> None:
        """Make the outputs of one period from the inputs."""
        if self._progress[0] != (WITH_REFERENCE if self._gains.use_reference else TUTORIAL):
            self._start()
        self._pose_error.update()
        if self._gains.use_reference:
            self._follow()
        else:
            self._regulate()
        self._grip()

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
        self._progress[0] = WITH_REFERENCE if self._gains.use_reference else TUTORIAL
        self._pid_state[:2], self._pid_state[2] = 0.0, math.nan
        self._ref_out[7:], self._limit[:], self._diagnosis[1] = 0.0, 0.0, 0.0
        self._q_ref[:] = self._qpos
        self._qd_ref[:] = self._qvel
        self._twist_before[:] = self._twist_in
        self._dexterity.begin()
        self._until_weighing[0] = 0.0

    def _regulate(self) -> None:
        """The tutorial's law."""
        dq = self._dq
        dq[:] = pseudo_inverse_step(self._jac, self._error)
        np.add(self._base, self._pid.update(dq, self._pid_state), out=self._arm_ctrl)
        self._ref_out[:7] = self._qpos + dq
        self._diagnosis[0] = self._dexterity.measure()[0]

    def _follow(self) -> None:
        """The law with a joint reference."""
        self._damp()
        self._pose_error.shorten()
        self._move()
        spared = self._box.spares()
        if not spared:
            self._keep_within()
        elif self._limit_shown:
            self._tell_limits(0.0, shown=False)
        if self._until_weighing[0] <= 0.0:
            self._weighed[:] = self._qpos
            self._until_weighing[0] = round(WEIGHING_PERIOD / self.period)
            self._weigh()
        self._until_weighing[0] -= 1.0
        self._sum_up()
        if not self._pid.is_proportional:
            self._arm_ctrl += self._pid.update(self._dq, self._pid_state)
        self._see_offset()
        if not (spared and self._offset() < self._box.room):
            np.minimum(self._arm_ctrl, Q_MAX, out=self._arm_ctrl)
            np.maximum(self._arm_ctrl, Q_MIN, out=self._arm_ctrl)
        self._integrate()

    def _keep_within(self) -> None:
        """Keep the reference's velocity within the limits, and tell which of them bind."""
        box = self._box
        box.update()
        limited = not box.holds()
        if limited:
            self._ik.solve_within(box.low, box.high)
        if limited or self._limit_shown:
            self._tell_limits(box.limits() if limited else 0.0, shown=limited)

    def _tell_limits(self, kinds: Vector | float, *, shown: bool) -> None:
        self._limit[:], self._limit_shown = kinds, shown

    def _weigh(self) -> None:
        """Take the arm's inertia into account as it is where it was weighed."""
        self._to_ctrl.weigh(self._model.mass(self._weighed))

    def _damp(self) -> None:
        """Raise the damping of the least squares near a singularity."""
        gains, diagnosis = self._gains, self._diagnosis
        diagnosis[0], value = self._dexterity.measure()
        singular = value < gains.singular_value
        diagnosis[1] = float(singular)
        damping = self._damping
        if singular:
            nearness = 1.0 - (value / gains.singular_value) ** 2
            damping = math.hypot(damping, gains.singular_damping * math.sqrt(nearness))
        if damping != self._ik.damping:
            self._set_damping(damping)

    def _set_damping(self, damping: float) -> None:
        self._ik.damping = damping
        self._from_wishes[:] = wish_matrix(self._gains, damping)

    def _grip(self) -> None:
        """Move the gripper's target towards the command at the fingers' speed."""
        wanted, opening = min(max(self._grip_cmd[0], 0.0), OPENING_MAX), self._progress[1]
        if wanted == opening:
            return
        speed = self._gains.finger_speed
        if speed > 0 and not math.isnan(opening):  # two fingers move
            step = 2.0 * speed * self.period
            wanted = min(max(wanted, opening - step), opening + step)
        self._progress[1] = wanted
        self._ctrl[GRIPPER] = CTRL_OPEN * (wanted / OPENING_MAX)
