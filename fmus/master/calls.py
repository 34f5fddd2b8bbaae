"""Calls of FMPy's methods with arguments that are converted once, and an FMU's log messages.

`Step` calls them. `Kernel` reads them, and makes the same calls from C.
"""

from __future__ import annotations

import ctypes
import re
from abc import ABC, abstractmethod
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import PurePath
from time import perf_counter
from typing import Any, ClassVar, Final, NamedTuple, NoReturn
from weakref import WeakValueDictionary

from numpy.typing import NDArray

from ..errors import SimulationEndedError, SimulationError
from ..interface.types import type_of
from ..interface.variables import INTEGERS, Scalar
from .fmu_file import Fmu

OnMessage = Callable[[str, str, str], None]  # with instance, status and text
Spent = defaultdict[str, float]  # [s] wall time by name of a call
OK, WARNING, DISCARD, ERROR, FATAL = range(5)
STATUS: Final = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
LAST_MESSAGES: Final = 20

_TRACEBACK: Final = "Traceback (most recent call last):"
_FRAME: Final = re.compile(r'^ +File "([^"\n]*)", line (\d+).*$', re.MULTILINE)

# By the environment pointer that each instance gets and hands back with its messages.
_logs: WeakValueDictionary[int, MessageLog] = WeakValueDictionary()
_numbers = count(1)


class Experiment(NamedTuple):
    """What an FMU is told of its run, in the order of FMI's arguments."""

    tolerance: float | None  # relative, of one that integrates
    start: float  # [s]
    stop: float  # [s]


def unheard(_instance: str, _status: str, _text: str, /) -> None:
    """Take a message that nobody wants to hear."""


def receive(number: int | None, name: bytes, status: int, text: bytes) -> None:
    """Pass a message on to the log of its instance, found by environment or name."""
    log = _logs.get(number or 0)
    if log is None:  # the FMU does not hand back its environment
        log = next((each for each in list(_logs.values()) if each.instance == _text(name)), None)
    if log is not None:
        log.take(status, _text(text).strip())


def _text(value: str | bytes | None) -> str:
    return value if isinstance(value, str) else (value or b"").decode("utf-8", "replace")


def without_traceback(message: str) -> str:
    """Return what a message says before a traceback, and the traceback's place and error."""
    before, _, trace = message.partition(_TRACEBACK)
    frames = list(_FRAME.finditer(trace))
    if not frames:
        return message
    # The lines of code after a frame are indented; the error is not.
    rest = trace[frames[-1].end() :].splitlines()
    error = " ".join(line for line in rest if line and not line.startswith(" "))
    file, line = frames[-1].groups()
    return f"{before}{PurePath(file).name}, line {line}: {error}"


class MessageLog:
    """The messages of one instance; all are passed on."""

    def __init__(self, instance: str, on_message: OnMessage) -> None:
        self.instance, self._on_message = instance, on_message
        self.worst = OK
        self.number = next(_numbers)  # environment pointer that the FMU hands back
        self.calls = 0  # that Python has made
        self.in_c: Callable[[], tuple[float, ...]] = tuple  # which call C makes
        self._last: deque[tuple[object, str]] = deque(maxlen=LAST_MESSAGES)  # by call
        _logs[self.number] = self

    @property
    def cause(self) -> str:
        """What the FMU has said in the present call, first things first, else what it said last."""
        said = [text for call, text in self._last if call == self._call]
        said = said or [text for _, text in [*self._last][-1:]]
        return "; ".join(dict.fromkeys(map(without_traceback, said)))

    @property
    def _call(self) -> tuple[float, ...]:
        return (self.calls, *self.in_c())

    def take(self, status: int, message: str) -> None:
        """Pass a message on; a warning or worse is kept as a cause."""
        if status > OK:
            self.worst = max(self.worst, status)
            self._last.append((self._call, message))
        self._on_message(self.instance, STATUS[min(max(status, OK), 5)], message)


class Caller:
    """An instance of an FMU, whose methods are called; `FmuSlave` makes it."""

    instance: Any  # of FMPy
    component: int  # that FMI's functions take
    prefix: ClassVar[str]  # of FMI's functions
    enumeration: ClassVar[str]  # in the names of functions
    has_events = False  # whether it is run with event mode

    def __init__(self, name: str, fmu: Fmu, on_message: OnMessage = unheard) -> None:
        self.name, self.fmu, self.log = name, fmu, MessageLog(name, on_message)
        self.spent: Spent = defaultdict(float)
        self.no_going_back = True  # argument of fmiDoStep: whether no earlier state is restored
        self._worst = OK

    def call(
        self,
        what: str,
        method: Callable[..., Any],
        *arguments: Any,
        variable: str = "",
        time: float | None = None,
    ) -> Any:
        """Call a method of FMPy; a status worse than a warning is an error."""
        self.log.calls += 1
        began = perf_counter()
        try:
            returned = method(*arguments)
        except Exception as error:  # FMPy's FMICallException or a ctypes error
            status = getattr(error, "status", ERROR)
            self.fail(what, status if isinstance(status, int) else ERROR, time, variable)
        self.spent[what] += perf_counter() - began
        if isinstance(returned, int) and returned < OK:  # FMPy takes it for success
            self.fail(what, returned, time, variable)
        return returned

    def fail(
        self, what: str, status: int, time: float | None = None, variable: str = ""
    ) -> NoReturn:
        """Raise the error of a call that returned a status."""
        known = OK <= status < len(STATUS)
        self._worst = max(self._worst, status if known else ERROR)
        cause = self.log.cause.removeprefix(f"{what}: ")
        name = STATUS[status] if known else f"{status}, which is not a status"
        text = f"{what} returned {name}" + (f": {cause}" if cause else "")
        raise SimulationError(text, time=time, instance=self.name, variable=variable)

    def get_values(self, arrays: Sequence[Scalar]) -> list[Any]:
        """Read whole arrays of one type; each is named by one of its scalars."""
        kind = arrays[0].variable.fmi_type
        size = [sum(array.variable.size for array in arrays)] if self.fmu.fmi == 3 else []
        values = self._call_typed("get", arrays, *size)
        if kind == "String":
            return [*map(_text, values)]
        return [v or b"" for v in values] if kind == "Binary" else list(values)

    def set_lists(self, arrays: Sequence[Scalar], values: Sequence[Any]) -> None:
        """Write whole arrays of one type, see `get_values`."""
        self._call_typed("set", arrays, values)

    def _call_typed(self, verb: str, arrays: Sequence[Scalar], *arguments: object) -> Any:
        kind = arrays[0].variable.fmi_type
        label = f"{verb}{self.enumeration if kind == 'Enumeration' else kind}"
        references = [array.value_reference for array in arrays]
        names = [array.variable.name for array in arrays]
        one = names[0] if len(names) == 1 else ""
        return self.call(label, getattr(self.instance, label), references, *arguments, variable=one)


