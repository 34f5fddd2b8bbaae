"""The calls of FMI 3.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from fmpy import fmi3
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from ..errors import SimulationError
from .discrete import FMI3_GETTERS, bind_get_by_type
from .fmu import Array, FmuSlave, Value
from .message_log import receive


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

    def _bind_functions(self, library: Any) -> None:
        self._get_float, self._set_float = library.fmi3GetFloat64, library.fmi3SetFloat64
        event, ended, early = (ctypes.c_bool() for _ in range(3))
        reached = ctypes.c_double()
        answers = [ctypes.byref(answer) for answer in (event, ended, early, reached)]
        advance = self._bind_step(library.fmi3DoStep, ctypes.c_bool(True), *answers)

        def step(time: float, step_size: float) -> None:
            advance(time, step_size)
            if ended.value or early.value:
                what = "asks to end the simulation" if ended.value else "returned early"
                raise SimulationError(
                    f"the FMU {what}, at {reached.value:g} s", time=time, instance=self.name
                )

        self.step = step

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        self._set_arrays(start_values)
        enter = self._instance.enterInitializationMode
        self._call("enter initialization", lambda: enter(startTime=start, stopTime=stop))

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave`; other elements of Real arrays keep their values."""
        real = {n: v for n, v in values.items() if self.fmu.variable(n).type == "Real"}
        if real:
            self.bind_set(list(real), np.array([[float(v) for v in real.values()]]))(0)
        self._set_arrays({n: v for n, v in values.items() if n not in real})

    def _set_arrays(self, values: Mapping[str, Value]) -> None:
        for name, elements in self._whole_arrays(values).items():
            first = self.fmu.array(name)[0]
            kind = "Int64" if first.type == "Enumeration" else first.fmi_type
            setter = getattr(self._instance, f"set{kind}")
            self._call(f"set {name}", partial(setter, [first.reference], elements), name)

    def _whole_arrays(self, values: Mapping[str, Value]) -> dict[str, list[Value]]:
        """Fill up arrays of which only some elements are given, with their start values."""
        arrays: dict[str, list[Value]] = {}
        for name, value in values.items():
            variable = self.fmu.variable(name)
            if variable.array not in arrays:
                members = self.fmu.array(variable.array)
                arrays[variable.array] = [member.start_value() for member in members]
            arrays[variable.array][variable.element] = variable.converted(value)
        return arrays

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row, see `FmuSlave`."""
        if not self._are_real(names):
            return bind_get_by_type(self, names, block)
        references, where, size = self._arrays_of(names, block)
        if where == list(range(size)):
            return self._bind_all(self._get_float, references, block)
        values = np.zeros((1, size))
        read = self._bind_all(self._get_float, references, values)

        def pick(row: int) -> None:
            read(0)
            block[row] = values[0, where]

        return pick

    def bind_get_discrete(self, kind: str, names: Sequence[str]) -> Callable[[], NDArray[Any]]:
        """Make a function that reads variables that are not Real, see `FmuSlave`."""
        getter, dtype = FMI3_GETTERS[kind]
        references, where, size = self._elements(names)
        values = np.zeros((1, size), dtype)
        function = getattr(self._library(), f"fmi3Get{getter}")
        read = self._bind_all(function, references, values)

        def values_now() -> NDArray[Any]:
            read(0)
            return values[0, where]

        return values_now

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave`.

        Elements of an array that are not named keep the values that they have now.
        """
        references, where, size = self._arrays_of(names, block)
        if where == list(range(size)):
            return self._bind_all(self._set_float, references, block)
        values = np.zeros((1, size))
        self._bind_all(self._get_float, references, values)(0)
        write = self._bind_all(self._set_float, references, values)

        def place(row: int) -> None:
            values[0, where] = block[row]
            write(0)

        return place

    def _bind_all(
        self, function: Any, references: Sequence[int], block: NDArray[Any]
    ) -> Callable[[int], None]:
        length = ctypes.c_size_t.from_param(block.shape[1])
        return self._bind_rows(function, references, block, length)

    def _arrays_of(self, names: Sequence[str], block: Array) -> tuple[list[int], list[int], int]:
        """Find the arrays that hold Real scalars, see `_elements`."""
        self._real(names)
        if block.shape[1:] != (len(names),):
            raise ValueError(f"block of shape {block.shape} for {len(names)} variables")
        return self._elements(names)

    def _elements(self, names: Sequence[str]) -> tuple[list[int], list[int], int]:
        """Find the arrays that hold scalars.

        Returns:
            Value references of the arrays, each once; where in their joined elements each scalar
            is; and how many elements they have.
        """
        first: dict[str, int] = {}
        references, where, size = [], [], 0
        for name in names:
            variable = self.fmu.variables[name]
            if variable.array not in first:
                first[variable.array] = size
                references.append(variable.reference)
                size += len(self.fmu.array(variable.array))
            where.append(first[variable.array] + variable.element)
        return references, where, size
