"""Calls of an FMU's functions with arguments that are converted once.

They are called by `Step`, or read by `kernel`, which makes the same calls from C.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SimulationError
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
        sizes: NDArray[np.uintp] | None = None,  # of Binaries
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
            *([] if sizes is None else [pointer(sizes.ctypes.data)]),
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


class Rearranged:
    """An access through values of its own, where those of a block are of another order or type."""

    def __init__(
        self,
        call: Access,
        places: Sequence[int],  # of the values that belong to
        columns: Sequence[int],  # of the block
        block: NDArray[Any],
        *,
        reads: bool,
    ) -> None:
        self.call, self.block, self._reads = call, block, reads
        self.places, self.columns = np.array(places, np.intp), np.array(columns, np.intp)

    def __call__(self, row: int) -> None:
        """Exchange the values of a row of the block."""
        values = self.call.block[0]
        if self._reads:
            self.call(0)
            self.block[row, self.columns] = values[self.places]
        else:
            values[self.places] = self._in_type(self.block[row, self.columns])
            self.call(0)

    def _in_type(self, numbers: NDArray[Any]) -> Any:
        """Return numbers in the FMU's type; whole ones are rounded, and must be in its range."""
        dtype = self.call.block.dtype
        if not np.issubdtype(dtype, np.integer):
            return numbers.astype(dtype)
        try:
            return np.array([round(number) for number in numbers.tolist()], dtype)
        except OverflowError:
            what = f"{self.call.function.__name__}: one of {numbers.tolist()} is out of the range"
            raise SimulationError(f"{what} of {dtype}", instance=self.call.slave.name) from None


class Texts:
    """An access to Strings or Binaries, through pointers; rows hold them as str or bytes."""

    def __init__(  # noqa: PLR0913 - see `Rearranged`, and sizes
        self,
        call: Access,
        sizes: NDArray[np.uintp] | None,  # of Binaries
        places: Sequence[int],
        columns: Sequence[int],
        block: NDArray[Any],
        *,
        reads: bool,
    ) -> None:
        self._call, self._sizes, self._block, self._reads = call, sizes, block, reads
        self._places = list(zip(places, columns, strict=True))
        self._items: list[bytes] = [b""] * call.block.shape[1]

    def start_from(self, call: Access) -> None:
        """Read what is not in the block, and is set again and again, with a getter."""
        call(0)
        self._items = self._read(call)

    def __call__(self, row: int) -> None:
        """Exchange the values of a row of the block."""
        if self._reads:
            self._call(0)
            items = self._read(self._call)
            for place, column in self._places:
                item = items[place]
                text = item if self._sizes is not None else item.decode("utf-8", "replace")
                self._block[row, column] = text
            return
        for place, column in self._places:
            text = self._block[row, column]
            self._items[place] = text if isinstance(text, bytes) else str(text).encode()
        buffers = [ctypes.create_string_buffer(item) for item in self._items]
        self._call.block[0] = [ctypes.addressof(buffer) for buffer in buffers]
        if self._sizes is not None:
            self._sizes[:] = [len(item) for item in self._items]
        self._call(0)

    def _read(self, call: Access) -> list[bytes]:
        pointers: list[int] = call.block[0].tolist()
        sizes = [-1] * len(pointers) if self._sizes is None else self._sizes.tolist()
        return [
            ctypes.string_at(pointer, size) if pointer and size else b""
            for pointer, size in zip(pointers, sizes, strict=True)
        ]


class Several:
    """Accesses to variables of several types, one after the other."""

    def __init__(self, calls: Sequence[Callable[[int], None]]) -> None:
        self._calls = calls

    def __call__(self, row: int) -> None:
        """Exchange the values of a row."""
        for call in self._calls:
            call(row)


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
