"""The control law: from a commanded hand pose to servo targets."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.franka import CTRL_OPEN, OPENING_MAX, Q_MAX, Q_MIN
from controller.gains import DEFAULT, Gains
from controller.ik import (
    BoxedIk,
    Dexterity,
    LimitBox,
    pseudo_inverse_step,
    rotation_error,
)
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
    ctrl_matrix,
    part,
    wish_matrix,
)

Vector = NDArray[np.float64]


class Controller:
    """Differential inverse kinematics with a PID a joint, for position servos.

    With reference (`gains.use_reference`), e the pose error and T the period:

        v      = twist_cmd, half a period ahead, + ik_gain e
        qd_ref = argmin |J qd - v|^2 + damping^2 |qd - posture_gain (posture - q_ref)|^2, in limits
        ctrl   = q_ref + servo_lag qd_ref + (bias + M qdd_ref) / servo_stiffness + PID(q_ref - q)
        q_ref  = q_ref + T qd_ref

    Without it, the tutorial's law: ctrl = base_ctrl + PID(pinv(J) e).

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
        self._model = ArmModel()
        self._bind()
        self._gains = self.gains = gains
        self.reset()

    def _bind(self) -> None:
        """Take views of all that an update touches, once: taking one costs as much as a sum."""
        inputs, outputs, state = self.inputs, self.outputs, self.state_values.view(STATE)[0]
        self._pos_cmd, self._quat_cmd = inputs["pos_cmd"], inputs["quat_cmd"]
        self._twist_in = part(self.input_values, INPUTS, "vel_cmd", "omega_cmd")
        self._grip_cmd = part(self.input_values, INPUTS, "grip_cmd")
        self._hand_xpos, self._hand_xquat = inputs["hand_xpos"], inputs["hand_xquat"]
        self._jac, self._qpos, self._qvel = inputs["jac"], inputs["qpos"], inputs["qvel"]
        self._measured_in = part(self.input_values, INPUTS, *MEASURED)
        self._arm_ctrl, self._gripper_ctrl = outputs["ctrl"][:7], outputs["ctrl"][7:]
        self._dq, self._limit = outputs["dq"], outputs["limit"]
        self._ref_out = part(self.output_values, OUTPUTS, "qpos_ref", "qvel_ref")
        self._diagnosis = part(self.output_values, OUTPUTS, "manipulability", "singular")
        self._state, self._pid_state = state, state["pid"]
        self._progress = part(self.state_values, STATE, "started", "opening")
        self._twist_cmd, self._twist_before = state["twist_cmd"], state["twist_before"]
        self._error = state["error"]
        self._position_error, self._rotation_error = self._error[:3], self._error[3:]
        self._q_ref, self._qd_ref = state["qpos_ref"], state["qvel_ref"]
        self._ref = part(self.state_values, STATE, "qpos_ref", "qvel_ref")
        self._qd_before, self._impulse = state["qvel_before"], state["impulse"]
        self._measured = part(self.state_values, STATE, *MEASURED)
        self._wishes = part(self.state_values, STATE, *WISHES)
        self._signals = part(self.state_values, STATE, *SIGNALS)
        self._dexterity = Dexterity(state["weakest"])
        self._wanted = np.zeros(13)

    @property
    def gains(self) -> Gains:
        """Gains and switches; may be changed between updates."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        if gains.use_reference != self._gains.use_reference:
            self._progress[0] = 0.0  # the reference shall begin where the arm is then
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
        self._box = LimitBox(self.period, gains.limit_share, gains.reference_lead)
        self._from_wishes = wish_matrix(gains, gains.ik_damping)
        self._ik = BoxedIk(gains.ik_damping)
        self._to_ctrl = ctrl_matrix(gains, self._model.armature, self.period)
        self._limited = True  # unknown, so that `limit` is written at the next update

    def reset(self) -> None:
        """Forget all that has been."""
        self.input_values[:] = 0.0
        self.output_values[:] = 0.0
        self.state_values[:] = 0.0
        self._pid_state[2] = self._progress[1] = np.nan  # marks the first update
        self._state["one"] = 1.0
        self._arm_ctrl[:] = self._base
        self._gripper_ctrl[:] = CTRL_OPEN
        self._forget()

    def update(self) -> None:
        """Make the outputs of one period from the inputs."""
        if not self._progress[0]:
            self._start()
        np.subtract(self._pos_cmd, self._hand_xpos, out=self._position_error)
        rotation_error(self._quat_cmd, self._hand_xquat, self._rotation_error)
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
        self._forget()

    def _forget(self) -> None:
        """Drop what is remembered only to save time."""
        self._box.forget()
        self._limited = True

    def _start(self) -> None:
        """Begin at the measured joints."""
        self._progress[0] = 1.0
        self._q_ref[:] = self._qpos
        self._qd_ref[:] = self._qvel
        self._twist_before[:] = self._twist_in
        self._dexterity.begin(self._jac)

    def _regulate(self) -> None:
        """The tutorial's law."""
        dq = self._dq
        dq[:] = pseudo_inverse_step(self._jac, self._error)
        np.add(self._base, self._pid.update(dq, self._pid_state), out=self._arm_ctrl)
        self._ref_out[:7] = self._qpos + dq
        self._diagnosis[0] = self._dexterity.measure(self._jac)[0]

    def _follow(self) -> None:
        """The law with a joint reference."""
        q_ref, qd_ref, qd_before, dq = self._q_ref, self._qd_ref, self._qd_before, self._dq
        ctrl = self._arm_ctrl
        self._damp()
        self._shorten_error()
        np.copyto(self._twist_cmd, self._twist_in)
        mujoco.mju_mulMatVec(self._wanted, self._from_wishes, self._wishes)
        np.copyto(self._twist_before, self._twist_cmd)

        np.subtract(q_ref, self._qpos, out=dq)
        np.copyto(qd_before, qd_ref)
        self._box.update(q_ref, dq, qd_ref)
        limited = self._ik.solve(self._jac, self._wanted, self._box, qd_ref)

        np.copyto(self._measured, self._measured_in)
        self._model.impulse(self._qpos, qd_ref, qd_before, self._impulse)
        mujoco.mju_mulMatVec(ctrl, self._to_ctrl, self._signals)
        if not self._pid.is_proportional:
            ctrl += self._pid.update(dq, self._pid_state)
        np.minimum(ctrl, Q_MAX, out=ctrl)
        np.maximum(ctrl, Q_MIN, out=ctrl)
        np.copyto(self._ref_out, self._ref)
        mujoco.mju_addToScl(q_ref, qd_ref, self.period)
        if limited or self._limited:
            self._limit[:] = self._box.limits(qd_ref) if limited else 0.0
            self._limited = limited

    def _damp(self) -> None:
        """Raise the damping of the least squares near a singularity."""
        gains, diagnosis = self._gains, self._diagnosis
        diagnosis[0], value = self._dexterity.measure(self._jac)
        diagnosis[1] = singular = value < gains.singular_value
        damping = gains.ik_damping
        if singular:
            nearness = 1.0 - (value / gains.singular_value) ** 2
            damping = math.hypot(damping, gains.singular_damping * math.sqrt(nearness))
        if damping != self._ik.damping:
            self._ik.damping = damping
            self._from_wishes = wish_matrix(gains, damping)

    def _shorten_error(self) -> None:
        """Shorten the error to what the correcting speeds allow."""
        gains = self._gains
        x, y, z, a, b, c = self._error.tolist()
        far, turned = math.sqrt(x * x + y * y + z * z), math.sqrt(a * a + b * b + c * c)
        fastest = min(gains.linear_correction, math.sqrt(2.0 * gains.linear_braking * far))
        if gains.ik_gain * far > fastest:
            self._position_error *= fastest / (gains.ik_gain * far)
        fastest = min(gains.angular_correction, math.sqrt(2.0 * gains.angular_braking * turned))
        if gains.ik_gain * turned > fastest:
            self._rotation_error *= fastest / (gains.ik_gain * turned)

    def _grip(self) -> None:
        """Move the gripper's target towards the command at the fingers' speed."""
        wanted, opening = min(max(self._grip_cmd.item(), 0.0), OPENING_MAX), self._progress.item(1)
        if wanted == opening:
            return
        speed = self._gains.finger_speed
        if speed > 0 and not math.isnan(opening):  # two fingers move
            step = 2.0 * speed * self.period
            wanted = min(max(wanted, opening - step), opening + step)
        self._progress[1] = wanted
        self._gripper_ctrl[0] = CTRL_OPEN * (wanted / OPENING_MAX)
