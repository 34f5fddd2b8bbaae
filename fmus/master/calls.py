"""Calls of an FMU's functions with arguments that are converted once.

They are called by `Step`, or read by `kernel`, which makes the same calls from C.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SimulationError
from ..interface.types import type_of
from ..interface.variables import INTEGERS, Scalar
from .message_log import WARNING

if TYPE_CHECKING:
    from .fmu import FmuSlave


class Access:
    """A getter or setter of FMI, for the variables of some references.

    Calling it with the index of a row reads them into that row of a block (n, values), or writes
    them from there. A row's values are contiguous and have the C type of the function; `more` are
    arguments after them.
    """

    def __init__(
        self,
        slave: FmuSlave,
        function: Any,
        references: Sequence[int],
        block: NDArray[Any],
        *more: object,
    ) -> None:
        self.slave, self.function, self.block = slave, function, block
        self.references = np.array(references, np.uint32)
        pointer = ctypes.c_void_p.from_param
        first, stride = block.ctypes.data, block.strides[0]
        self._rows = [pointer(first + i * stride) for i in range(len(block))]
        self._before = (
            pointer(slave.component),
            pointer(self.references.ctypes.data),
            ctypes.c_size_t.from_param(len(self.references)),
        )
        self._more = more

    def __call__(self, row: int) -> None:
        """Call the function with a row of the block."""
        try:
            status = self.function(*self._before, self._rows[row], *self._more)
        except Exception as error:  # raised by Python code of the FMU
            self.slave.fail_badly(self.function.__name__, error)
        if status > WARNING:
            self.fail(status)

    def fail(self, status: int, time: float | None = None) -> None:
        """Raise the error of a status."""
        self.slave.fail(self.function.__name__, status, time)


class Typed:
    """An access to variables of one type that is not Real, through FMPy's functions of lists."""

    def __init__(  # noqa: PLR0913 - both sides of the exchange
        self,
        slave: FmuSlave,
        scalars: Sequence[Scalar],
        places: Sequence[int],  # of the values that belong to
        columns: Sequence[int],  # of the block
        block: NDArray[Any],
        *,
        reads: bool,
    ) -> None:
        self._slave, self._block, self._reads = slave, block, reads
        self._arrays = list({scalar.variable.name: scalar for scalar in scalars}.values())
        self._ends = list(zip(scalars, places, columns, strict=True))
        self._values: list[Any] = [None] * sum(each.variable.size for each in self._arrays)
        if not reads and len(scalars) < len(self._values):  # the others are set again and again
            self._values = slave.get_values(self._arrays)

    def __call__(self, row: int) -> None:
        """Exchange the values of a row of the block."""
        if self._reads:
            values = self._slave.get_values(self._arrays)
            for _, place, column in self._ends:
                self._block[row, column] = values[place]
            return
        for scalar, place, column in self._ends:
            self._values[place] = self._in_type(scalar, self._block[row, column])
        self._slave.set_lists(self._arrays, self._values)

    def _in_type(self, scalar: Scalar, value: Any) -> Any:
        """Return a value in the FMU's type; a whole number is rounded, and must be in its range."""
        kind = type_of(scalar.variable)
        if kind in ("String", "Binary"):
            return value
        if kind in ("Boolean", "Float32"):
            return value != 0 if kind == "Boolean" else float(value)
        bits, signed = INTEGERS.get(kind, INTEGERS["Int32"])  # of an enumeration
        number = round(value) if abs(value) < 2**64 else 2**64
        if not -(2 ** (bits - 1)) * signed <= number < 2 ** (bits - signed):
            raise SimulationError(
                f"value {value} is out of the range of {kind}",
                instance=self._slave.name,
                variable=scalar.name,
            )
        return number


class StepCall:
    """`doStep` of an FMU, by a time and a step size [s]; `more` are arguments after these."""

    def __init__(self, slave: FmuSlave, function: Any, *more: object) -> None:
        self.slave, self.function, self._more = slave, function, more
        self._component = ctypes.c_void_p.from_param(slave.component)
        self._start, self._size = ctypes.c_double(), math.nan

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step."""
        if step_size != self._size:
            self._size, self._length = step_size, ctypes.c_double.from_param(step_size)
        self._start.value = time
        try:
            status = self.function(self._component, self._start, self._length, *self._more)
        except Exception as error:  # see `Access`
            self.slave.fail_badly(self.function.__name__, error, time)
        if status > WARNING:
            self.fail(status, time)

    def fail(self, status: int, time: float) -> None:
        """Raise the error of a status."""
        self.slave.fail(self.function.__name__, status, time)

    def refuse_early(self, time: float, reached: float, *, ended: bool) -> None:
        """Raise the error of a step that was not taken to its end (FMI 3.0)."""
        what = "asks to end the simulation" if ended else "returned early"
        raise SimulationError(
            f"the FMU {what}, at {reached:g} s", time=time, instance=self.slave.name
        )
