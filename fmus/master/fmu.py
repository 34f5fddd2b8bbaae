"""One instance of an FMU, loaded by FMPy and called through raw pointers.

`FmuSlave` holds what FMI 2.0 and FMI 3.0 have in common; `fmi2` and `fmi3` hold the calls.
"""

from __future__ import annotations

import ctypes
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, SimulationError
from ..messages import one_line
from .fmu_file import Fmu
from .message_log import ERROR, FATAL, OK, STATUS, WARNING, MessageLog, OnMessage

Array = NDArray[np.float64]
Value = float | bool | str
# One thread at a time: FMPy changes the working directory while it loads a library, and
# PythonFMU's wrapper changes sys.path while it makes an instance.
_loading = Lock()


def working_directory() -> Path:
    """Return the working directory, once no library is being loaded."""
    with _loading:
        return Path.cwd()


def return_to(folder: Path) -> None:
    """Restore the working directory, which an FMU may have changed for the whole process."""
    with _loading, suppress(OSError):
        os.chdir(folder)


def open_slave(name: str, fmu: Fmu, on_message: OnMessage | None = None) -> FmuSlave:
    """Instantiate an FMU of FMI 2.0 or 3.0.

    Args:
        name: Name of the instance.
        fmu: The FMU.
        on_message: Called with each log message of status warning or worse, as
            (instance, status, text).

    Raises:
        InputError: The file's library cannot be used.
        SimulationError: The FMU could not be instantiated.
    """
    from .fmi2 import Fmi2Slave  # noqa: PLC0415 - imports this module
    from .fmi3 import Fmi3Slave  # noqa: PLC0415 - imports this module

    return (Fmi3Slave if fmu.fmi == 3 else Fmi2Slave)(name, fmu, on_message)


