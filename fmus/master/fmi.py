"""The calls of FMI 2.0 and 3.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any

from fmpy import calloc, fmi2, fmi3, free
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.logging import addLoggerProxy

from ..interface.variables import Value
from .calls import StepCall, receive
from .fmu import FmuSlave


@cache
def _logger2() -> Any:
    """The callback through which FMUs log; it is never freed."""
    # FMPy's proxy, which formats the messages, keeps only the last logger that it was given, and
    # calls it for all instances, also when the one that gave it has gone.
    return fmi2.fmi2CallbackLoggerTYPE(
        lambda number, name, status, _category, text: receive(number, name, status, text)
    )


class Fmi2Slave(FmuSlave):
    """An instance of an FMI 2.0 FMU: a value reference is one scalar."""

    fmpy_class, prefix, state_name, enumeration = FMU2Slave, "fmi2", "FMUstate", "Integer"

    def _instantiate(self, instance: Any) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger2()
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


@cache
def _logger3() -> Any:
    """Return the function that FMUs log through; it is kept, since an FMU may log while freed."""
    return fmi3.fmi3LogMessageCallback(
        lambda number, status, _category, text: receive(number, b"", status, text)
    )


class Fmi3Slave(FmuSlave):
    """An instance of an FMI 3.0 FMU: a value reference is a whole array."""

    fmpy_class, prefix, state_name, enumeration = FMU3Slave, "fmi3", "FMUState", "Int64"

    def _instantiate(self, instance: Any) -> None:
        # FMPy's own `instantiate` sets no environment, which identifies the sender of a message.
        instance.component = instance.fmi3InstantiateCoSimulation(
            self.name.encode(),
            self.fmu.guid.encode(),
            f"{self.fmu.folder / 'resources'}/".encode(),
            False,  # visible
            True,  # logging
            False,  # event mode
            bool(self.fmu.description.coSimulation.mightReturnEarlyFromDoStep),  # early return
            (fmi3.fmi3ValueReference * 0)(),
            0,
            self.log.number,
            _logger3(),
            fmi3.fmi3IntermediateUpdateCallback(),
        )
        if not instance.component:
            raise RuntimeError("fmi3InstantiateCoSimulation returned NULL")

    def _make_step(self) -> StepCall:
        return _Fmi3Step(self)

    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        structural = {n: v for n, v in start_values.items() if n in self.fmu.structural}
        if structural:
            self._call("enter configuration", self._instance.enterConfigurationMode)
            self._set_arrays(structural)
            self._call("exit configuration", self._instance.exitConfigurationMode)
        self._set_arrays({n: v for n, v in start_values.items() if n not in structural})
        enter = self._instance.enterInitializationMode
        self._call("enter initialization", lambda: enter(startTime=start, stopTime=stop))


class _Fmi3Step(StepCall):
    """fmi3DoStep, which may return early; it is then called again for the rest of the step."""

    def __init__(self, slave: FmuSlave) -> None:
        self._event, self._ended, self._early = (ctypes.c_bool() for _ in range(3))
        self._reached = ctypes.c_double()
        answers = (self._event, self._ended, self._early, self._reached)
        pointers = (ctypes.byref(answer) for answer in answers)
        super().__init__(slave, slave.function("DoStep"), slave.no_going_back, *pointers)

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step; one that was not taken to its end is an error."""
        end = time + step_size
        super().__call__(time, step_size)
        while not self._ended.value and self._early.value and time < self._reached.value < end:
            time = self._reached.value
            super().__call__(time, end - time)
        if self._ended.value or (self._early.value and self._reached.value < end):
            self.refuse_early(time, self._reached.value, ended=self._ended.value)
