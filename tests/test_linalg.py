"""MuJoCo's linear algebra as the law uses it: the same as numpy's, but for rounding."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from panda_cosim.controller.linalg import cholesky_solve, damped_factor, mat_t_vec, mat_vec

seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds)
def test_products_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 14, 2)
    matrix, wide, tall = (
        rng.normal(size=(rows, columns)),
        rng.normal(size=columns),
        rng.normal(size=rows),
    )
    assert np.allclose(mat_vec(matrix, wide), matrix @ wide)
    assert np.allclose(mat_t_vec(matrix, tall), matrix.T @ tall)


@given(seed=seeds, rows=st.integers(1, 6), damping=st.floats(0.1, 10.0))
def test_a_damped_system_is_solved(seed: int, rows: int, damping: float) -> None:
    rng = np.random.default_rng(seed)
    jac, vector = rng.normal(size=(rows, 7)), rng.normal(size=rows)
    solution = cholesky_solve(damped_factor(jac, damping), vector)
    assert np.allclose((jac @ jac.T + damping**2 * np.eye(rows)) @ solution, vector)


def test_the_factor_of_nothing_is_finite() -> None:
    assert np.isfinite(cholesky_solve(damped_factor(np.zeros((6, 7)), 0.0), np.ones(6))).all()
