"""The calls of FMI 2.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from fmpy import calloc, fmi2, free
from fmpy.fmi2 import FMU2Slave
from fmpy.logging import addLoggerProxy
from numpy.typing import NDArray

from .discrete import FMI2_GETTERS, bind_get_by_type
from .fmu import Array, FmuSlave, Value
from .message_log import receive


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

    def _bind_functions(self, library: Any) -> None:
        self._get_real, self._set_real = library.fmi2GetReal, library.fmi2SetReal
        self.step = self._bind_step(library.fmi2DoStep, ctypes.c_int.from_param(1))

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        instance = self._instance
        self._call("set up", lambda: instance.setupExperiment(startTime=start, stopTime=stop))
        self.set_values(start_values)
        self._call("enter initialization", instance.enterInitializationMode)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave`."""
        for name, value in values.items():
            variable = self.fmu.variable(name)
            kind = "Integer" if variable.type == "Enumeration" else variable.type
            setter = getattr(self._instance, f"set{kind}")
            arguments = [variable.reference], [variable.converted(value)]
            self._call(f"set {name}", partial(setter, *arguments), name)

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row, see `FmuSlave`."""
        if not self._are_real(names):
            return bind_get_by_type(self, names, block)
        return self._bind(self._get_real, names, block)

    def bind_get_discrete(self, kind: str, names: Sequence[str]) -> Callable[[], NDArray[Any]]:
        """Make a function that reads variables that are not Real, see `FmuSlave`."""
        getter, dtype = FMI2_GETTERS[kind]
        values = np.zeros((1, len(names)), dtype)
        references = [self.fmu.variables[name].reference for name in names]
        read = self._bind_rows(getattr(self._library(), f"fmi2Get{getter}"), references, values)

        def values_now() -> NDArray[Any]:
            read(0)
            now: NDArray[Any] = values[0]
            return now

        return values_now

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave`."""
        return self._bind(self._set_real, names, block)

    def _bind(self, function: Any, names: Sequence[str], block: Array) -> Callable[[int], None]:
        self._real(names)
        if block.shape[1:] != (len(names),):
            raise ValueError(f"block of shape {block.shape} for {len(names)} variables")
        references = [self.fmu.variables[name].reference for name in names]
        return self._bind_rows(function, references, block)
