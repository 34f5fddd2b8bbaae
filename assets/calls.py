"""Functions of MuJoCo's library, bound to their operands once.

Where a function takes less than a microsecond, most of a call from Python goes into looking at its
arguments. Here they are looked at when a call is bound, and what is bound takes no arguments: a
fifth of the time. For functions only that cannot fail, as an error of the library's would end the
process. Plant and controller, which know nothing of each other, both call MuJoCo so.
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


def bind(name: str, *operands: Any, result: Any = None) -> Callable[[], Any]:
    """Bind a function of MuJoCo's to its operands, which are kept as long as what is returned.

    Args:
        name: The function's name.
        operands: For each of its arguments an array, a whole number, a float, or MuJoCo's model
            or data.
        result: Type of what it returns, of ctypes; None: nothing.

    Raises:
        ValueError: An array is not of float64, or not contiguous.
    """
    function = _prototype(result)((name, _library()))
    call = partial(function, *map(_argument, operands))
    call.operands = operands  # type: ignore[attr-defined]
    return call


def _argument(operand: Any) -> Any:
    if isinstance(operand, float):
        return ctypes.c_double.from_param(operand)
    if isinstance(operand, int):
        return ctypes.c_int.from_param(operand)
    if isinstance(operand, mujoco.MjModel | mujoco.MjData):
        return ctypes.c_void_p.from_param(operand._address)
    return ctypes.c_void_p.from_param(address(operand))


def address(values: Array) -> int:
    """Where the numbers of an array are.

    Raises:
        ValueError: They are not of float64, or not contiguous.
    """
    if values.dtype != np.float64 or not values.flags.c_contiguous:
        raise ValueError("an operand must be of float64, and contiguous")
    return values.ctypes.data
