"""An FMU in a process of its own, whose crash does not affect this one.

A request is (method, arguments, blocks to set first). A reply is (error or None, result, log
messages). A step is asked for and answered by one byte, as its values are in memory that both
processes share; those that are no float64 go with requests, and so does such an FMU's step.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import os
import signal
import socket
import struct
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from time import perf_counter
from types import SimpleNamespace
from typing import IO, Any, Final, NoReturn

import numpy as np

from ..errors import CosimError, InputError, SimulationEndedError, SimulationError
from ..interface.variables import Value
from ..processes import Child, listen
from .calls import OnMessage, Spent
from .fmu import REALS, FmuSlave
from .fmu_file import Fmu
from .kernel import GONE, LATE, STEPPED, Kernel, make_kernel
from .step import Step
from .wiring import Array, Exchange, Shared, nothing, together

START_TIMEOUT = 30.0  # [s] for all requests but a step, if there is a step timeout
CLOSE_TIMEOUT = 5.0  # [s] for freeing the instance
LEAVE_TIMEOUT = 1.0  # [s] for a process to end after it has closed its connection
ORDER: Final = 2  # begin and size of a step [s], the first two values of the shared memory
SPARE: Final = 1024  # values beyond those of all variables, once as inputs and once as outputs
# As in stepper.c.
TAKE_STEP: Final = b"s"
DONE, HEARD, ENDED_AT_END, FAILED = range(4)
# A new interpreter, not a fork: after a fork, locks of this process's threads would stay locked.
_CHILD: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from panda_cosim.fmus.master.system import open_slave; "
    "from panda_cosim.fmus.master.remote_slave import serve; "
    "serve(*map(int, sys.argv[2:]), open_slave)"
)
# In which Python handles a signal that came while C waited.
_INTERRUPTED: Final = ctypes.CFUNCTYPE(None)(lambda: None)


class RemoteSlave:
    """An FMU in a process of its own, with the same bits; `step_timeout` [s] ends a late one.

    `open_system` makes it with `isolate`, for FMUs that may crash or hang; a tick takes longer, and
    its state cannot be restored by a `PerturbedSystem`.
    """

    no_going_back = True  # as far as this process knows

    def __init__(
        self,
        name: str,
        fmu: Fmu,
        on_message: OnMessage | None = None,
        step_timeout: float | None = None,
    ) -> None:
        if sys.platform == "win32":
            raise InputError("--isolate: not on this platform; must be Linux or another Unix")
        self.name, self.fmu = name, fmu
        self.stop = math.inf  # [s] up to which it can be stepped
        self.time: float | None = None  # of the present step [s]
        self.spent: Spent = defaultdict(float)
        self._on_message, self.step_timeout = on_message, step_timeout
        self._blocks: list[Shared] = []  # that are bound
        self._put: dict[int, list[Any] | None] = {}  # since the last request; None: in the memory
        self._is_current = False  # whether the outputs are those of the present state
        self.shares_all = True  # whether one byte asks for a step, as no value goes with it
        self._waiting = False  # for a reply
        folders = json.dumps([folder for folder in sys.path if folder])
        with _memory_file() as file:
            file.truncate(8 * (ORDER + 2 * len(fmu.variables) + SPARE))
            self.memory = _mapped(file.fileno())
            self._child = Child("-c", _CHILD, folders, str(file.fileno()), files=[file.fileno()])
        self._connection = self._child.connection
        self.step = RemoteStep(self, self._connection.fileno())

    def enter_initialization(
        self, values: Mapping[str, Value], start: float, stop: float, tolerance: float | None = None
    ) -> None:
        """Open the FMU, set start values and enter initialization mode."""
        self.stop = stop
        self._call("open", self.name, str(self.fmu.path.absolute()), self.fmu.sizes)
        self._call("enter_initialization", dict(values), start, stop, tolerance)

    def exit_initialization(self) -> None:
        """Leave initialization mode, see `FmuSlave.exit_initialization`."""
        self._call("exit_initialization")

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave.set_values`."""
        self._call("set_values", dict(values))

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that reads variables into a row, see `FmuSlave.bind_get`."""
        return self._bind("bind_get", names, block)

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables from a row, see `FmuSlave.bind_set`."""
        return self._bind("bind_set", names, block)

    def _bind(self, method: str, names: Sequence[str], block: Array) -> Shared:
        place = ORDER + sum(each.memory.size for each in self._blocks if is_shared(each))
        memory = self.memory[place : place + len(names)]
        are_reals = all(self.fmu.variable(name).variable.fmi_type in REALS for name in names)
        if not (are_reals or block.dtype == np.float64) or memory.size < len(names):
            place, memory, self.shares_all = -1, np.zeros(len(names), np.object_), False
        self._call("bind", method, list(names), place)
        made = Shared(self, len(self._blocks), block, memory, reads=method == "bind_get")
        self._blocks.append(made)
        return made

    def note(self, put: Shared) -> None:
        """Have values set before the next request."""
        self._put[put.index] = None if is_shared(put) else put.memory.tolist()
        self._is_current = False

    def refresh(self) -> None:
        """Have the outputs of the present state written to the memory, unless they are."""
        if not self._is_current:
            self._take_in(self._call("outputs"))

    def take(self, time: float, step_size: float) -> None:
        """Take a step by a request."""
        self._take_in(self._call("step", time, step_size, limit=self.step_timeout))

    def taken(self) -> None:
        """Note that a step was taken by a byte: inputs are set, and outputs were read."""
        self._put, self._is_current = {}, True

    def _take_in(self, outputs: Mapping[int, list[Any]]) -> None:
        for index, values in outputs.items():
            self._blocks[index].memory[:] = values
        self._is_current = True

    def save_state(self, place: int = 0) -> None:
        """Keep the present state, see `FmuSlave.save_state`."""
        self._call("save_state", place)

    def restore_state(self, place: int = 0) -> None:
        """Go back to the state that was kept there."""
        self._call("restore_state", place)

    def told(self) -> None:
        """Hear what the FMU has logged; raises the error of its last step, if it has one."""
        self._call("told")
        self._is_current = True

    def close(self) -> None:
        """Free the instance and end the process, in any state. May be called twice."""
        try:
            if not (self._connection.closed or self._waiting):
                with suppress(CosimError):
                    self._call("close", limit=CLOSE_TIMEOUT)
                    self._child.ended(LEAVE_TIMEOUT)
        finally:  # also if Ctrl-C comes meanwhile
            self._child.end()

    def _call(self, method: str, *arguments: Any, limit: float | None = None) -> Any:
        """Call a method of the slave; what was read of the FMU before is then out of date."""
        if limit is None and self.step_timeout is not None:
            limit = START_TIMEOUT
        put, self._put, self._is_current = self._put, {}, False
        self._waiting = True
        try:
            self.step.end()
            self._connection.send((method, arguments, put))
            if limit is not None and not self._connection.poll(limit):
                self.fail_late(limit)
            error, result, messages = self._connection.recv()
        except (EOFError, OSError):
            self.fail_gone()
        self._waiting = False
        if self._on_message is not None:
            for message in messages:
                self._on_message(*message)
        if error is not None:
            raise error
        return result

    def fail_late(self, limit: float) -> NoReturn:
        """Raise the error of a process that does not answer for a time [s]."""
        self._fail(
            f"no answer for {limit:g} s, so its process was ended; a longer --step-timeout gives "
            "it more time"
        )

    def fail_gone(self) -> NoReturn:
        """Raise the error of a process that has ended."""
        match self._child.ended(LEAVE_TIMEOUT):
            case None:
                self._fail("its process closed its connection")
            case code if code < 0:
                self._fail(f"its process was ended by {signal.Signals(-code).name}")
            case code:
                self._fail(f"its process ended with exit code {code}")

    def _fail(self, message: str) -> NoReturn:
        self._child.end()
        raise SimulationError(message, time=self.time, instance=self.name)


