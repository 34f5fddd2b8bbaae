"""A control law. Its class becomes an FMU when the scenario is run."""

import numpy as np


class ResolvedRate:
    """Resolved rate: joint velocities that move the hand as commanded, by damped least squares."""

    # Numbers here are parameters of the FMU.
    gain = 10.0  # 1/s, rate at which a pose error is driven to zero
    damping = 0.05  # of the least squares
    lag = 0.1  # s, by which a servo lags behind a ramp; its target is that much ahead

    def start(self):
        self.target = None  # of the seven joint servos [rad]

    # The arguments name its inputs: commands, and outputs of the plant (see `panda-cosim info`).
    # Positions [m] and quaternions (w, x, y, z) are in the world frame.
    def update(self, time, pos_cmd, quat_cmd, vel_cmd, grip_cmd, hand_xpos, hand_xquat, jac, qpos):
        """Called every millisecond; returns seven servo targets [rad] and the gripper's (0-255)."""
        if self.target is None:
            self.target = qpos
        error = np.hstack((pos_cmd - hand_xpos, self.turn(quat_cmd, hand_xquat)))
        twist = np.hstack((vel_cmd, np.zeros(3))) + self.gain * error  # of the hand [m/s, rad/s]
        square = jac @ jac.T + self.damping**2 * np.eye(6)
        speed = jac.T @ np.linalg.solve(square, twist)  # of the joints [rad/s]
        self.target = self.target + 0.001 * speed
        return np.hstack((self.target + self.lag * speed, np.clip(255 * grip_cmd / 0.08, 0, 255)))

    def turn(self, wanted, measured):
        """Rotation from `measured` to `wanted` as a vector [rad], for small angles."""
        w = wanted @ measured
        v = measured[0] * wanted[1:] - wanted[0] * measured[1:] + np.cross(measured[1:], wanted[1:])
        return 2 * np.copysign(1.0, w) * v
