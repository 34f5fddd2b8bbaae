"""Differential inverse kinematics of the arm, with and without limits."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def rotation_error(quat_cmd: Vector, quat_hand: Vector, out: Vector) -> None:
    """Rotation vector that turns the hand into the command, in the world frame.

    Args:
        quat_cmd: Commanded orientation (w, x, y, z).
        quat_hand: Measured orientation (w, x, y, z).
        out: Receives the vector (3,) [rad], of length pi at most.
    """
    mujoco.mju_subQuat(out, quat_cmd, quat_hand)  # in the hand's own frame
    mujoco.mju_rotVecQuat(out, out, quat_hand)


def pseudo_inverse_step(jac: Matrix, error: Vector) -> Vector:
    """Smallest joint displacement that removes a pose error, to first order.

    Args:
        jac: Hand Jacobian (6, 7), world axes, linear rows first.
        error: Pose error (6,) [m, rad], world frame.

    Returns:
        Joint displacement (7,) [rad].
    """
    step: Vector = np.linalg.pinv(jac) @ error
    return step


def manipulability(jac: Matrix) -> float:
    """Yoshikawa's measure sqrt(det(J J^T)), 0 at a singularity.

    Source: T. Yoshikawa, "Manipulability of Robotic Mechanisms", IJRR 4(2), 1985.
    """
    factor = jac @ jac.T
    mujoco.mju_cholFactor(factor, 1e-20)
    return float(math.prod(factor.diagonal().tolist()))


class BoxedIk:
    """Damped least squares for joint velocities, with the robot's limits as a box.

    Minimises |J qd - v|^2 + damping^2 |qd - posture|^2 over low <= qd <= high: as the
    damping goes to 0, `posture` acts in the null space of J alone. The box holds what
    velocity and acceleration limits allow, and what leaves room to brake before a joint's
    end. Damping near singularities: Y. Nakamura and H. Hanafusa, "Inverse Kinematic Solutions
    With Singularity Robustness for Robot Manipulator Control", ASME JDSMC 108(3), 1986.

    Args:
        period: Time between two solutions [s].
        limit_share: Share of the limits that may be used [1].
    """

    def __init__(self, period: float, limit_share: float) -> None:
        self._period = period
        self._speed = limit_share * QD_MAX
        self._braking = 2.0 * limit_share * QDD_MAX
        self._speed_step = limit_share * QDD_MAX * period
        self._hessian = np.zeros((7, 7))
        self._diagonal = self._hessian.ravel()[::8]
        self._factor = np.zeros((7, 14))
        self._index = np.zeros(7, dtype=np.int32)
        self.low, self.high = np.zeros(7), np.zeros(7)

    def solve(  # noqa: PLR0913 - a problem has this many data
        self,
        jac: Matrix,
        twist: Vector,
        posture: Vector,
        damping: float,
        q: Vector,
        qd_previous: Vector,
        qd: Vector,
    ) -> None:
        """Solve for the joint velocities of this period.

        Args:
            jac: Hand Jacobian (6, 7).
            twist: Wanted hand velocity (6,) [m/s, rad/s], world frame.
            posture: Wanted velocity in the null space (7,) [rad/s].
            damping: Damping [1].
            q: Joint positions (7,) [rad].
            qd_previous: Solution of the period before (7,) [rad/s].
            qd: Receives the joint velocities (7,) [rad/s].
        """
        self._bound(q, qd_previous)
        weight = damping * damping
        np.matmul(jac.T, jac, out=self._hessian)
        self._diagonal += weight
        gradient = -(twist @ jac) - weight * posture
        qd[:] = qd_previous  # a warm start
        mujoco.mju_boxQP(
            qd, self._factor, self._index, self._hessian, gradient, self.low, self.high
        )

    def _bound(self, q: Vector, qd_previous: Vector) -> None:
        """Set the box of this period."""
        room = np.sqrt(self._braking * np.maximum(Q_MAX - q, 0.0))
        np.minimum(room, self._speed, out=self.high)
        room = np.sqrt(self._braking * np.maximum(q - Q_MIN, 0.0))
        np.maximum(-room, -self._speed, out=self.low)
        # What the acceleration allows comes last: it can always be kept.
        slowest, fastest = qd_previous - self._speed_step, qd_previous + self._speed_step
        np.clip(self.low, slowest, fastest, out=self.low)
        np.clip(self.high, slowest, fastest, out=self.high)