class _Remote(ctypes.Structure):
    _fields_ = [
        ("socket", ctypes.c_int32), ("heard", ctypes.c_int32), ("asked", ctypes.c_int32),
        ("order", ctypes.c_void_p), ("interrupted", ctypes.c_void_p),
    ]  # fmt: skip


class RemoteStep:
    """A step of an FMU in another process; the kernel asks for it in the same way."""

    name = "step"

    def __init__(self, slave: RemoteSlave, descriptor: int) -> None:
        self.slave, self._socket = slave, descriptor
        interrupted = ctypes.cast(_INTERRUPTED, ctypes.c_void_p).value
        self._remote = _Remote(descriptor, 0, 0, slave.memory.ctypes.data, interrupted)
        if slave.step_timeout is not None:
            part, whole = math.modf(min(slave.step_timeout, 1e9))
            limit = struct.pack("ll", int(whole), max(int(1e6 * part), 1))
            with socket.socket(fileno=os.dup(descriptor)) as own:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step; raises SimulationError if it fails, or if the process ends or is late."""
        slave, began = self.slave, perf_counter()
        slave.time = time
        if not slave.shares_all:
            slave.take(time, step_size)
        elif (answer := self._ask(time, step_size)) == ENDED_AT_END:
            raise self.ending(time, time + step_size)
        elif answer == HEARD:
            slave.told()
        elif answer != DONE:
            self.fail(answer, time)
        slave.spent[self.name] += perf_counter() - began

    def _ask(self, time: float, step_size: float) -> int:
        self.slave.memory[:ORDER] = time, step_size
        try:
            os.write(self._socket, TAKE_STEP)
            answer = os.read(self._socket, 1)
        except BlockingIOError:
            return LATE
        except OSError:
            return GONE
        self.slave.taken()
        return answer[0] if answer else GONE

    @property
    def in_c(self) -> bool:
        """Whether C can ask for it."""
        return self.slave.shares_all

    def for_c(self) -> dict[str, int | None]:
        """Return what the kernel calls."""
        return {"instance": ctypes.addressof(self._remote)}

    def end(self) -> None:
        """Take the answer of a step that C has asked for and not awaited, as another has failed."""
        if self._remote.asked:
            self._remote.asked = 0
            os.read(self._socket, 1)

    def hear(self) -> None:
        """Hear messages that were logged while C asked for steps."""
        if self._remote.heard:
            self._remote.heard = 0
            self.slave.told()

    def fail(self, status: int, time: float) -> None:
        """Raise the error of a step."""
        self.slave.time = time
        if status == LATE:
            self.slave.fail_late(self.slave.step_timeout or 0.0)
        if status == GONE:
            self.slave.fail_gone()
        self.slave.told()

    def ending(self, time: float, reached: float) -> SimulationEndedError:
        """What says that the FMU has ended the simulation."""
        try:
            self.slave.told()
        except SimulationEndedError as ended:
            return ended
        return SimulationEndedError("ended", reached=reached, time=time, instance=self.slave.name)


def is_shared(block: Shared) -> bool:
    """Whether a block's values are in the shared memory."""
    return block.memory.dtype == np.float64


