"""The control law: from a commanded hand pose to servo targets."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from assets.franka import CTRL_OPEN, OPENING_MAX, Q_MAX, Q_MIN
from controller.gains import DEFAULT, Gains
from controller.ik import BoxedIk, manipulability, pseudo_inverse_step, rotation_error
from controller.model import ArmModel
from controller.pid import Pid

Vector = NDArray[np.float64]

# What the controller takes and gives; the fields' order is that of the flat buffers.
INPUTS = np.dtype(
    [
        ("pos_cmd", float, 3),
        ("quat_cmd", float, 4),
        ("vel_cmd", float, 3),
        ("omega_cmd", float, 3),
        ("grip_cmd", float),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("jac", float, (6, 7)),
        ("qpos", float, 7),
        ("qvel", float, 7),
        ("qfrc_bias", float, 7),
    ]
)
OUTPUTS = np.dtype(
    [
        ("ctrl", float, 8),
        ("dq", float, 7),
        ("qpos_ref", float, 7),
        ("qvel_ref", float, 7),
        ("manipulability", float),
        ("singular", float),
        ("limit", float, 7),
    ]
)
N_INPUTS, N_OUTPUTS = INPUTS.itemsize // 8, OUTPUTS.itemsize // 8
# What the next update depends on besides the inputs.
STATE = np.dtype(
    [
        ("started", float),
        ("qpos_ref", float, 7),
        ("qvel_ref", float, 7),
        ("twist_cmd", float, 6),
        ("pid", float, (3, 7)),
        ("opening", float),
    ]
)
POSITION, VELOCITY, ACCELERATION = 1.0, 2.0, 3.0  # codes of `limit`


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
        self._state = self.state_values.view(STATE)[0]
        self._model = ArmModel()
        self._error = np.zeros(6)
        self._twist = np.zeros(6)
        self.gains = gains
        self.reset()

    @property
    def gains(self) -> Gains:
        """Gains and switches; may be changed between updates."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains = gains
        arrays = {
            name: np.array(getattr(gains, name))
            for name in (
                *("kp", "ki", "kd", "integral_limit"),
                *("base_ctrl", "posture", "posture_gain", "servo_lag"),
            )
        }
        self._base, self._posture = arrays["base_ctrl"], arrays["posture"]
        self._posture_gain = arrays["posture_gain"]
        self._lag = arrays["servo_lag"]
        stiffness = np.array(gains.servo_stiffness)
        self._bias_to_ctrl = np.array(gains.gravity_feedforward) / stiffness
        self._inertia_to_ctrl = np.array(gains.inertia_feedforward) / stiffness
        self._pid = Pid(
            arrays["kp"],
            arrays["ki"],
            arrays["kd"],
            gains.derivative_filter,
            arrays["integral_limit"],
            self.period,
        )
        self._ik = BoxedIk(self.period, gains.limit_share)

    def reset(self) -> None:
        """Forget all that has been."""
        self.input_values[:] = 0.0
        self.output_values[:] = 0.0
        self.state_values[:] = 0.0
        self._state["pid"][2] = np.nan  # marks the first update
        self.outputs["ctrl"][:7] = self._base
        self.outputs["ctrl"][7] = CTRL_OPEN

    def update(self) -> None:
        """Make the outputs of one period from the inputs."""
        inputs, state = self.inputs, self._state
        if not state["started"]:
            self._start()
        error = self._error
        np.subtract(inputs["pos_cmd"], inputs["hand_xpos"], out=error[:3])
        rotation_error(inputs["quat_cmd"], inputs["hand_xquat"], error[3:])
        self._follow(error) if self._gains.use_reference else self._regulate(error)
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

    def _start(self) -> None:
        """Begin at the measured joints."""
        inputs, state = self.inputs, self._state
        state["started"] = 1.0
        state["qpos_ref"] = inputs["qpos"]
        state["qvel_ref"] = inputs["qvel"]
        state["twist_cmd"][:3] = inputs["vel_cmd"]
        state["twist_cmd"][3:] = inputs["omega_cmd"]
        state["opening"] = inputs["grip_cmd"]

    def _regulate(self, error: Vector) -> None:
        """The tutorial's law."""
        out, inputs = self.outputs, self.inputs
        dq = pseudo_inverse_step(inputs["jac"], error)
        out["ctrl"][:7] = self._base + self._pid.update(dq, self._state["pid"])
        out["dq"] = dq
        out["qpos_ref"] = inputs["qpos"] + dq
        out["manipulability"] = manipulability(inputs["jac"])

    def _follow(self, error: Vector) -> None:
        """The law with a joint reference."""
        out, inputs, state, gains = self.outputs, self.inputs, self._state, self._gains
        q, jac = inputs["qpos"], inputs["jac"]
        q_ref, qd_before, qd_ref = state["qpos_ref"], state["qvel_ref"].copy(), state["qvel_ref"]

        twist = self._wanted_twist(error)
        damping = self._damping(jac)
        posture = self._posture_gain * (self._posture - q_ref)
        self._ik.solve(jac, twist, posture, damping, q_ref, qd_before, qd_ref)

        qdd_ref = (qd_ref - qd_before) / self.period
        dq = q_ref - q
        out["ctrl"][:7] = (
            q_ref
            + self._lag * qd_ref
            + self._bias_to_ctrl * inputs["qfrc_bias"]
            + self._inertia_to_ctrl * self._model.inertia_force(q, qdd_ref)
            + self._pid.update(dq, state["pid"])
        )
        np.clip(out["ctrl"][:7], Q_MIN, Q_MAX, out=out["ctrl"][:7])
        out["dq"], out["qpos_ref"], out["qvel_ref"] = dq, q_ref, qd_ref
        q_ref += self.period * qd_ref

    def _wanted_twist(self, error: Vector) -> Vector:
        """Commanded twist half a period ahead, plus a bounded correction (6,)."""
        inputs, gains, before = self.inputs, self._gains, self._state["twist_cmd"]
        twist = self._twist
        twist[:3], twist[3:] = inputs["vel_cmd"], inputs["omega_cmd"]
        ahead = 1.5 * twist - 0.5 * before  # the mean over the period, to second order
        before[:] = twist
        ahead[:3] += bounded(gains.ik_gain * error[:3], gains.linear_correction)
        ahead[3:] += bounded(gains.ik_gain * error[3:], gains.angular_correction)
        return ahead

    def _damping(self, jac: Vector) -> float:
        """Damping of the least squares, which grows near a singularity."""
        gains, out = self._gains, self.outputs
        measure = manipulability(jac)
        out["manipulability"] = measure
        out["singular"] = float(measure < gains.singular_manipulability)
        if not out["singular"]:
            return gains.ik_damping
        nearness = 1.0 - measure / gains.singular_manipulability
        return gains.ik_damping + gains.singular_damping * nearness**2

    def _grip(self) -> None:
        """Move the gripper's target towards the command at the fingers' speed."""
        state, speed = self._state, self._gains.finger_speed
        wanted = min(max(float(self.inputs["grip_cmd"]), 0.0), OPENING_MAX)
        opening = float(state["opening"])
        if speed > 0:  # two fingers move
            step = 2.0 * speed * self.period
            wanted = min(max(wanted, opening - step), opening + step)
        state["opening"] = wanted
        self.outputs["ctrl"][7] = CTRL_OPEN * (wanted / OPENING_MAX)


def bounded(vector: Vector, length: float) -> Vector:
    """Shorten a vector to a length at most."""
    norm = math.sqrt(vector @ vector)
    return vector if norm <= length else vector * (length / norm)