class InLibrary:
    """A function of an FMU's library, which C can call, too."""

    slave: Caller
    name: str

    def for_c(self) -> dict[str, int | None]:
        """Return what the kernel calls."""
        function = ctypes.cast(getattr(self.slave.instance.dll, self.name), ctypes.c_void_p).value
        return {"function": function, "instance": self.slave.component, "fmi": self.slave.fmu.fmi}

    def fail(self, status: int, time: float) -> NoReturn:
        """Raise the error of a status."""
        self.slave.fail(self.name, status, time)


class Access(InLibrary):
    """A getter or setter of arrays, called with the index of a row of a block (n, elements)."""

    def __init__(
        self, slave: Caller, verb: str, arrays: Sequence[Scalar], block: NDArray[Any]
    ) -> None:
        kind, references = arrays[0].variable.fmi_type, [each.value_reference for each in arrays]
        self.slave, self.name = slave, f"{slave.prefix}{verb}{kind}"
        self.memory = block
        self.references = (ctypes.c_uint * len(references))(*references)
        size = block.shape[1]
        first, stride, view = block.ctypes.data, block.strides[0], ctypes.c_double * size
        before, more = (slave.component, self.references, len(references)), (size,)
        self._method = getattr(slave.instance, self.name)
        self._arguments = [
            (*before, view.from_address(first + i * stride), *(more if slave.fmu.fmi == 3 else ()))
            for i in range(len(block))
        ]

    def __call__(self, row: int) -> None:
        """Call the method with a row of the block, in place."""
        self.slave.call(self.name, self._method, *self._arguments[row])

    def for_c(self) -> dict[str, int | None]:
        """Return what the kernel calls, and with what."""
        references = {"references": ctypes.addressof(self.references)}
        return super().for_c() | references | {"count": len(self.references)}


class Lists:
    """The same for arrays of a type that is not float64, through FMPy's functions of lists."""

    def __init__(
        self, slave: Caller, verb: str, arrays: Sequence[Scalar], block: NDArray[Any]
    ) -> None:
        self._slave, self._verb, self._arrays, self._block = slave, verb, arrays, block
        names = (name for array in arrays for name in array.variable.names())
        self._scalars = [slave.fmu.variable(name) for name in names]

    def __call__(self, row: int) -> None:
        """Exchange the values of a row of the block."""
        if self._verb == "Get":
            self._block[row] = self._slave.get_values(self._arrays)
        else:
            values = map(self._in_type, self._scalars, self._block[row])
            self._slave.set_lists(self._arrays, list(values))

    def _in_type(self, scalar: Scalar, value: Any) -> Any:
        """Return a value in the FMU's type: rounded, and in its range, unless it is a Float32."""
        kind, variable = type_of(scalar.variable), scalar.variable
        if kind in ("String", "Binary"):
            return value
        if kind == "Float32":
            return float(value)
        number, why = round(value) if abs(value) < 2**64 else 2**64, ""
        if kind == "Boolean":
            return number != 0
        bits, signed = INTEGERS.get(kind, INTEGERS["Int32"])  # of an enumeration
        if not -(2 ** (bits - 1)) * signed <= number < 2 ** (bits - signed):
            why = f" is out of the range of {kind}"
        elif variable.choices and number not in map(variable.number_of, variable.choices):
            valid = (f"{variable.number_of(name)} ({name})" for name in variable.choices)
            why = f"; must be {', '.join(valid)}"
        if why:
            raise SimulationError(
                f"value {value}{why}", instance=self._slave.name, variable=scalar.name
            )
        return number


class StepCall(InLibrary, ABC):
    """FMPy's `doStep` of an FMU, by a time and a step size [s]."""

    reached = 0.0  # [s] by the last step of FMI 3.0

    def __init__(self, slave: Caller) -> None:
        self.slave, self.name = slave, f"{slave.prefix}DoStep"
        self._method = getattr(slave.instance, self.name)

    @abstractmethod
    def __call__(self, time: float, step_size: float) -> None:
        """Take a step to its end; raises SimulationEndedError if the FMU ends the simulation."""

    @property
    def in_c(self) -> bool:
        """Whether C can call it: neither Python nor event mode is needed."""
        return not (self.slave.fmu.in_python or self.slave.has_events)

    def ending(self, time: float, reached: float) -> SimulationEndedError:
        """What says that the FMU has ended the simulation."""
        word = f": {self.slave.log.cause}" if self.slave.log.cause else ""
        text = f"the FMU asks to end the simulation, at {reached:g} s{word}"
        return SimulationEndedError(text, reached=reached, time=time, instance=self.slave.name)