def _memory_file() -> IO[bytes]:
    """Open a file without a name; in memory, where a full disk cannot end the process."""
    if not hasattr(os, "memfd_create"):
        return TemporaryFile()
    return os.fdopen(os.memfd_create("fmu"), "w+b")


def _mapped(file: int) -> Array:
    return np.frombuffer(mmap.mmap(file, 0), np.float64)


# In the FMU's process.


def serve(file: int, descriptor: int, parent: int, open_slave: Callable[..., FmuSlave]) -> None:
    """Serve requests until the other side closes the connection."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the master handles it, and closes the connection
    connection, method = listen(descriptor, parent), ""
    host = _Host(open_slave, _mapped(file), socket.socket(fileno=os.dup(descriptor)))
    os.close(file)
    with suppress(EOFError, OSError):
        while method != "close":
            host.serve_steps()
            method, arguments, values = connection.recv()
            error, result = _tried(host.call, method, arguments, values)
            connection.send((error, result, host.said()))
    # Without the clean-up of interpreter and libraries, in which many FMUs crash.
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(0)


def _tried(call: Callable[..., Any], *arguments: Any) -> tuple[CosimError | None, Any]:
    """Call a function; return its error, if it fails, and its result."""
    try:
        return None, call(*arguments)
    except CosimError as raised:
        return raised, None
    except Exception as raised:
        return SimulationError(f"{type(raised).__name__}: {raised}"), None


class _Host:
    """Executes requests, and takes steps."""

    def __init__(
        self, open_slave: Callable[..., FmuSlave], memory: Array, asked: socket.socket
    ) -> None:
        self._open_slave, self._memory, self._socket = open_slave, memory, asked
        self._rows = memory.reshape(1, -1)
        self._messages: list[tuple[str, ...]] = []
        self._wants_answer = ctypes.c_int32()  # set by a message, so that C returns
        self._blocks: list[Array] = []  # values (1, n)
        self._exchanges: dict[str, dict[int, Exchange]] = {"bind_get": {}, "bind_set": {}}
        self._slave: Any = None
        self._step = Step([], "jacobi", 1.0, self._rows, nothing)
        self._kernel: Kernel | None = None
        self._taken = 0  # what the kernel has said of the last step
        self._error: CosimError | None = None  # of the last step

    def serve_steps(self) -> None:
        """Take the steps that are asked for, until something else is."""
        while self._is_asked():
            self._error, _ = _tried(self._take)
            answer = FAILED if self._error else HEARD if self._messages else DONE
            if self._step.ended:
                self._error, answer = self._step.ended, ENDED_AT_END
            self._socket.send(bytes([answer]))

    def _is_asked(self) -> bool:
        """Wait for a request; a step in C has then been taken."""
        if self._kernel is not None:
            self._taken = self._kernel.serve(self._socket.fileno(), self._memory)
            return self._taken > 0
        is_step = self._socket.recv(1, socket.MSG_PEEK) == TAKE_STEP
        return is_step and bool(self._socket.recv(1))

    def _take(self) -> None:
        """Take a step, or say how the one in C has ended."""
        time, self._step.size = self._memory[:ORDER].tolist()
        if self._kernel is None:
            self._step.take(0, time)
        else:
            self._kernel.check(time + (self._taken == STEPPED) * self._step.size)

    def said(self) -> list[tuple[str, ...]]:
        """Return the messages since it was last asked."""
        messages, self._messages, self._wants_answer.value = self._messages, [], 0
        return messages

    def hear(self, *message: str) -> None:
        """Keep a message."""
        self._messages.append(message)
        self._wants_answer.value = 1

    def call(self, method: str, arguments: Any, values: dict[int, list[Any] | None]) -> Any:
        """Set input blocks, then call a method of this object or of the slave."""
        for index, numbers in values.items():
            if numbers is not None:
                self._blocks[index][0] = numbers
            self._exchanges["bind_set"][index](0)
        return getattr(self if hasattr(self, method) else self._slave, method)(*arguments)

    def open(self, name: str, path: str, sizes: Mapping[str, int]) -> None:
        """Make the slave."""
        fmu = Fmu(Path(path)).restructured(sizes)
        self._slave = self._open_slave(name, fmu, self.hear)

    def bind(self, method: str, names: list[str], place: int) -> None:
        """Bind a block for values: in the shared memory from a place on, or, at -1, of its own."""
        shared = self._rows[:, place : place + len(names)]
        block: Array = shared if place >= 0 else np.zeros((1, len(names)), np.object_)
        self._exchanges[method][len(self._blocks)] = getattr(self._slave, method)(names, block)
        self._blocks.append(block)
        get, put = (together([*self._exchanges[each].values()]) for each in self._exchanges)
        bound: Any = SimpleNamespace(set_inputs=put, step=self._slave.step, get_outputs=get)
        self._step.leaders = [bound]
        self._make_kernel()

    def save_state(self, place: int) -> None:
        """Keep the present state; from the first on, steps say that they may be repeated."""
        was_final = self._slave.no_going_back
        self._slave.save_state(place)
        if was_final and self._kernel is not None:
            self._make_kernel()

    def _make_kernel(self) -> None:
        self._kernel = make_kernel(self._step, self._rows, 0.0, self._wants_answer)

    def step(self, time: float, step_size: float) -> dict[int, list[Any]]:
        """Take a step."""
        self._slave.step(time, step_size)
        return self.outputs()

    def outputs(self) -> dict[int, list[Any]]:
        """Read the blocks that are read; return those that are not in the shared memory."""
        gets = self._exchanges["bind_get"]
        for get in gets.values():
            get(0)
        return {i: self._blocks[i][0].tolist() for i in gets if self._blocks[i].dtype == np.object_}

    def told(self) -> None:
        """Raise the error of the last step, if it has one."""
        if self._error is not None:
            raise self._error
