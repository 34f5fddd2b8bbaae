"""One instance of an FMU on FMPy: exchanged with through raw pointers."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, Final, NoReturn
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, SimulationError
from ..messages import one_line
from .fmu_file import Fmu

Array = NDArray[np.float64]
Value = float | bool | str
OK, WARNING, ERROR, FATAL = 0, 1, 3, 4
STATUS: Final = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
LAST_MESSAGES: Final = 20


# By the environment that each is given, which comes back with its messages.
_slaves: WeakValueDictionary[int, FmuSlave] = WeakValueDictionary()
_numbers = count(1)


@cache
def _logger() -> Any:
    """One function that FMUs log through, for ever.

    FMPy's proxy, which formats the messages, keeps only the last logger that it was given, and
    calls it for all instances, also when the one that gave it has gone.
    """
    from fmpy import fmi2  # noqa: PLC0415 - see `fmus.master.fmu_file`

    return fmi2.fmi2CallbackLoggerTYPE(_log)


def _log(number: int, name: bytes, status: int, _category: bytes, text: bytes) -> None:
    slave = _slaves.get(number or 0)
    if slave is None:  # an FMU that does not keep its environment
        called = (name or b"").decode("utf-8", "replace")
        slave = next((s for s in list(_slaves.values()) if s.name == called), None)
    if slave is not None:
        slave.take_message(status, (text or b"").decode("utf-8", "replace").strip())


class FmuSlave:
    """One instance of an FMU, as the master steps it.

    Args:
        name: Name of the instance.
        fmu: What it is an instance of.
        on_message: Is told each log message of status warning or worse, as
            (instance, status, text).

    Attributes:
        step: Advances by one communication step, from a time [s] by a length [s]; raises
            SimulationError where the FMU does not complete it.

    Raises:
        SimulationError: The FMU could not be instantiated.
    """

    def __init__(
        self,
        name: str,
        fmu: Fmu,
        on_message: Callable[[str, str, str], None] | None = None,
    ) -> None:
        self.name = name
        self.fmu = fmu
        self.messages: list[str] = []
        self._on_message = on_message
        self._keep: list[object] = []
        self._worst = self._logged = OK
        self._instance = self._instantiate()
        self._bind_functions()

    def _instantiate(self) -> Any:
        from fmpy.fmi2 import FMU2Slave  # noqa: PLC0415 - see `fmus.master.fmu_file`

        description = self.fmu.description
        try:
            here = Path.cwd()
            try:
                instance = FMU2Slave(
                    guid=description.guid,
                    unzipDirectory=str(self.fmu.folder),
                    modelIdentifier=description.coSimulation.modelIdentifier,
                    instanceName=self.name,
                )
            except Exception as error:  # the file is at fault: no library, or one that lacks much
                raise InputError(f"{self.fmu.path}: {one_line(error)}") from error
            instance.instantiate(callbacks=self._callbacks(), loggingOn=True)
        except InputError:
            raise
        except Exception as error:  # FMPy raises plain Exceptions
            cause = self.messages[-1] if self.messages else one_line(error)
            raise SimulationError(f"cannot be instantiated: {cause}", instance=self.name) from error
        finally:
            with suppress(OSError, UnboundLocalError):
                os.chdir(here)  # FMPy stays in the FMU's folder if the library cannot be loaded
        return instance

    def _callbacks(self) -> Any:
        from fmpy import calloc, fmi2, free  # noqa: PLC0415 - see `fmus.master.fmu_file`
        from fmpy.logging import addLoggerProxy  # noqa: PLC0415

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger()
        callbacks.componentEnvironment = number = next(_numbers)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(ctypes.byref(callbacks))
        self._keep.append(callbacks)
        _slaves[number] = self
        return callbacks

    def take_message(self, status: int, message: str) -> None:
        """Keep a log message of the FMU's, and pass it on."""
        if status > OK:
            self._logged = max(self._logged, status)
            self.messages = [*self.messages[1 - LAST_MESSAGES :], message]
            if self._on_message is not None:
                self._on_message(self.name, STATUS[min(status, 5)], message)

    def _bind_functions(self) -> None:
        """Take the functions that a tick calls.

        FMPy's own methods build ctypes arrays from lists at each call: twice the time. Where
        the FMU runs in this Python, its wrapper wants the interpreter's lock at once, so it
        is not given away; any other FMU may take its time while other threads run.
        """
        handle = self._instance.dll._handle
        in_python = "PythonFMU" in (self.fmu.description.generationTool or "")
        library = (ctypes.PyDLL if in_python else ctypes.CDLL)("", handle=handle)
        self._component = ctypes.c_void_p.from_param(self._instance.component)
        self._get_real = library.fmi2GetReal
        self._set_real = library.fmi2SetReal
        self.step = self._bind_step(library.fmi2DoStep)

    def initialize(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and go through initialization.

        Args:
            start_values: By scalar variable's name.
            start: Start time [s].
            stop: Stop time [s].

        Raises:
            InputError: A name or a value does not fit the FMU.
            SimulationError: The FMU refuses.
        """
        instance = self._instance
        self._call("set up", lambda: instance.setupExperiment(startTime=start, stopTime=stop))
        for name, value in start_values.items():
            self._set_start(name, value)
        self._call("enter initialization", instance.enterInitializationMode)
        self._call("exit initialization", instance.exitInitializationMode)
        if self._logged > WARNING:  # a PythonFMU slave has no other way to say so
            cause = self._cause().removeprefix("initialization: ")
            raise InputError(f"{self.name}: the FMU refuses its start values: {cause}")

    def _set_start(self, name: str, value: Value) -> None:
        variable = self.fmu.variable(name)
        kind = variable.type
        references = [variable.valueReference]
        instance = self._instance
        setters: dict[str, Callable[[], None]] = {
            "Real": lambda: instance.setReal(references, [float(value)]),
            "Boolean": lambda: instance.setBoolean(references, [bool(value)]),
            "String": lambda: instance.setString(references, [str(value)]),
            "Integer": lambda: instance.setInteger(references, [int(value)]),
            "Enumeration": lambda: instance.setInteger(references, [int(value)]),
        }
        self._call(f"set {name}", setters[kind], name)

    def _call(self, what: str, call: Callable[[], object], variable: str = "") -> None:
        try:
            call()
        except Exception as error:  # FMPy's FMICallException or a ctypes error
            status = getattr(error, "status", ERROR)
            self._fail(what, status if isinstance(status, int) else ERROR, None, variable)

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row of a block.

        Args:
            names: Scalar variables of type Real.
            block: Where their values go (n, len(names)), rows contiguous in themselves; kept.

        Returns:
            The function of the row's index; it raises SimulationError.
        """
        return self._bind(self._get_real, "fmi2GetReal", names, block)

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row of a block.

        Args:
            names: Scalar variables of type Real.
            block: Where their values are (n, len(names)), rows contiguous in themselves; kept.

        Returns:
            The function of the row's index; it raises SimulationError.
        """
        return self._bind(self._set_real, "fmi2SetReal", names, block)

    def _bind(
        self, function: Any, label: str, names: Sequence[str], block: Array
    ) -> Callable[[int], None]:
        for name in names:
            if self.fmu.variable(name).type != "Real":
                raise InputError(f"{self.fmu.path.name}: {name} is not a Real variable")
        if block.shape[1:] != (len(names),) or block.strides[1] != block.itemsize:
            raise ValueError(f"block of shape {block.shape} for {len(names)} variables")
        references = np.array([self.fmu.variables[n].valueReference for n in names], np.uint32)
        self._keep += [references, block]
        pointer = ctypes.c_void_p.from_param
        component, count = self._component, ctypes.c_size_t.from_param(len(names))
        where = pointer(references.ctypes.data)
        first, stride = block.ctypes.data, block.strides[0]
        rows = [pointer(first + i * stride) for i in range(len(block))]

        def exchange(row: int) -> None:
            try:
                status = function(component, where, count, rows[row])
            except Exception as error:  # one that the FMU's own Python has left behind
                self._fail_badly(label, error)
            if status > WARNING:
                self._fail(label, status)

        return exchange

    def _bind_step(self, function: Any) -> Callable[[float, float], None]:
        # Arguments are converted beforehand, so that a call need not.
        component, start = self._component, ctypes.c_double()
        forward, known = ctypes.c_int.from_param(1), math.nan
        length = ctypes.c_double.from_param(known)

        def step(time: float, step_size: float) -> None:
            nonlocal known, length
            if step_size != known:
                known, length = step_size, ctypes.c_double.from_param(step_size)
            start.value = time
            try:
                status = function(component, start, length, forward)
            except Exception as error:  # see `_bind`
                self._fail_badly("fmi2DoStep", error, time)
            if status > WARNING:
                self._fail("fmi2DoStep", status, time)

        return step

    def _fail_badly(self, what: str, error: Exception, time: float | None = None) -> NoReturn:
        """Report a call that ended with a Python error: what the FMU is like then, who knows."""
        self._worst = FATAL
        raise SimulationError(
            f"{what} failed: {type(error).__name__}: {one_line(error)}",
            time=time,
            instance=self.name,
        ) from error

    def _fail(self, what: str, status: int, time: float | None = None, variable: str = "") -> None:
        self._worst = max(self._worst, status)
        cause = self._cause()
        text = f"{what} returned {STATUS[min(status, 5)]}" + (f": {cause}" if cause else "")
        raise SimulationError(text, time=time, instance=self.name, variable=variable)

    def _cause(self) -> str:
        """Return what the FMU said last."""
        return next((m for m in reversed(self.messages) if "Traceback" not in m), "")

    def get_real(self, names: Sequence[str]) -> Array:
        """Read Real variables once.

        Args:
            names: Scalar variables.

        Returns:
            Their values (len(names),).
        """
        values: Array = np.full(len(names), math.nan)
        self.bind_get(names, values[np.newaxis])(0)
        return values

    def close(self) -> None:
        """Terminate and free the instance, as far as FMI allows it. May be called twice."""
        instance, self._instance = self._instance, None
        if instance is None or self._worst == FATAL:
            return  # after fmi2Fatal any call may crash the process
        if self._worst < ERROR:
            with suppress(Exception):  # the run is over, whatever the FMU says to that
                instance.terminate()
        instance.freeInstance()
