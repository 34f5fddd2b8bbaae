"""One instance of an FMU, loaded by FMPy and called through its methods.

`FmuSlave` holds what FMI 2.0 and FMI 3.0 have in common; fmi.py holds what differs.
"""

from __future__ import annotations

import ctypes
import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar, Final

import numpy as np

from ..errors import InputError, SimulationError, one_line
from ..interface.variables import Scalar, Value
from ..processes import run
from .calls import ERROR, FATAL, WARNING, Access, Caller, Experiment, Lists, OnMessage, unheard
from .fmu_file import Fmu
from .wiring import Array, Exchange, Moved, together

# One thread at a time: FMPy changes the working directory while it loads a library, and
# PythonFMU's wrapper changes sys.path while it makes an instance.
_loading = Lock()
REALS: Final = ("Real", "Float64")  # of FMI 2.0 and 3.0
_MISSING: Final = re.compile(r"(\S+): cannot open shared object file: No such file")  # of dlopen
LOADERS: Final = "lib*/ld-linux*.so.*"  # of glibc, which list what a library needs


def working_directory() -> Path:
    """Return the working directory, once no library is being loaded."""
    with _loading:
        return Path.cwd()


def return_to(folder: Path) -> None:
    """Restore the working directory, which an FMU may have changed for the whole process."""
    with _loading, suppress(OSError):
        os.chdir(folder)


def check_libraries(fmu: Fmu) -> None:
    """Refuse an FMU whose library needs another one that is not here; no code of it is run."""
    for loader in [*Path("/").glob(LOADERS)][:1]:
        missing = _MISSING.search(run([str(loader), "--list", str(fmu.library)]).stderr)
        if missing:
            try:  # this process may have it, as it has Python's, which the loader does not find
                ctypes.CDLL(missing[1])
            except OSError:
                raise InputError(f"{fmu.label}: {_lack(missing[1])}") from None


def _lack(library: str) -> str:
    return f"its library needs {library}, which is not on this machine"


