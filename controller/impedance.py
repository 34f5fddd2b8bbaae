"""Cartesian impedance: the hand as a mass on springs and dampers, by torques of the joints."""

from __future__ import annotations

from typing import ClassVar, Final

import mujoco
import numpy as np

from ..assets.fields import Layout, Vector
from ..assets.franka import JOINT_DAMPING, ROBOTS, TORQUE_MAX, TORQUE_RATE_MAX
from .gains import Gains
from .ik import pose_error
from .limits import clamp
from .linalg import damped_factor, geometric_mean, inverse, mat_mat_t, mat_t_vec, mat_vec
from .model import ArmModel
from .signals import KEPT, Late, Law
from .singularity import manipulability

# Added to the inverse of the hand's inertia, which bounds the inertia near singularities.
COMPLIANCE: Final = 1e-3  # [1/kg, 1/(kg m^2)]
TORQUE, TORQUE_RATE = 5.0, 6.0  # values of `limit`


class ImpedanceLaw(Law):
    """The hand yields to forces like a spring, and comes back no faster than its dampers let it.

    With e the pose error, v the hand's twist, a_cmd the change of twist_cmd per period T, and of
    the law's own model M the mass matrix and bias the torques of gravity, velocities and damping:

        L   = (J M^-1 J^T)^-1                 the hand's inertia
        D   = 2 damping_ratio (L # K)         K = diag(stiffness), # the geometric mean
        S   = K e, its force and its torque no larger than `spring_force` and `spring_torque`
        F   = S + D (twist_cmd - v) + L (a_cmd - dJ/dt qd) + force_cmd + offset
        s   = posture_stiffness (posture - q) - posture_damping qd
        tau = J^T F + (1 - J^T L J M^-1) s + bias

    within `limit_share` of the robot's torques and torque rates. 2 (L # K) is the damping of double
    diagonalization, L # K = L^1/2 (L^-1/2 K L^-1/2)^1/2 L^1/2: each mode of the hand on its springs
    is damped alike. s acts in the null space; `follow_posture` takes posture_cmd as the posture.

    The offset is what the model lacks: friction, a load, errors of masses. It grows by
    T offset_rate S, up to `offset_limit`. It rests along axes with a commanded force, and about
    all axes while there is one.

    Sources: O. Khatib, "A Unified Approach for Motion and Force Control of Robot Manipulators",
    IEEE J. Robotics and Automation 3(1), 1987; A. Albu-Schaeffer, C. Ott, U. Frese, G. Hirzinger,
    "Cartesian Impedance Control of Redundant Robots: Recent Results with the
    DLR-Light-Weight-Arms", ICRA 2003.
    """

    STATE: ClassVar[Layout] = np.dtype(
        [
            ("torque_before", float, 7),  # [N.m]
            ("twist_before", float, 6),  # [m/s, rad/s] commanded
            ("jac_before", float, (6, 7)),
            ("offset", float, 6),  # [N, N.m]
            ("poses", float, (KEPT, 7)),  # commanded in the last updates, see `Late`
        ]
    )

    def set_gains(self, gains: Gains) -> None:
        """Change the gains; allowed between any two updates."""
        super().set_gains(gains)
        self._arm, self._robot = ArmModel(gains.robot), ROBOTS[gains.robot]
        self._most = gains.limit_share * TORQUE_MAX
        self._step = gains.limit_share * TORQUE_RATE_MAX * self._period
        self._poses = Late(self._state.poses, gains.reading_delay, self._period)

    def start(self) -> None:
        """Start with the torques that hold the arm; outputs that the law does not have are 0."""
        x, y, state = self._inputs, self._outputs, self._state
        state.torque_before[:] = self._bias()
        state.twist_before[:] = np.concatenate((x.vel_cmd, x.omega_cmd))
        state.offset[:], y.dq[:], y.qvel_ref[:], y.singular[...] = 0.0, 0.0, 0.0, 0.0
        state.jac_before[:] = x.jac
        self._poses.reset(np.concatenate((x.pos_cmd, x.quat_cmd)))

    def update(self) -> None:
        """Compute the outputs of one period, see the formulas above."""
        x, y, state, gains = self._inputs, self._outputs, self._state, self._gains
        bias = self._bias()
        moved = self._arm.moved_by(x.jac)  # J M^-1
        inverse_inertia = mat_mat_t(moved, x.jac)
        inverse_inertia.reshape(-1)[::7] += COMPLIANCE
        inertia = inverse(inverse_inertia)
        damping = 2.0 * gains.damping_ratio * geometric_mean(inertia, gains.stiffness)

        pose = self._poses.recall(np.concatenate((x.pos_cmd, x.quat_cmd)))
        spring = gains.stiffness * pose_error(pose[:3], pose[3:], x.hand_xpos, x.hand_xquat)
        _shorten(spring[:3], gains.spring_force)
        _shorten(spring[3:], gains.spring_torque)
        twist_cmd = np.concatenate((x.vel_cmd, x.omega_cmd))
        turning = mat_vec(x.jac - state.jac_before, x.qvel)
        change = (twist_cmd - state.twist_before - turning) / self._period
        state.twist_before[:], state.jac_before[:] = twist_cmd, x.jac
        grown = state.offset + self._period * gains.offset_rate * spring
        grown = clamp(grown, -gains.offset_limit, gains.offset_limit)
        rests = np.append(x.force_cmd != 0.0, [x.force_cmd.any()] * 3)
        state.offset[:] = np.where(rests, state.offset, grown)
        wrench = spring + mat_vec(damping, twist_cmd - mat_vec(x.jac, x.qvel)) + state.offset
        wrench[:3] += x.force_cmd

        posture = x.posture_cmd if gains.follow_posture else gains.posture
        spare = gains.posture_stiffness * (posture - x.qpos) - gains.posture_damping * x.qvel
        wrench += mat_vec(inertia, change - mat_vec(moved, spare))
        torque = clamp(mat_t_vec(x.jac, wrench) + spare + bias, -self._most, self._most)
        before, unlimited = state.torque_before, torque
        torque = clamp(torque, before - self._step, before + self._step)

        y.limit[:] = np.where(np.abs(unlimited) == self._most, TORQUE, 0.0)
        y.limit[torque != unlimited] = TORQUE_RATE
        before[:], y.motor_torque[:] = torque, torque
        y.ctrl[:7], y.qpos_ref[:] = clamp(x.qpos, self._robot.q_min, self._robot.q_max), x.qpos
        y.manipulability[...] = manipulability(damped_factor(x.jac, 0.0))

    def _bias(self) -> Vector:
        """Torques of gravity, velocities and joint damping (7,) [N.m] at the measured joints."""
        x = self._inputs
        damping = JOINT_DAMPING[self._gains.robot] * x.qvel
        return np.asarray(self._arm.hand(x.qpos, x.qvel).bias + damping)


def _shorten(vector: Vector, most: float) -> None:
    """Shorten, in place, a vector (3,) that is longer than `most`."""
    length = mujoco.mju_norm3(vector)
    if length > most:
        vector *= most / length
