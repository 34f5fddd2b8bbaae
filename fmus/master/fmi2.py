"""The calls of FMI 2.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any

from fmpy import calloc, fmi2, free
from fmpy.fmi2 import FMU2Slave
from fmpy.logging import addLoggerProxy

from ..interface.variables import Value
from .calls import StepCall
from .fmu import FmuSlave
from .message_log import receive


@cache
def _logger() -> Any:
    """The callback through which FMUs log; it is never freed.

    FMPy's proxy, which formats the messages, keeps only the last logger that it was given, and
    calls it for all instances, also when the one that gave it has gone.
    """
    return fmi2.fmi2CallbackLoggerTYPE(
        lambda number, name, status, _category, text: receive(number, name, status, text)
    )


class Fmi2Slave(FmuSlave):
    """An instance of an FMI 2.0 FMU: a value reference is one scalar."""

    fmpy_class, prefix, state_name, enumeration = FMU2Slave, "fmi2", "FMUstate", "Integer"

    def _instantiate(self, instance: Any) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger()
        callbacks.componentEnvironment = self.log.number
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(ctypes.byref(callbacks))
        self._keep.append(callbacks)
        instance.instantiate(callbacks=callbacks, loggingOn=True)

    def _make_step(self) -> StepCall:
        return StepCall(self, self.function("DoStep"), self.no_going_back)

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        instance = self._instance
        self._call("set up", lambda: instance.setupExperiment(startTime=start, stopTime=stop))
        self._set_arrays(start_values)
        self._call("enter initialization", instance.enterInitializationMode)
