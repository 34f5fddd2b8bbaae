"""Cartesian impedance: the hand as a mass on springs and dampers, for the scene `motors`."""

import numpy as np


class Impedance:
    """The hand yields to forces like a spring, the arm's spare joint motion is damped.

    tau = J' (K e + D de) + N' (k0 (q0 - q) - d0 dq) + bias. Along an axis that is blocked, the
    force is stiffness times the distance that the command lies beyond: so contact forces are set
    by the path. After N. Hogan, "Impedance Control", ASME J. Dyn. Sys. Meas. Control 107, 1985,
    and O. Khatib, "A Unified Approach for Motion and Force Control", IEEE J. Rob. Aut. 3, 1987.
    """

    stiffness = (3000.0, 3000.0, 500.0)  # N/m, along the world's axes
    turning_stiffness = 100.0  # N.m/rad
    damping_ratio = 1.0  # of the hand's apparent inertia on these springs
    posture = (0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853)  # rad, q0
    posture_stiffness = 20.0  # N.m/rad, k0
    posture_damping = 5.0  # N.m.s/rad, d0

    # The arguments name the signals that it takes: commands and outputs of the plant, as
    # `panda-cosim info` lists them. Frames: world; quaternions: (w, x, y, z).
    def update(self, time, pos_cmd, quat_cmd, vel_cmd, omega_cmd, grip_cmd, hand_xpos,
               hand_xquat, jac, qpos, qvel, qfrc_bias, mass_matrix):  # fmt: skip
        """Called each millisecond: torques of seven joints [N.m], then the gripper (0 to 255)."""
        error = np.hstack((pos_cmd - hand_xpos, self.turn(quat_cmd, hand_xquat)))
        speed_error = np.hstack((vel_cmd, omega_cmd)) - jac @ qvel
        # The hand's apparent inertia, and the torques' null space: they do not accelerate the hand.
        to_joints = np.linalg.solve(mass_matrix, jac.T)  # M^-1 J'
        inertia = np.linalg.inv(jac @ to_joints + 1e-6 * np.eye(6))
        null_space = np.eye(7) - jac.T @ inertia @ to_joints.T
        stiffness = np.diag((*self.stiffness, *[self.turning_stiffness] * 3))
        wrench = stiffness @ error + self.damping(stiffness, inertia) @ speed_error
        posture = self.posture_stiffness * (np.array(self.posture) - qpos)
        spare = posture - self.posture_damping * qvel
        torque = jac.T @ wrench + null_space @ spare + qfrc_bias
        return np.hstack((torque, np.clip(255 * grip_cmd / 0.08, 0, 255)))

    def damping(self, stiffness, inertia):
        """2 zeta sqrt(K) sqrt(inertia), made symmetric: each direction swings with zeta."""
        values, vectors = np.linalg.eigh(inertia)
        root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
        return self.damping_ratio * (np.sqrt(stiffness) @ root + root @ np.sqrt(stiffness))

    def turn(self, wanted, measured):
        """Rotation from `measured` to `wanted` as a vector [rad], for small angles."""
        w = wanted @ measured
        v = measured[0] * wanted[1:] - wanted[0] * measured[1:] + np.cross(measured[1:], wanted[1:])
        return 2 * np.copysign(1.0, w) * v
