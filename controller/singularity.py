"""How near the arm is to a singularity, and the damping there."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..assets.fields import Matrix, Vector
from .gains import Gains
from .linalg import damped_factor

# Where inverse iteration starts. A coordinate axis could be orthogonal to the weak direction.
START_DIRECTION = np.arange(1.0, 7.0)
START_ITERATIONS = 50


def manipulability(factor: Matrix) -> float:
    """Yoshikawa's manipulability sqrt(det(J J^T)), from the Cholesky factor (6, 6) of J J^T.

    Source: T. Yoshikawa, "Manipulability of Robotic Mechanisms", IJRR 4(2), 1985.
    """
    return float(math.prod(factor.diagonal().tolist()))


def smallest_singular_value(factor: Matrix, weak_direction: Vector) -> float:
    """Smallest singular value of the Jacobian, by one step of inverse iteration.

    The Jacobian changes slowly, so one step per update is enough once the direction has settled:
    the unit twist (6,) that the joints reach least, which is changed in place. `factor` is the
    Cholesky factor (6, 6) of J J^T. The value is 0 where it cannot be computed.
    """
    mujoco.mju_cholSolve(weak_direction, factor, weak_direction)
    inverse_square = mujoco.mju_normalize(weak_direction)
    if 0.0 < inverse_square < math.inf:
        return 1.0 / math.sqrt(inverse_square)
    weak_direction[:] = START_DIRECTION
    return 0.0


def find_weak_direction(jac: Matrix) -> Vector:
    """Return the weak direction (6,) of a Jacobian (6, 7), without a guess to start from."""
    direction, factor = START_DIRECTION.copy(), damped_factor(jac, 0.0)
    for _ in range(START_ITERATIONS):
        smallest_singular_value(factor, direction)
    return direction


def singular_damping(smallest: float, gains: Gains) -> float:
    """Damping of the least squares, which grows from 0 as the arm nears a singularity.

    Its square grows as 1 - (s / s0)^2, with s the smallest singular value of the Jacobian and s0
    where it begins, the gain `singular_value`; at s = 0 it is the gain `singular_damping`.
    Source: S. Chiaverini, B. Siciliano, O. Egeland, "Review of the Damped Least-Squares Inverse
    Kinematics with Experiments on an Industrial Robot Manipulator", IEEE Transactions on Control
    Systems Technology 2(2), 1994.
    """
    if smallest >= gains.singular_value:
        return 0.0
    ratio = smallest / gains.singular_value
    return gains.singular_damping * math.sqrt(1.0 - ratio * ratio)
