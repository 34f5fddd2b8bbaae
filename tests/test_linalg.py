"""MuJoCo's linear algebra behind bound calls: the same bits as numpy's package of it gives."""

import gc
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from panda_cosim.controller import linalg

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)


def same(bound: Any, plain: Any) -> bool:
    return bool(np.array_equal(bound, plain))


@given(seed=seeds)
def test_products_are_those_of_the_package(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 14, 2)
    matrix = rng.normal(size=(rows, columns))
    for bind, plain, size, operand in (
        (linalg.multiply, mujoco.mju_mulMatVec, rows, rng.normal(size=columns)),
        (linalg.multiply_transposed, mujoco.mju_mulMatTVec, columns, rng.normal(size=rows)),
    ):
        out, expected = np.zeros(size), np.zeros(size)
        bind(out, matrix, operand)()
        plain(expected, matrix, operand)
        assert same(out, expected)
        assert np.allclose(out, (matrix if size == rows else matrix.T) @ operand) or rows == columns
    out, expected = np.zeros((rows, rows)), np.zeros((rows, rows))
    linalg.square_of_rows(out, matrix)()
    mujoco.mju_mulMatMatT(expected, matrix, matrix)
    assert same(out, expected)
    assert np.allclose(out, matrix @ matrix.T)


@given(seed=seeds, size=st.integers(1, 8))
def test_a_factorized_system_is_solved(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    half, vector, out = rng.normal(size=(size, size)), rng.normal(size=size), np.zeros(size)
    matrix = half @ half.T + np.eye(size)
    factor = matrix.copy()
    assert linalg.factorize(factor, 1e-15)() == size
    linalg.solve_factorized(out, factor, vector)()
    assert np.allclose(matrix @ out, vector)
    assert linalg.factorize(np.zeros((size, size)), 1e-15)() < size


@given(seed=seeds, size=st.integers(1, 20))
def test_sums_and_lengths(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, out = rng.normal(size=size), rng.normal(size=size), np.zeros(size)
    linalg.subtract(out, a, b)()
    assert same(out, a - b)
    linalg.copy(out, a)()
    assert same(out, a)
    length = linalg.norm(a)()
    assert length == pytest.approx(np.linalg.norm(a))
    assert linalg.normalize(a)() == length
    assert np.linalg.norm(a) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "bind",
    [linalg.copy, lambda out, source: linalg.subtract(out, source, np.zeros(1000))],
    ids=["copy", "subtract"],
)
def test_the_operands_live_as_long_as_the_call(bind: Callable[[Array, Array], linalg.Call]) -> None:
    out = np.zeros(1000)
    call = bind(out, np.arange(1000.0))
    gc.collect()
    taken = [np.full(1000, np.nan) for _ in range(10)]  # what would use their memory again
    call()
    assert same(out, np.arange(1000.0))
    assert len(taken) == 10


@pytest.mark.parametrize(
    "operand", [np.zeros(7, np.float32), np.zeros(14)[::2], np.zeros((7, 2))[:, 0]]
)
def test_what_is_not_a_plain_array_is_refused(operand: Any) -> None:
    with pytest.raises(ValueError, match="float64, and contiguous"):
        linalg.norm(operand)


def test_what_cannot_be_written_is_not() -> None:
    constant = np.frombuffer(bytes(24))
    with pytest.raises(ValueError, match="must be writeable"):
        linalg.copy(constant, np.ones(3))
    assert linalg.norm(constant)() == 0.0


def test_shapes_that_do_not_fit_are_refused() -> None:
    six, seven = np.zeros(6), np.zeros(7)
    for bind in (
        lambda: linalg.copy(six, seven),
        lambda: linalg.subtract(six, six, seven),
        lambda: linalg.multiply(six, np.zeros((7, 6)), seven),
        lambda: linalg.multiply_transposed(six, np.zeros((6, 7)), seven),
        lambda: linalg.square_of_rows(np.zeros((7, 7)), np.zeros((6, 7))),
        lambda: linalg.factorize(np.zeros((6, 7)), 0.0),
        lambda: linalg.solve_factorized(six, np.zeros((6, 6)), seven),
        lambda: linalg.turn_between(np.zeros(3), seven, np.zeros(4)),
        lambda: linalg.rotate(np.zeros(3), np.zeros(3), np.zeros(3)),
    ):
        with pytest.raises(ValueError, match="shapes do not fit"):
            bind()