class FmuSlave(Caller, ABC):
    """One instance of an FMU, in this process, as the master steps it.

    `open_slave` makes it, of FMI 2.0 or 3.0. Its library is loaded at once, until `close`; what can
    be known without running an FMU's code is told by `Fmu`.
    """

    def __init__(self, name: str, fmu: Fmu, on_message: OnMessage = unheard) -> None:
        super().__init__(name, fmu, on_message)
        self._states: dict[int, ctypes.c_void_p] = {}  # that were kept, by place
        self.stop = math.inf  # [s] up to which it can be stepped
        self._steps = False  # whether initialization is over
        with _loading:
            self.instance = self._open()
        self.component = self.instance.component
        self.step = self.step_call(self)

    # Different in FMI 2.0 and 3.0.

    fmpy_class: ClassVar[Any]  # of FMPy, which loads the library
    step_call: ClassVar[Any]  # subclass of `StepCall`: a step by one communication step
    state_name: ClassVar[str]  # in the names of functions

    @abstractmethod
    def _instantiate(self, instance: Any) -> None:
        """Make the instance; raises any Exception."""

    @abstractmethod
    def _set_up(self, values: Mapping[str, Value], experiment: Experiment) -> None:
        """Set start values and enter initialization mode."""

    # The same in FMI 2.0 and 3.0; in 2.0, each array is one scalar.

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set scalars once, between two steps for example; other elements keep their values."""
        self._set_arrays(values, self.get_values)

    def _set_arrays(
        self,
        values: Mapping[str, Value],
        read: Callable[[Sequence[Scalar]], list[Any]] | None = None,
    ) -> None:
        """Set whole arrays; elements that are not named are read, or get their start values."""
        named = (self.fmu.variable(name).variable for name in values)
        for array in {variable.name: variable for variable in named}.values():
            scalars = [self.fmu.variable(name) for name in array.names()]
            starts = [scalar.start_value() for scalar in scalars]
            content = read(scalars[:1]) if read and array.shape else starts
            for i, scalar in enumerate(scalars):
                if scalar.name in values:
                    content[i] = scalar.converted(values[scalar.name])
            self.set_lists(scalars[:1], content)

    def read(self, names: Sequence[str]) -> list[float]:
        """Read variables once."""
        values = np.empty((1, len(names)))
        self.bind_get(names, values)(0)
        return [*values[0].tolist()]

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function of a row's index that reads variables into that row of a block."""
        return self._bind("Get", names, block)

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables from a row of a block; other elements stay."""
        return self._bind("Set", names, block)

    def _bind(self, verb: str, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that gets or sets variables, with one call for each type of FMI."""
        scalars = [self.fmu.variable(name) for name in names]
        columns: dict[str, list[int]] = {}
        for column, scalar in enumerate(scalars):
            columns.setdefault(scalar.variable.fmi_type, []).append(column)
        return together([
            self._bind_type(verb, [scalars[column] for column in each], each, block)
            for each in columns.values()
        ])  # fmt: skip

    def _bind_type(
        self, verb: str, scalars: Sequence[Scalar], columns: list[int], block: Array
    ) -> Exchange:
        arrays = list({scalar.variable.name: scalar for scalar in scalars}.values())
        *firsts, size = accumulate((array.variable.size for array in arrays), initial=0)
        first = {array.variable.name: i for array, i in zip(arrays, firsts, strict=True)}
        places = [first[scalar.variable.name] + scalar.element for scalar in scalars]
        is_real = arrays[0].variable.fmi_type in REALS
        access, dtype = (Access, np.float64) if is_real else (Lists, np.object_)
        is_part = columns == list(range(columns[0], columns[-1] + 1))
        if is_part and places == list(range(size)) and block.dtype == dtype:
            return access(self, verb, arrays, block[:, columns[0] : columns[-1] + 1])
        values: Array = np.zeros((1, size), dtype)
        if verb == "Set" and len(scalars) < size:  # the others are set again and again
            access(self, "Get", arrays, values)(0)
        call = access(self, verb, arrays, values)
        return Moved(call, values, places, block, columns, reads=verb == "Get")

    def _open(self) -> Any:
        """Load the library and make the instance."""
        try:
            with chdir("."):  # FMPy does not go back if the library cannot be loaded
                instance = self.fmpy_class(
                    guid=self.fmu.guid,
                    unzipDirectory=str(self.fmu.folder),
                    libraryPath=str(self.fmu.library),
                    modelIdentifier=self.fmu.description.coSimulation.modelIdentifier,
                    instanceName=self.name,
                )
        except Exception as error:  # not a library, or one that lacks FMI functions
            missing = _MISSING.search(str(error))
            why = _lack(missing[1]) if missing else one_line(error)
            raise InputError(f"{self.fmu.label}: {why}") from error
        try:
            self._instantiate(instance)
        except Exception as error:  # FMPy raises plain Exceptions
            cause = self.log.cause or one_line(error)
            raise InputError(f"in FMU {self.name!r}: cannot be instantiated: {cause}") from error
        return instance

    def enter_initialization(self, values: Mapping[str, Value], experiment: Experiment) -> None:
        """Set start values, by scalar variable, and enter initialization mode."""
        self.start, self.stop = experiment.start, experiment.stop
        with self._start_values_refused():
            self._set_up(values, experiment)

    def exit_initialization(self) -> None:
        """Leave initialization mode; the FMU can be stepped then."""
        with self._start_values_refused():
            self.call("exit initialization", self.instance.exitInitializationMode)
        if self.fmu.in_python and self.log.worst > WARNING:
            raise self._refusal()  # its wrapper has no other way to pass on a slave's error
        self._steps = True

    @contextmanager
    def _start_values_refused(self) -> Iterator[None]:
        try:
            yield
        except SimulationError as error:
            if self._worst != ERROR or not self.log.cause:
                raise
            raise self._refusal() from error

    def _refusal(self) -> InputError:
        cause = self.log.cause.removeprefix("initialization: ")
        return InputError(f"{self.name}: the FMU refuses its start values: {cause}")

    def save_state(self, place: int = 0) -> None:
        """Keep the present state in one of any number of places for it."""
        self.no_going_back = False
        state = self._states.setdefault(place, ctypes.c_void_p())
        self._use_state("Get", ctypes.byref(state))

    def restore_state(self, place: int = 0) -> None:
        """Go back to the state that was kept there."""
        self._use_state("Set", self._states[place])

    def _use_state(self, verb: str, state: object) -> None:
        name = f"{self.prefix}{verb}{self.state_name}"
        self.call(name, getattr(self.instance, name), self.component, state)

    def close(self) -> None:
        """Terminate and free the instance, as far as FMI allows. May be called twice."""
        instance, self.instance = self.instance, None
        if instance is None or self._worst == FATAL:
            return  # after a fatal error any call may crash the process
        if self._worst < ERROR:
            with suppress(Exception):  # the run is over; errors no longer matter
                for state in self._states.values():
                    self._use_state("Free", ctypes.byref(state))
                if self._steps:
                    instance.terminate()
        with _loading:
            instance.freeInstance()
