"""The calls of FMI 3.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, Final

import numpy as np
from fmpy import fmi3
from fmpy.fmi3 import FMU3Slave
from numpy.typing import DTypeLike, NDArray

from ..errors import SimulationError
from ..interface.variables import Scalar, Value
from .fmu import Array, FmuSlave, check_block
from .message_log import receive

# Name of the getter and C type of its values, by type.
GETTERS: Final[dict[str, tuple[str, DTypeLike]]] = {
    "Float64": ("Float64", np.float64),
    "Float32": ("Float32", np.float32),
    "Enumeration": ("Int64", np.int64),
    "Boolean": ("Boolean", np.bool_),
    **{f"Int{bits}": (f"Int{bits}", f"i{bits // 8}") for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (f"UInt{bits}", f"u{bits // 8}") for bits in (8, 16, 32, 64)},
}


@cache
def _logger() -> Any:
    """Return the function that FMUs log through; it is kept, since an FMU may log while freed."""
    return fmi3.fmi3LogMessageCallback(_log)


def _log(number: int | None, status: int, _category: bytes, text: bytes) -> None:
    receive(number, b"", status, text)


class Fmi3Slave(FmuSlave):
    """An instance of an FMI 3.0 FMU: a value reference is a whole array."""

    def _load(self, **arguments: str) -> Any:
        return FMU3Slave(**arguments)

    def _instantiate(self, instance: Any) -> None:
        # FMPy's own `instantiate` sets no environment, which identifies the sender of a message.
        instance.component = instance.fmi3InstantiateCoSimulation(
            self.name.encode(),
            self.fmu.guid.encode(),
            f"{self.fmu.folder / 'resources'}/".encode(),
            False,  # visible
            True,  # logging
            False,  # event mode
            False,  # early return
            (fmi3.fmi3ValueReference * 0)(),
            0,
            self.log.number,
            _logger(),
            fmi3.fmi3IntermediateUpdateCallback(),
        )
        if not instance.component:
            raise RuntimeError("fmi3InstantiateCoSimulation returned NULL")

    def _make_step(self) -> Callable[[float, float], None]:
        event, ended, early = (ctypes.c_bool() for _ in range(3))
        reached = ctypes.c_double()
        answers = [ctypes.byref(answer) for answer in (event, ended, early, reached)]
        advance = self._bind_step(self._library.fmi3DoStep, ctypes.c_bool(True), *answers)

        def step(time: float, step_size: float) -> None:
            advance(time, step_size)
            if ended.value or early.value:
                what = "asks to end the simulation" if ended.value else "returned early"
                raise SimulationError(
                    f"the FMU {what}, at {reached.value:g} s", time=time, instance=self.name
                )

        return step

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        self._set_arrays(start_values)
        enter = self._instance.enterInitializationMode
        self._call("enter initialization", lambda: enter(startTime=start, stopTime=stop))

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave`; other elements of Real arrays keep their values."""
        real = {n: v for n, v in values.items() if self._kind(n) == "Float64"}
        if real:
            self.bind_set(list(real), np.array([[float(v) for v in real.values()]]))(0)
        self._set_arrays({n: v for n, v in values.items() if n not in real})

    def _kind(self, name: str) -> str:
        return self.fmu.variable(name).variable.fmi_type

    def _set_arrays(self, values: Mapping[str, Value]) -> None:
        """Set whole arrays; elements that are not named get their start values."""
        arrays: dict[str, list[Scalar]] = {}
        for name in values:
            variable = self.fmu.variable(name).variable
            arrays[variable.name] = [self.fmu.variables[each] for each in variable.names()]
        for name, elements in arrays.items():
            kind = (
                "Int64"
                if self._kind(elements[0].name) == "Enumeration"
                else (self._kind(elements[0].name))
            )
            content = [
                e.converted(values[e.name]) if e.name in values else e.start_value()
                for e in elements
            ]
            setter = getattr(self._instance, f"set{kind}")
            self._call(f"set {name}", partial(setter, [elements[0].value_reference], content), name)

    def _bind_get(self, kind: str, names: Sequence[str], block: Array) -> Callable[[int], None]:
        getter, dtype = GETTERS[kind]
        function = getattr(self._library, f"fmi3Get{getter}")
        references, where, size = self._elements(names)
        if kind == "Float64" and where == list(range(size)):
            return self._bind_all(function, references, block)
        values: NDArray[Any] = np.zeros((1, size), dtype)
        read = self._bind_all(function, references, values)

        def pick(row: int) -> None:
            read(0)
            block[row] = values[0, where]

        return pick

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave`.

        Elements of an array that are not named keep the values that they have now.
        """
        check_block(names, block)
        references, where, size = self._elements(names)
        if where == list(range(size)):
            return self._bind_all(self._library.fmi3SetFloat64, references, block)
        values = np.zeros((1, size))
        self._bind_all(self._library.fmi3GetFloat64, references, values)(0)
        write = self._bind_all(self._library.fmi3SetFloat64, references, values)

        def place(row: int) -> None:
            values[0, where] = block[row]
            write(0)

        return place

    def _bind_all(
        self, function: Any, references: Sequence[int], block: NDArray[Any]
    ) -> Callable[[int], None]:
        length = ctypes.c_size_t.from_param(block.shape[1])
        return self._bind_rows(function, references, block, length)

    def _elements(self, names: Sequence[str]) -> tuple[list[int], list[int], int]:
        """Find the arrays that hold scalars."""
        first: dict[str, int] = {}
        references, where, size = [], [], 0
        for name in names:
            scalar = self.fmu.variable(name)
            array = scalar.variable
            if array.name not in first:
                first[array.name] = size
                references.append(scalar.value_reference)
                size += array.size
            where.append(first[array.name] + scalar.element)
        return references, where, size
