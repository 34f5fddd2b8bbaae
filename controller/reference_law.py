"""The default law: a joint reference, integrated from the commanded hand velocity."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..assets.fields import Layout, Vector
from ..assets.franka import ROBOTS
from .gains import Gains
from .ik import (
    PULL_DAMPING,
    correcting_twist,
    damped_least_squares,
    null_space_part,
    pose_error,
    scaled_least_squares,
)
from .limits import JointLimits, Motion, clamp, within
from .linalg import damped_factor
from .model import ArmModel
from .pid import PID_STATE, Pid
from .signals import KEPT, Late, Law
from .singularity import (
    find_weak_direction,
    manipulability,
    singular_damping,
    smallest_singular_value,
)


class ReferenceLaw(Law):
    """Differential inverse kinematics to a joint reference, which position servos follow.

    With e the pose error, v the hand's twist, T the period, M the mass matrix:

        v    = twist_cmd (extrapolated by half a period) + ik_gain e
        d    = posture_gain (posture - q_ref) + pull_from_ends(q_ref), or with `follow_posture`
        d    = posture_vel_cmd + posture_follow_gain (posture_cmd - q_ref)
        qd   = argmin |J qd - v|^2 + damping^2 |qd - N d|^2, or slower where joint limits bind
        ctrl = q_ref + servo_lag qd + (bias + M qdd) / servo_stiffness + PID(q_ref - q)
        q_ref <- q_ref + T qd

    Readings that are late by `reading_delay` are compared with what was commanded when they were
    taken: e and q_ref - q take the pose command and q_ref of that update.

    Where joint limits bind, the hand keeps to its path rather than to its speed
    (`scaled_least_squares`). The damping is 0 except near singularities (`singular_damping`) and
    there (`ik_damping`). N is the identity, except near singularities: there it keeps d out of the
    task (`null_space_part`), unless d follows a posture, which moves the hand as the task does.
    """

    STATE: ClassVar[Layout] = np.dtype(
        [
            ("q_ref", float, 7),  # [rad]
            ("qd_before", float, 7),  # [rad/s]
            ("qdd_before", float, 7),  # [rad/s^2]
            ("twist_before", float, 6),  # [m/s, rad/s] commanded
            ("weak_direction", float, 6),  # see `linalg`
            ("error", float, 6),  # pose error after the low-pass [m, rad]
            ("pid", PID_STATE),
            ("poses", float, (KEPT, 7)),  # commanded in the last updates, see `Late`
            ("q_refs", float, (KEPT, 7)),  # of the last updates
        ]
    )

    def set_gains(self, gains: Gains) -> None:
        """Change the gains; allowed between any two updates."""
        super().set_gains(gains)
        period = self._period
        self._arm, self._robot = ArmModel(gains.robot), ROBOTS[gains.robot]
        self._error_share = period / (gains.error_filter + period)
        self._limits = JointLimits(gains.limit_share, gains.reference_lead, period, self._robot)
        self._pid = Pid(gains, period, self._state.pid)
        self._poses = Late(self._state.poses, gains.reading_delay, period)
        self._q_refs = Late(self._state.q_refs, gains.reading_delay, period)

    def start(self) -> None:
        """Start at the measured joints, and at their velocities."""
        x, state = self._inputs, self._state
        state.q_ref[:], state.qd_before[:], state.qdd_before[:] = x.qpos, x.qvel, 0.0
        state.twist_before[:] = np.concatenate((x.vel_cmd, x.omega_cmd))
        state.error[:] = pose_error(x.pos_cmd, x.quat_cmd, x.hand_xpos, x.hand_xquat)
        state.weak_direction[:] = find_weak_direction(x.jac)
        self._pid.reset()
        self._poses.reset(np.concatenate((x.pos_cmd, x.quat_cmd)))
        self._q_refs.reset(x.qpos)

    def update(self) -> None:
        """Compute the outputs of one period, see the formulas above."""
        x, y, state, gains = self._inputs, self._outputs, self._state, self._gains
        q, jac, q_ref, qd_before = x.qpos, x.jac, state.q_ref, state.qd_before

        # Twist: the command, extrapolated to the middle of the period, and the correction.
        pose = self._poses.recall(np.concatenate((x.pos_cmd, x.quat_cmd)))
        error = pose_error(pose[:3], pose[3:], x.hand_xpos, x.hand_xquat)
        if gains.error_filter > 0.0:
            error = state.error + self._error_share * (error - state.error)
        state.error[...] = error
        twist_cmd = np.concatenate((x.vel_cmd, x.omega_cmd))
        twist = 1.5 * twist_cmd - 0.5 * state.twist_before + correcting_twist(error, gains)

        # Damped least squares; in the null space the drift.
        factor = damped_factor(jac, 0.0)
        smallest = smallest_singular_value(factor, state.weak_direction)
        damping = singular_damping(smallest, gains)
        y.manipulability[...] = manipulability(factor)
        y.singular[...] = smallest < gains.singular_value
        drift = self._drift()
        if damping > 0.0:
            factor = damped_factor(jac, damping)
            if not gains.follow_posture:  # whose drift moves the hand as the task does
                drift = null_space_part(jac, PULL_DAMPING * damping, drift)
        qd = damped_least_squares(jac, factor, twist, drift)

        # Limits of the joint reference: where one binds, the hand slows down.
        dq = self._q_refs.recall(q_ref) - q
        y.limit[...] = 0.0
        before = Motion(q_ref, qd_before, state.qdd_before, dq)
        if not self._limits.inactive(qd, before):
            box = self._limits.velocity_box(before)
            if not within(qd, box):
                qd = scaled_least_squares(jac, error, qd, gains.ik_damping, damping, box)
                y.limit[...] = self._limits.binding(qd, before, box)

        # Feed-forward of servo lag, gravity and inertia, and the PID.
        qdd = (qd - qd_before) / self._period
        inertia_force = self._arm.inertia_force(q, qdd)
        torque = gains.gravity_feedforward * x.qfrc_bias + gains.inertia_feedforward * inertia_force
        ctrl = q_ref + gains.servo_lag * qd + torque / gains.servo_stiffness + self._pid.update(dq)

        # Write the outputs, with each target clamped to its joint's range, and the state.
        y.ctrl[:7], y.dq[...] = clamp(ctrl, self._robot.q_min, self._robot.q_max), dq
        y.qpos_ref[...], y.qvel_ref[...] = q_ref, qd
        q_ref += self._period * qd
        qd_before[...], state.qdd_before[...], state.twist_before[...] = qd, qdd, twist_cmd

    def _drift(self) -> Vector:
        """Joint velocities d (7,) [rad/s], of which the task leaves the null space's part."""
        x, gains, q_ref = self._inputs, self._gains, self._state.q_ref
        if gains.follow_posture:
            behind = x.posture_cmd - q_ref
            return np.asarray(x.posture_vel_cmd + gains.posture_follow_gain * behind)
        pull = self._limits.pull_from_ends(q_ref)
        return np.asarray(gains.posture_gain * (gains.posture - q_ref) + pull)
