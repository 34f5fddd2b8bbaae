"""MuJoCo's linear algebra on small arrays, each call bound to its operands once.

On six or seven numbers, most of a call's time goes into looking at its arguments. Here they are
looked at when a call is bound, and what is bound takes no arguments: a fifth of the time.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Call = Callable[[], None]
Measure = Callable[[], float]


@cache
def _library() -> ctypes.PyDLL:
    """The library of which MuJoCo's Python package is made, as that has loaded it.

    Its calls keep the interpreter's lock: they end sooner than it could be given away.
    """
    if sys.platform == "win32":
        return ctypes.PyDLL("mujoco.dll")
    # The symbols are also found through what links to them, wherever the library itself is.
    return ctypes.PyDLL(sys.modules[mujoco.mj_step.__module__].__file__)


@cache
def _prototype(result: Any) -> Any:
    """Type of the functions that return that."""
    return ctypes.PYFUNCTYPE(result)


def _bind(name: str, *operands: Array | int | float, result: Any = None) -> Callable[[], Any]:
    """Bind a function of MuJoCo's to its operands, which are kept as long as what is returned."""
    if result is not ctypes.c_double and not operands[0].flags.writeable:  # type: ignore[union-attr]
        raise ValueError("what receives a result must be writeable")
    function = _prototype(result)((name, _library()))
    call = partial(function, *map(_argument, operands))
    call.operands = operands  # type: ignore[attr-defined]
    return call


def _argument(operand: Array | int | float) -> Any:
    if isinstance(operand, float):
        return ctypes.c_double(operand)
    if isinstance(operand, int):
        return ctypes.c_int.from_param(operand)
    if operand.dtype != np.float64 or not operand.flags.c_contiguous:
        raise ValueError("an operand must be of float64, and contiguous")
    return ctypes.c_void_p.from_param(operand.ctypes.data)


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
    _fit(out.shape == source.shape, out, source)
    return _bind("mju_copy", out, source, out.size)


def subtract(out: Array, minuend: Array, subtrahend: Array) -> Call:
    """Bind out = minuend - subtrahend (n,)."""
    _fit(out.shape == minuend.shape == subtrahend.shape, out, minuend, subtrahend)
    return _bind("mju_sub", out, minuend, subtrahend, out.size)


def add_scaled(out: Array, vector: Array, factor: float) -> Call:
    """Bind out += factor vector (n,)."""
    _fit(out.shape == vector.shape, out, vector)
    return _bind("mju_addToScl", out, vector, float(factor), out.size)


def norm(vector: Array) -> Measure:
    """Bind the length of a vector (n,)."""
    return _bind("mju_norm", vector, vector.size, result=ctypes.c_double)


def normalize(vector: Array) -> Measure:
    """Bind the scaling of a vector (n,) to length 1; the call returns what it was."""
    return _bind("mju_normalize", vector, vector.size, result=ctypes.c_double)


def multiply(out: Array, matrix: Array, vector: Array) -> Call:
    """Bind out (m,) = matrix (m, n) vector (n,)."""
    _fit(matrix.shape == (out.size, vector.size), out, matrix, vector)
    return _bind("mju_mulMatVec", out, matrix, vector, *matrix.shape)


def multiply_transposed(out: Array, matrix: Array, vector: Array) -> Call:
    """Bind out (n,) = matrix^T vector, of a matrix (m, n) and a vector (m,)."""
    _fit(matrix.shape == (vector.size, out.size), out, matrix, vector)
    return _bind("mju_mulMatTVec", out, matrix, vector, *matrix.shape)


def square_of_rows(out: Array, matrix: Array) -> Call:
    """Bind out (m, m) = matrix matrix^T, of a matrix (m, n)."""
    rows, columns = matrix.shape
    _fit(out.shape == (rows, rows), out, matrix)
    return _bind("mju_mulMatMatT", out, matrix, matrix, rows, columns, rows)


def square_of_columns(out: Array, matrix: Array, weights: Array) -> Call:
    """Bind out (n, n) = matrix^T diag(weights) matrix, of a matrix (m, n) and weights (m,)."""
    rows, columns = matrix.shape
    _fit(out.shape == (columns, columns) and weights.shape == (rows,), out, matrix, weights)
    return _bind("mju_sqrMatTD", out, matrix, weights, rows, columns)


def factorize(matrix: Array, least: float) -> Callable[[], int]:
    """Bind the Cholesky factorization of a matrix (n, n), in place; the call returns its rank.

    Args:
        matrix: A symmetric matrix; its lower triangle becomes the factor.
        least: Below that, a square on the factor's diagonal is raised to it, and the rank falls.
    """
    rows = len(matrix)
    _fit(matrix.shape == (rows, rows), matrix)
    return _bind("mju_cholFactor", matrix, rows, float(least), result=ctypes.c_int)


def solve_factorized(out: Array, factor: Array, vector: Array) -> Call:
    """Bind out (n,) = A^-1 vector, of what `factorize` has made of A (n, n)."""
    _fit(factor.shape == (out.size, out.size) and vector.shape == out.shape, out, factor, vector)
    return _bind("mju_cholSolve", out, factor, vector, out.size)


def turn_between(out: Array, to: Array, from_: Array) -> Call:
    """Bind out (3,) = the turn from one orientation to another, in axes of the first [rad].

    Args:
        out: Receives the rotation vector, of length pi at most.
        to: Quaternion (w, x, y, z).
        from_: Quaternion (w, x, y, z).
    """
    _fit((out.size, to.size, from_.size) == (3, 4, 4), out, to, from_)
    return _bind("mju_subQuat", out, to, from_)


def rotate(out: Array, vector: Array, quat: Array) -> Call:
    """Bind out (3,) = a vector (3,) turned by a quaternion (w, x, y, z)."""
    _fit((out.size, vector.size, quat.size) == (3, 3, 4), out, vector, quat)
    return _bind("mju_rotVecQuat", out, vector, quat)
