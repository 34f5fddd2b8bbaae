"""Matrix products and Cholesky factors, by MuJoCo's functions.

numpy's `@` sums in an order that depends on the machine. MuJoCo's functions sum in a fixed order,
and the law in C calls the same functions, so that both laws give the same bits.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..assets.fields import Matrix, Vector

# Smaller pivots are raised to this, so that the factor of a singular matrix stays finite.
MIN_PIVOT = 1e-20

MEAN_RATIO = 1000.0  # [1/s^2] a usual stiffness by a usual inertia
MEAN_STEPS = 8  # enough for ratios from 1 to 1e6


def mat_vec(matrix: Matrix, vector: Vector) -> Vector:
    """Return matrix (m, n) times vector (n,)."""
    product = np.empty(matrix.shape[0])
    mujoco.mju_mulMatVec(product, matrix, vector)
    return product


def mat_t_vec(matrix: Matrix, vector: Vector) -> Vector:
    """Return matrix^T times vector, of a matrix (m, n) and a vector (m,)."""
    product = np.empty(matrix.shape[1])
    mujoco.mju_mulMatTVec(product, matrix, vector)
    return product


def mat_mat_t(one: Matrix, other: Matrix) -> Matrix:
    """Return one (m, n) times other^T, of another matrix (k, n)."""
    product = np.empty((one.shape[0], other.shape[0]))
    mujoco.mju_mulMatMatT(product, one, other)
    return product


def inverse(matrix: Matrix) -> Matrix:
    """Return the inverse of a symmetric positive definite matrix (m, m)."""
    factor = matrix.copy()
    mujoco.mju_cholFactor(factor, MIN_PIVOT)
    return np.array([cholesky_solve(factor, column) for column in np.eye(len(matrix))])


def geometric_mean(matrix: Matrix, diagonal: Vector) -> Matrix:
    """Return A # K = A^1/2 (A^-1/2 K A^-1/2)^1/2 A^1/2 of a matrix A (m, m) and K = diag(diagonal).

    A is symmetric positive definite. The iteration of Denman and Beavers converges quadratically
    once the eigenvalues of A^-1 K / MEAN_RATIO are near 1.
    """
    mean, other = np.diag(diagonal), inverse(matrix) / MEAN_RATIO  # which becomes mean^-1
    for _ in range(MEAN_STEPS):
        mean, other = 0.5 * (mean + inverse(other)), 0.5 * (other + inverse(mean))
    return mean / math.sqrt(MEAN_RATIO)


def damped_factor(jac: Matrix, damping: float) -> Matrix:
    """Return the Cholesky factor (m, m) of J J^T + damping^2, for a Jacobian (m, n)."""
    rows = jac.shape[0]
    factor = np.empty((rows, rows))
    mujoco.mju_mulMatMatT(factor, jac, jac)
    if damping != 0.0:
        factor.reshape(-1)[:: rows + 1] += damping * damping
    mujoco.mju_cholFactor(factor, MIN_PIVOT)
    return factor


def cholesky_solve(factor: Matrix, vector: Vector) -> Vector:
    """Return A^-1 vector (m,), given the Cholesky factor (m, m) of A."""
    solution = np.empty(vector.size)
    mujoco.mju_cholSolve(solution, factor, vector)
    return solution
