"""The calls of FMI 2.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, Final

import numpy as np
from fmpy import calloc, fmi2, free
from fmpy.fmi2 import FMU2Slave
from fmpy.logging import addLoggerProxy
from numpy.typing import DTypeLike

from ..interface.variables import Value
from .fmu import Array, FmuSlave, check_block
from .message_log import receive

# Name in FMI's functions and C type of values, by type. FMI 2.0's Boolean is an int.
C_TYPES: Final[dict[str, tuple[str, DTypeLike]]] = {
    "Real": ("Real", np.float64),
    "Integer": ("Integer", np.int32),
    "Enumeration": ("Integer", np.int32),
    "Boolean": ("Boolean", np.int32),
    "String": ("String", np.void),
}


@cache
def _logger() -> Any:
    """The callback through which FMUs log; it is never freed.

    FMPy's proxy, which formats the messages, keeps only the last logger that it was given, and
    calls it for all instances, also when the one that gave it has gone.
    """
    return fmi2.fmi2CallbackLoggerTYPE(_log)


def _log(number: int, name: bytes, status: int, _category: bytes, text: bytes) -> None:
    receive(number, name, status, text)


class Fmi2Slave(FmuSlave):
    """An instance of an FMI 2.0 FMU: a value reference is one scalar."""

    def _load(self, **arguments: str) -> Any:
        return FMU2Slave(**arguments)

    def _instantiate(self, instance: Any) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger()
        callbacks.componentEnvironment = self.log.number
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(ctypes.byref(callbacks))
        self._keep.append(callbacks)
        instance.instantiate(callbacks=callbacks, loggingOn=True)

    def _make_step(self) -> Callable[[float, float], None]:
        return self._bind_step(self._library.fmi2DoStep, ctypes.c_int.from_param(1))

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        instance = self._instance
        self._call("set up", lambda: instance.setupExperiment(startTime=start, stopTime=stop))
        self.set_values(start_values)
        self._call("enter initialization", instance.enterInitializationMode)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave`."""
        for name, value in values.items():
            scalar = self.fmu.variable(name)
            setter = getattr(self._instance, f"set{C_TYPES[scalar.variable.fmi_type][0]}")
            arguments = [scalar.value_reference], [scalar.converted(value)]
            self._call(f"set {name}", partial(setter, *arguments), name)

    def _bind_get(self, kind: str, names: Sequence[str], block: Array) -> Callable[[int], None]:
        getter, dtype = C_TYPES[kind]
        function = getattr(self._library, f"fmi2Get{getter}")
        if kind == "Real":
            return self._bind_rows(function, self._references(names), block)
        values = np.zeros((1, len(names)), dtype)
        read = self._bind_rows(function, self._references(names), values)

        def convert(row: int) -> None:
            read(0)
            block[row] = values[0]

        return convert

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave`."""
        check_block(names, block)
        return self._bind_rows(self._library.fmi2SetReal, self._references(names), block)

    def _references(self, names: Sequence[str]) -> list[int]:
        return [self.fmu.variable(name).value_reference for name in names]
