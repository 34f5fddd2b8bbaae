"""The calls of FMI 2.0 and 3.0 for co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Final, NoReturn

from fmpy import calloc, fmi2, fmi3, free
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2LastSuccessfulTime, fmi2Terminated
from fmpy.fmi3 import FMU3Slave

try:
    from fmpy import logging as proxies
except OSError:  # on ARM
    proxies = None

from ..errors import SimulationError
from ..interface.variables import Value
from .calls import DISCARD, WARNING, Experiment, OnMessage, StepCall, receive, unheard
from .fmu import FmuSlave
from .fmu_file import Fmu
from .wiring import Array, Exchange

MOST_UPDATES: Final = 1000  # of discrete states at one event
# What FMUs log through is never freed, since they may log at any time. FMPy's proxy, which formats
# FMI 2.0's messages, calls the last logger that it was given, for all instances.
_LOGGER2: Final = fmi2.fmi2CallbackLoggerTYPE(
    lambda number, name, status, _category, text: receive(number, name, status, text)
)
_LOGGER3: Final = fmi3.fmi3LogMessageCallback(
    lambda number, status, _category, text: receive(number, b"", status, text)
)


class _Fmi2Step(StepCall):
    """fmi2DoStep; an FMU that cannot go on discards the step, and says that it has terminated."""

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step."""
        slave = self.slave
        arguments = (slave.component, time, step_size, slave.no_going_back)
        slave.call(self.name, self._method, *arguments, time=time)


class Fmi2Slave(FmuSlave):
    """An instance of an FMI 2.0 FMU: a value reference is one scalar."""

    fmpy_class, step_call = FMU2Slave, _Fmi2Step
    prefix, state_name, enumeration = "fmi2", "FMUstate", "Integer"

    def fail(
        self, what: str, status: int, time: float | None = None, variable: str = ""
    ) -> NoReturn:
        """Raise the error of a status, or of a discarded step the end of the simulation."""
        with suppress(FMICallException):
            if status == DISCARD and self.instance.getBooleanStatus(fmi2Terminated):
                raise self.step.ending(time, self.instance.getRealStatus(fmi2LastSuccessfulTime))
        super().fail(what, status, time, variable)

    def _instantiate(self, instance: Any) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _LOGGER2
        callbacks.componentEnvironment = self.log.number
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        if proxies is not None:  # else messages keep their format, without the values
            proxies.addLoggerProxy(ctypes.byref(callbacks))
        instance.instantiate(callbacks=callbacks, loggingOn=True)

    def _set_up(self, values: Mapping[str, Value], experiment: Experiment) -> None:
        self.call("set up", self.instance.setupExperiment, *experiment)
        self._set_arrays(values)
        self.call("enter initialization", self.instance.enterInitializationMode)


