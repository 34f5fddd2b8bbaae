"""MuJoCo's linear algebra on small arrays, each call bound to its operands once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..assets.calls import address, bind

Array = NDArray[np.float64]
Call = Callable[[], None]
Measure = Callable[[], float]


def _writeable(out: Array) -> Array:
    if not out.flags.writeable:
        raise ValueError("what receives a result must be writeable")
    return out


def _fit(fits: bool, *operands: Array) -> None:
    if not fits:
        raise ValueError(f"shapes do not fit: {', '.join(str(o.shape) for o in operands)}")


def chain(*calls: Callable[[], object]) -> Call:
    """Bind several calls to be made one after the other."""

    def make_all() -> None:
        for call in calls:
            call()

    return make_all


def copy(out: Array, source: Array) -> Call:
    """Bind out = source (n,)."""
    _fit(out.shape == source.shape and out.ndim == 1, out, source)
    for operand in (_writeable(out), source):
        address(operand)
    # Python copies memory in half the time that a call of MuJoCo's takes.
    return partial(out.data.__setitem__, slice(None), source.data)


def subtract(out: Array, minuend: Array, subtrahend: Array) -> Call:
    """Bind out = minuend - subtrahend (n,)."""
    _fit(out.shape == minuend.shape == subtrahend.shape, out, minuend, subtrahend)
    return bind("mju_sub", _writeable(out), minuend, subtrahend, out.size)


def norm(vector: Array) -> Measure:
    """Bind the length of a vector (n,)."""
    return bind("mju_norm", vector, vector.size, result=ctypes.c_double)


def normalize(vector: Array) -> Measure:
    """Bind the scaling of a vector (n,) to length 1; the call returns what it was."""
    return bind("mju_normalize", _writeable(vector), vector.size, result=ctypes.c_double)


def multiply(out: Array, matrix: Array, vector: Array) -> Call:
    """Bind out (m,) = matrix (m, n) vector (n,)."""
    _fit(matrix.shape == (out.size, vector.size), out, matrix, vector)
    return bind("mju_mulMatVec", _writeable(out), matrix, vector, *matrix.shape)


def multiply_transposed(out: Array, matrix: Array, vector: Array) -> Call:
    """Bind out (n,) = matrix^T vector, of a matrix (m, n) and a vector (m,)."""
    _fit(matrix.shape == (vector.size, out.size), out, matrix, vector)
    return bind("mju_mulMatTVec", _writeable(out), matrix, vector, *matrix.shape)


def square_of_rows(out: Array, matrix: Array) -> Call:
    """Bind out (m, m) = matrix matrix^T, of a matrix (m, n)."""
    rows, columns = matrix.shape
    _fit(out.shape == (rows, rows), out, matrix)
    return bind("mju_mulMatMatT", _writeable(out), matrix, matrix, rows, columns, rows)


def factorize(matrix: Array, least: float) -> Callable[[], int]:
    """Bind the Cholesky factorization of a matrix (n, n), in place; the call returns its rank.

    Args:
        matrix: A symmetric matrix; its lower triangle becomes the factor.
        least: Below that, a square on the factor's diagonal is raised to it, and the rank falls.
    """
    rows = len(matrix)
    _fit(matrix.shape == (rows, rows), matrix)
    return bind("mju_cholFactor", _writeable(matrix), rows, float(least), result=ctypes.c_int)


def solve_factorized(out: Array, factor: Array, vector: Array) -> Call:
    """Bind out (n,) = A^-1 vector, of what `factorize` has made of A (n, n)."""
    _fit(factor.shape == (out.size, out.size) and vector.shape == out.shape, out, factor, vector)
    return bind("mju_cholSolve", _writeable(out), factor, vector, out.size)


def turn_between(out: Array, to: Array, from_: Array) -> Call:
    """Bind out (3,) = the turn from one orientation to another, in axes of the first [rad].

    Args:
        out: Receives the rotation vector, of length pi at most.
        to: Quaternion (w, x, y, z).
        from_: Quaternion (w, x, y, z).
    """
    _fit((out.size, to.size, from_.size) == (3, 4, 4), out, to, from_)
    return bind("mju_subQuat", _writeable(out), to, from_)


def rotate(out: Array, vector: Array, quat: Array) -> Call:
    """Bind out (3,) = a vector (3,) turned by a quaternion (w, x, y, z)."""
    _fit((out.size, vector.size, quat.size) == (3, 3, 4), out, vector, quat)
    return bind("mju_rotVecQuat", _writeable(out), vector, quat)
