"""One instance of an FMU, loaded by FMPy and called through raw pointers.

`FmuSlave` holds what FMI 2.0 and FMI 3.0 have in common; `fmi2` and `fmi3` hold the calls.
"""

from __future__ import annotations

import ctypes
import inspect
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import InputError, SimulationError
from ..interface.variables import Value
from ..messages import one_line
from .calls import Access, Rearranged, Several, StepCall, Texts
from .fmu_file import Fmu
from .message_log import ERROR, FATAL, OK, STATUS, WARNING, MessageLog, OnMessage
from .wiring import Array, Exchange

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


@cache
def _keep_signatures(fmpy_class: type) -> None:
    """Keep the signatures of FMPy's methods, which it would find out again for each instance."""
    for _, method in inspect.getmembers(fmpy_class, inspect.isfunction):
        method.__signature__ = inspect.signature(method)  # type: ignore[attr-defined]


class FmuSlave(ABC):
    """One instance of an FMU, as the master steps it; for the arguments see `system.open_slave`."""

    def __init__(self, name: str, fmu: Fmu, on_message: OnMessage | None = None) -> None:
        self.name = name
        self.fmu = fmu
        self.log = MessageLog(name, on_message)
        self._keep: list[object] = []
        self._worst = OK
        self._state = ctypes.c_void_p()  # that was kept, if one was
        with _loading:
            self._instance = self._open()
        self.component: int = self._instance.component
        # FMPy's own methods build ctypes arrays from lists at each call, which takes twice the
        # time. Calls to an FMU that runs in this Python keep the interpreter's lock, since its
        # wrapper needs it at once; calls to other FMUs release it, so that other threads run.
        kind = ctypes.PyDLL if fmu.in_python else ctypes.CDLL
        self._library: Any = kind("", handle=self._instance.dll._handle)
        self.step = self._make_step(goes_back=False)

    # Different in FMI 2.0 and 3.0.

    fmpy_class: ClassVar[Any]  # of FMPy, which loads the library
    types: ClassVar[Mapping[str, tuple[str, DTypeLike]]]  # name in FMI's functions and C type
    prefix: ClassVar[str]  # of FMI's functions
    state_name: ClassVar[str]  # in the names of functions
    counts_values: ClassVar[bool]  # whether getters and setters take the number of values

    @abstractmethod
    def _instantiate(self, instance: Any) -> None:
        """Make the instance; raises any Exception."""

    @abstractmethod
    def _make_step(self, *, goes_back: bool) -> StepCall:
        """Make the function `step`, by one communication step; the FMU may have to go back."""

    @abstractmethod
    def _set_up(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and enter initialization mode."""

    # The same in FMI 2.0 and 3.0; in 2.0, each array is one scalar.

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set scalars once, between two steps for example; others of Real arrays keep their values.

        What is not Real is set as whole arrays.
        """
        variables = {name: self.fmu.variable(name).variable for name in values}
        parts = [n for n, v in variables.items() if v.shape and v.fmi_type == "Float64"]
        if parts:
            self.bind_set(parts, np.array([[float(values[n]) for n in parts]]))(0)
        self._set_arrays({n: v for n, v in values.items() if n not in parts})

    def _set_arrays(self, values: Mapping[str, Value]) -> None:
        """Set whole arrays; elements that are not named get their start values."""
        arrays = {v.name: v for v in (self.fmu.variable(name).variable for name in values)}
        for name, array in arrays.items():
            scalars = [self.fmu.variable(each) for each in array.names()]
            content = [
                s.converted(values[s.name]) if s.name in values else s.start_value()
                for s in scalars
            ]
            setter = getattr(self._instance, f"set{self.types[array.fmi_type][0]}")
            self._call(f"set {name}", partial(setter, [scalars[0].value_reference], content), name)

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function of a row's index that reads variables into that row of a block."""
        return self._bind("Get", names, block)

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function of a row's index that writes variables from that row of a block.

        Elements of an array that are not named keep the values that they have now.
        """
        return self._bind("Set", names, block)

    def _bind(self, verb: str, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that gets or sets variables, with one call for each type of FMI."""
        columns: dict[str, list[int]] = {}
        for i, name in enumerate(names):
            columns.setdefault(self.fmu.variable(name).variable.fmi_type, []).append(i)
        calls = [
            self._bind_type(verb, kind, [names[i] for i in places], places, block)
            for kind, places in columns.items()
        ]
        return calls[0] if len(calls) == 1 else Several(calls)

    def _bind_type(
        self, verb: str, kind: str, names: Sequence[str], columns: list[int], block: Array
    ) -> Exchange:
        label, dtype = self.types[kind]
        references, places, size = self._elements(names)
        is_in_order = places == list(range(size)) and columns == list(
            range(columns[0], columns[-1] + 1)
        )
        if is_in_order and dtype is np.float64 and block.dtype == np.float64:
            part = block[:, columns[0] : columns[-1] + 1]
            return self._bind_rows(f"{verb}{label}", references, part)
        values: NDArray[Any] = np.zeros((1, size), dtype)
        sizes = np.zeros(size, np.uintp) if kind == "Binary" else None
        call, get = (
            self._bind_rows(f"{each}{label}", references, values, sizes) for each in (verb, "Get")
        )
        reads, is_part = verb == "Get", verb == "Set" and len(names) < size
        if dtype is np.uintp:
            texts = Texts(call, sizes, places, columns, block, reads=reads)
            if is_part:
                texts.start_from(get)
            return texts
        if is_part:
            get(0)
        return Rearranged(call, places, columns, block, reads=reads)

    def _elements(self, names: Sequence[str]) -> tuple[list[int], list[int], int]:
        """Value references of the arrays that hold scalars, each one's place, and their size."""
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

    def _open(self) -> Any:
        """Load the library and make the instance."""
        here = Path.cwd()
        _keep_signatures(self.fmpy_class)
        try:
            instance = self.fmpy_class(
                guid=self.fmu.guid,
                unzipDirectory=str(self.fmu.folder),
                modelIdentifier=self.fmu.description.coSimulation.modelIdentifier,
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

    def initialize(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values, by scalar variable, and go through initialization."""
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
            self.fail(what, status if isinstance(status, int) else ERROR, None, variable)
        if isinstance(returned, int) and returned < OK:  # FMPy takes it for success
            self.fail(what, returned, None, variable)

    def _bind_rows(
        self,
        label: str,
        references: Sequence[int],
        block: NDArray[Any],
        sizes: NDArray[np.uintp] | None = None,
    ) -> Access:
        """Make a function that calls a getter or setter of FMI with a row of a block."""
        more = (ctypes.c_size_t.from_param(block.shape[1]),) if self.counts_values else ()
        return Access(self, self.function(label), references, block, *more, sizes=sizes)

    def function(self, label: str) -> Any:
        """A function of the library, such as "DoStep"."""
        function = getattr(self._library, f"{self.prefix}{label}")
        function.restype = ctypes.c_uint  # so that a negative status counts as an error
        return function

    def fail_badly(self, what: str, error: Exception, time: float | None = None) -> NoReturn:
        """Report a call that ended with a Python error; the FMU is then in an unknown state."""
        self._worst = FATAL
        raise SimulationError(
            f"{what} failed: {type(error).__name__}: {one_line(error)}",
            time=time,
            instance=self.name,
        ) from error

    def fail(self, what: str, status: int, time: float | None = None, variable: str = "") -> None:
        """Raise the error of a call that returned a status."""
        known = OK <= status < len(STATUS)
        self._worst = max(self._worst, status if known else ERROR)
        cause = self.log.cause
        name = STATUS[status] if known else f"{ctypes.c_int(status).value}, which is not a status"
        text = f"{what} returned {name}" + (f": {cause}" if cause else "")
        raise SimulationError(text, time=time, instance=self.name, variable=variable)

    def get_real(self, names: Sequence[str]) -> Array:
        """Read variables once; returns their values (len(names),)."""
        values: Array = np.full(len(names), math.nan)
        self.bind_get(names, values[np.newaxis])(0)
        return values

    def save(self) -> Callable[[], None]:
        """Save the state; returns a function that goes back to it, as often as it is called."""
        if not self.fmu.description.coSimulation.canGetAndSetFMUstate:
            raise InputError(
                f"{self.fmu.label}: {self.name} cannot go back to a state; its FMU must have "
                f"canGetAndSetFMU{'s' if self.fmu.fmi == 2 else 'S'}tate"
            )
        self.step = self._make_step(goes_back=True)
        self.save_state()
        return self.restore_state

    def save_state(self) -> None:
        """Keep the present state in the one place for it."""
        self._use_state("Get", ctypes.byref(self._state))

    def restore_state(self) -> None:
        """Go back to the state that was kept."""
        self._use_state("Set", self._state)

    def _use_state(self, verb: str, state: object) -> None:
        function = self.function(f"{verb}{self.state_name}")
        status = function(ctypes.c_void_p(self.component), state)
        if status > WARNING:
            self.fail(function.__name__, status)

    def close(self) -> None:
        """Terminate and free the instance, as far as FMI allows. May be called twice."""
        instance, self._instance = self._instance, None
        if instance is None or self._worst == FATAL:
            return  # after a fatal error any call may crash the process
        if self._worst < ERROR:
            with suppress(Exception):  # the run is over; errors no longer matter
                if self._state:
                    self._use_state("Free", ctypes.byref(self._state))
                instance.terminate()
        with _loading:
            instance.freeInstance()