class _Fmi3Step(StepCall):
    """fmi3DoStep, which may return early; it is then called again for the rest of the step."""

    slave: Fmi3Slave

    def __init__(self, slave: Fmi3Slave) -> None:
        super().__init__(slave)
        self._event, self._ended, self._early = (ctypes.c_bool() for _ in range(3))
        self._reached = ctypes.c_double()
        answers = (self._event, self._ended, self._early, self._reached)
        self._answers = [ctypes.byref(answer) for answer in answers]

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step; one that was not taken to its end is an error."""
        slave, end, size = self.slave, time + step_size, step_size
        while True:
            self._reached.value = end
            before = (slave.component, time, size, slave.no_going_back)
            slave.call(self.name, self._method, *before, *self._answers, time=time)
            self.reached = reached = self._reached.value if self._early.value else end
            if self._ended.value:
                raise self.ending(time, self._reached.value)
            if self._event.value:
                self.meet_event(time)
            if reached >= end:
                return
            if reached <= time:
                self.refuse_early(time, reached)
            time, size = reached, end - reached

    def meet_event(self, time: float) -> None:
        """Handle an event that ended a step; without event mode, it is an error."""
        if not self.slave.has_events:
            text = "the FMU needs an event handled, but its description has no event mode"
            raise SimulationError(text, time=time, instance=self.slave.name)
        self.slave.handle_event(self.reached)

    def refuse_early(self, time: float, reached: float) -> NoReturn:
        """Raise the error of a step that made no headway."""
        text = f"the FMU returned early, at {reached:g} s"
        raise SimulationError(text, time=time, instance=self.slave.name)


class Fmi3Slave(FmuSlave):
    """An instance of an FMI 3.0 FMU: a value reference is a whole array.

    An FMU that has event mode is run with it.
    """

    fmpy_class, step_call = FMU3Slave, _Fmi3Step
    prefix, state_name, enumeration = "fmi3", "FMUState", "Int64"

    def _instantiate(self, instance: Any) -> None:
        self._sent: list[list[Any]] = []  # last values of discrete inputs
        self._kept: dict[int, list[list[Any]]] = {}  # these, with a state
        declared = bool(self.fmu.description.coSimulation.hasEventMode)
        for self.has_events in (declared, False):  # a public FMU (Roberts) refuses what it declares
            instance.component = self._made(instance)
            if instance.component:
                break
        else:
            raise RuntimeError("fmi3InstantiateCoSimulation returned NULL")
        if declared and not self.has_events:
            text = "it refuses the event mode that it declares, and is run without"
            self.log.take(WARNING, text)

    def _made(self, instance: Any) -> Any:
        """Make the instance; None: the FMU refuses."""
        # FMPy's own `instantiate` sets no environment, which identifies the sender of a message.
        return instance.fmi3InstantiateCoSimulation(
            self.name.encode(),
            self.fmu.guid.encode(),
            f"{self.fmu.folder / 'resources'}/".encode(),
            False,  # visible
            True,  # logging
            self.has_events,
            self.has_events,  # early return, at an event
            (fmi3.fmi3ValueReference * 0)(),
            0,
            self.log.number,
            _LOGGER3,
            fmi3.fmi3IntermediateUpdateCallback(),
        )

    def _set_up(self, values: Mapping[str, Value], experiment: Experiment) -> None:
        structural = {n: v for n, v in values.items() if n in self.fmu.structural}
        if structural:
            self.call("enter configuration", self.instance.enterConfigurationMode)
            self._set_arrays(structural)
            self.call("exit configuration", self.instance.exitConfigurationMode)
        self._set_arrays({n: v for n, v in values.items() if n not in structural})
        self.call("enter initialization", self.instance.enterInitializationMode, *experiment)

    def exit_initialization(self) -> None:
        """Leave initialization mode, for event mode if the FMU has it."""
        super().exit_initialization()
        if self.has_events:
            self._settle(self.start)

    def handle_event(self, time: float, act: Callable[[], None] = lambda: None) -> None:
        """Go through event mode: act, then update discrete states until they settle."""
        self.call("fmi3EnterEventMode", self.instance.enterEventMode)
        act()
        self._settle(time)

    def _settle(self, time: float) -> None:
        for _ in range(MOST_UPDATES):
            answer = self.call("fmi3UpdateDiscreteStates", self.instance.updateDiscreteStates)
            if answer[1]:
                raise self.step.ending(time, time)
            if not answer[0]:
                self.call("fmi3EnterStepMode", self.instance.enterStepMode)
                return
        text = f"its discrete states do not settle in {MOST_UPDATES} updates"
        raise SimulationError(text, time=time, instance=self.name)

    def save_state(self, place: int = 0) -> None:
        """Keep the present state, and what an input is compared with, which may be an event."""
        super().save_state(place)
        self._kept[place] = [[*values] for values in self._sent]

    def restore_state(self, place: int = 0) -> None:
        """Go back to the state that was kept there."""
        super().restore_state(place)
        for values, kept in zip(self._sent, self._kept[place], strict=True):
            values[:] = kept

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set scalars once; with event mode, in it."""
        if not self.has_events:
            return super().set_values(values)
        return self.handle_event(self.step.reached, partial(super().set_values, values))

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables; discrete ones that change are an event."""
        put = super().bind_set(names, block)
        variables = [self.fmu.variable(name).variable for name in names]
        discrete = [i for i, v in enumerate(variables) if v.variability != "continuous"]
        if not (self.has_events and discrete):
            return put
        last: list[Any] = []
        self._sent.append(last)

        def exchange(row: int) -> None:
            values = block[row, discrete].tolist()
            if self._steps and values != last:
                self.handle_event(self.step.reached, partial(put, row))
            else:
                put(row)
            last[:] = values

        return exchange


def open_slave(name: str, fmu: Fmu, on_message: OnMessage = unheard) -> FmuSlave:
    """Instantiate an FMU of FMI 2.0 or 3.0."""
    return (Fmi3Slave if fmu.fmi == 3 else Fmi2Slave)(name, fmu, on_message)