class FmuSlave(ABC):
    """One instance of an FMU, as the master steps it; for the arguments see `open_slave`.

    Attributes:
        step: Advances by one communication step, given its time [s] and size [s]; raises
            SimulationError if the FMU does not complete it.
        log: Its messages.
    """

    step: Callable[[float, float], None]

    def __init__(self, name: str, fmu: Fmu, on_message: OnMessage | None = None) -> None:
        self.name = name
        self.fmu = fmu
        self.log = MessageLog(name, on_message)
        self._keep: list[object] = []
        self._worst = OK
        with _loading:
            self._instance = self._open()
        self._component = ctypes.c_void_p.from_param(self._instance.component)
        self._bind_functions(self._library())

    # Different in FMI 2.0 and 3.0.

    @abstractmethod
    def _load(self, **arguments: str) -> Any:
        """Load the library; returns FMPy's object."""

    @abstractmethod
    def _instantiate(self, instance: Any) -> None:
        """Make the instance; raises any Exception."""

    @abstractmethod
    def _bind_functions(self, library: Any) -> None:
        """Look up the functions that a tick calls, and bind `step`."""

    @abstractmethod
    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and enter initialization mode."""

    @abstractmethod
    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once: tunable parameters between two steps.

        Args:
            values: By scalar variable's name.

        Raises:
            SimulationError: The FMU refuses.
        """

    @abstractmethod
    def bind_get_discrete(self, kind: str, names: Sequence[str]) -> Callable[[], NDArray[Any]]:
        """Make a function that reads variables of another type than Real.

        Args:
            kind: Their type, as the FMU's FMI version names it.
            names: Scalar variables, all of this type.

        Returns:
            The function; it returns the values (len(names),) and raises SimulationError.
        """

    @abstractmethod
    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row of a block.

        Args:
            names: Scalar variables that are numbers; integers and booleans become float64.
            block: Where their values go (n, len(names)), rows contiguous in themselves; kept.

        Returns:
            The function of the row's index; it raises SimulationError.
        """

    @abstractmethod
    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row of a block.

        Args:
            names: Scalar variables of type Real.
            block: Where their values are (n, len(names)), rows contiguous in themselves; kept.

        Returns:
            The function of the row's index; it raises SimulationError.
        """

    # The same in FMI 2.0 and 3.0.

    def _open(self) -> Any:
        """Load the library and make the instance."""
        description = self.fmu.description
        here = Path.cwd()
        try:
            instance = self._load(
                guid=self.fmu.guid,
                unzipDirectory=str(self.fmu.folder),
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=self.name,
            )
        except Exception as error:  # not a library, or one that lacks FMI functions
            raise InputError(f"{self.fmu.label}: {one_line(error)}") from error
        finally:
            with suppress(OSError):
                os.chdir(here)  # FMPy does not go back if the library cannot be loaded
        try:
            self._instantiate(instance)
        except Exception as error:  # FMPy raises plain Exceptions
            cause = self.log.cause or one_line(error)
            raise SimulationError(f"cannot be instantiated: {cause}", instance=self.name) from error
        return instance

    def _library(self) -> Any:
        """Return the library for calls with raw pointers.

        FMPy's own methods build ctypes arrays from lists at each call, which takes twice the
        time. Calls to an FMU that runs in this Python keep the interpreter's lock, since its
        wrapper needs it at once; calls to other FMUs release it, so that other threads run.
        """
        kind = ctypes.PyDLL if self.fmu.in_python else ctypes.CDLL
        return kind("", handle=self._instance.dll._handle)

    def initialize(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and go through initialization.

        Args:
            start_values: By scalar variable's name.
            start: Start time [s].
            stop: Stop time [s].

        Raises:
            InputError: A name or a value is not valid for the FMU.
            SimulationError: The FMU reports an error.
        """
        try:
            self._set_up(start_values, start, stop)
            self._call("exit initialization", self._instance.exitInitializationMode)
        except SimulationError as error:
            if self._worst != ERROR or not self.log.messages:
                raise
            raise self._refusal() from error
        if self.fmu.in_python and self.log.worst > WARNING:
            raise self._refusal()  # its wrapper has no other way to pass on a slave's error

    def _refusal(self) -> InputError:
        cause = self.log.cause.removeprefix("initialization: ")
        return InputError(f"{self.name}: the FMU refuses its start values: {cause}")

    def _call(self, what: str, call: Callable[[], object], variable: str = "") -> None:
        try:
            returned = call()
        except Exception as error:  # FMPy's FMICallException or a ctypes error
            status = getattr(error, "status", ERROR)
            self._fail(what, status if isinstance(status, int) else ERROR, None, variable)
        if isinstance(returned, int) and returned < OK:  # FMPy takes it for success
            self._fail(what, returned, None, variable)

    def _are_real(self, names: Sequence[str]) -> bool:
        return all(self.fmu.variable(name).type == "Real" for name in names)

    def _real(self, names: Sequence[str]) -> None:
        for name in names:
            if self.fmu.variable(name).type != "Real":
                raise InputError(f"{self.fmu.label}: {name} is not a Real variable")

    def _bind_rows(
        self, function: Any, references: Sequence[int], block: NDArray[Any], *more: object
    ) -> Callable[[int], None]:
        """Make a function that calls an FMI getter or setter with a row of a block.

        Args:
            function: The FMI function.
            references: Value references.
            block: The values, one row per call, of the C type of the function; kept.
            more: Arguments after the values.
        """
        if block.strides[1] != block.itemsize:
            raise ValueError("values of a row must be contiguous")
        function.restype = ctypes.c_uint  # so that a negative status counts as an error
        numbers = np.array(references, np.uint32)
        self._keep += [numbers, block]
        pointer = ctypes.c_void_p.from_param
        component, length = self._component, ctypes.c_size_t.from_param(len(numbers))
        where, label = pointer(numbers.ctypes.data), function.__name__
        first, stride = block.ctypes.data, block.strides[0]
        rows = [pointer(first + i * stride) for i in range(len(block))]

        def exchange(row: int) -> None:
            try:
                status = function(component, where, length, rows[row], *more)
            except Exception as error:  # raised by Python code of the FMU
                self._fail_badly(label, error)
            if status > WARNING:
                self._fail(label, status)

        return exchange

    def _bind_step(self, function: Any, *more: object) -> Callable[[float, float], None]:
        # Arguments are converted once, since converting them at each call takes time.
        function.restype = ctypes.c_uint  # see `_bind_rows`
        component, start = self._component, ctypes.c_double()
        known, label = math.nan, function.__name__
        length = ctypes.c_double.from_param(known)

        def step(time: float, step_size: float) -> None:
            nonlocal known, length
            if step_size != known:
                known, length = step_size, ctypes.c_double.from_param(step_size)
            start.value = time
            try:
                status = function(component, start, length, *more)
            except Exception as error:  # see `_bind_rows`
                self._fail_badly(label, error, time)
            if status > WARNING:
                self._fail(label, status, time)

        return step

    def _fail_badly(self, what: str, error: Exception, time: float | None = None) -> NoReturn:
        """Report a call that ended with a Python error; the FMU is then in an unknown state."""
        self._worst = FATAL
        raise SimulationError(
            f"{what} failed: {type(error).__name__}: {one_line(error)}",
            time=time,
            instance=self.name,
        ) from error

    def _fail(self, what: str, status: int, time: float | None = None, variable: str = "") -> None:
        known = OK <= status < len(STATUS)
        self._worst = max(self._worst, status if known else ERROR)
        cause = self.log.cause
        name = STATUS[status] if known else f"{ctypes.c_int(status).value}, which is not a status"
        text = f"{what} returned {name}" + (f": {cause}" if cause else "")
        raise SimulationError(text, time=time, instance=self.name, variable=variable)

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
        """Terminate and free the instance, as far as FMI allows. May be called twice."""
        instance, self._instance = self._instance, None
        if instance is None or self._worst == FATAL:
            return  # after a fatal error any call may crash the process
        if self._worst < ERROR:
            with suppress(Exception):  # the run is over; errors no longer matter
                instance.terminate()
        with _loading:
            instance.freeInstance()
