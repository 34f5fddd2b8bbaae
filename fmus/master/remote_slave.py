"""An FMU in a process of its own, whose crash does not affect this one.

A request is (inputs to set first, method, arguments), a reply (error or None, result, messages).
Float64 values are in memory that both processes share, others go with requests. Where C can take
the steps on both sides, they are asked for and answered by a word in that memory.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import signal
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partialmethod
from time import perf_counter
from types import SimpleNamespace
from typing import Any, Final, NoReturn

import numpy as np

from ..errors import CosimError, SimulationError
from ..interface.variables import Value
from ..processes import Forked, Nursery, listen, nurse
from .calls import Experiment, OnMessage, Spent, unheard
from .fmu import REALS
from .fmu_file import Fmu, load_fmpy
from .kernel import GONE, LATE, STEPPED, Kernel, load_stepper, make_kernel
from .step import Step
from .wiring import Array, Moved, Shared, nothing

START_TIMEOUT = 30.0  # [s] for all requests but a step, if there is a step timeout
CLOSE_TIMEOUT = 5.0  # [s] for freeing the instance
LEAVE_TIMEOUT = 1.0  # [s] for a process to end after its connection is closed
# The shared memory begins with that of a step [s], its size [s], and what was said last.
ORDER: Final = 3
HEARD, ENDED_AT_END, FAILED = range(1, 4)  # as in stepper.c
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
        on_message: OnMessage = unheard,
        *,
        nursery: Nursery,
        step_timeout: float | None = None,
    ) -> None:
        self.name, self.fmu = name, fmu
        self.stop = math.inf  # [s] up to which it can be stepped
        self.time: float | None = None  # of the present step [s]
        self.spent: Spent = defaultdict(float)
        self._on_message, self.step_timeout = on_message, step_timeout
        # Inputs that the next request sets, and outputs of the present state, or None; []: they are
        # in the memory.
        self.inputs: list[Any] | None = None
        self.outputs: list[Any] | None = None
        self._waiting = False  # for a reply
        with os.fdopen(os.memfd_create("fmu"), "w+b") as file:
            file.truncate(8 * (ORDER + 2 * len(fmu.variables)))
            self.memory = _mapped(file.fileno())
            try:
                self._child = Forked(nursery, file.fileno())
            except (EOFError, OSError):
                raise SimulationError("its process could not be started", instance=name) from None
        self._connection = self._child.connection
        self.step = RemoteStep(self, self._connection.fileno())

    def enter_initialization(self, values: Mapping[str, Value], experiment: Experiment) -> None:
        """Open the FMU, set start values and enter initialization mode."""
        self.stop = experiment.stop
        self.step.in_c = self.call("open", self.name, self.fmu)
        self.call("enter_initialization", dict(values), experiment)

    def _bind(self, method: str, names: Sequence[str], block: Array) -> Moved:
        reads, places = method == "bind_get", range(len(names))
        first = ORDER + reads * len(self.fmu.variables)
        memory = self.memory[np.newaxis, first : first + len(names)]
        are_reals = all(self.fmu.variable(name).variable.fmi_type in REALS for name in names)
        if not (are_reals or block.dtype == np.float64):
            first, memory = -1, np.zeros((1, len(names)), np.object_)
        self.step.in_c = self.call("bind", method, list(names), first)
        shared = Shared(self, memory, reads=reads)
        return Moved(shared, memory, places, block, places, reads=reads)

    def close(self) -> None:
        """Free the instance and end the process, in any state. May be called twice."""
        try:
            if not (self._connection.closed or self._waiting):
                with suppress(CosimError):
                    self.call("close", limit=CLOSE_TIMEOUT)
        finally:  # also if Ctrl-C comes meanwhile
            self._child.end()

    def call(self, method: str, *arguments: Any, limit: float | None = None) -> Any:
        """Call a method of the slave; what was read of the FMU before is then out of date."""
        if limit is None and self.step_timeout is not None:
            limit = START_TIMEOUT
        inputs, self.inputs, self.outputs = self.inputs, None, None
        self._waiting = True
        try:
            self.step.end()
            self._connection.send((inputs, method, arguments))
            if limit is not None and not self._connection.poll(limit):
                self.fail_late(limit)
            error, result, messages = self._connection.recv()
        except (EOFError, OSError):
            self.fail_gone()
        self._waiting = False
        for message in messages:
            self._on_message(*message)
        if error is not None:
            raise error
        return result

    # As of `FmuSlave`; all inputs are bound at once, and so are all outputs.
    bind_get = partialmethod(_bind, "bind_get")
    bind_set = partialmethod(_bind, "bind_set")
    exit_initialization = partialmethod(call, "exit_initialization")
    set_values = partialmethod(call, "set_values")
    read = partialmethod(call, "read")
    save_state = partialmethod(call, "save_state")
    restore_state = partialmethod(call, "restore_state")

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
        ("order", ctypes.c_void_p), ("interrupted", ctypes.c_void_p), ("limit", ctypes.c_double),
    ]  # fmt: skip


class RemoteStep:
    """A step of an FMU in another process; the kernel asks for it in the same way."""

    name = "step"
    in_c = False  # whether C can ask for it

    def __init__(self, slave: RemoteSlave, descriptor: int) -> None:
        self.slave = slave
        interrupted = ctypes.cast(_INTERRUPTED, ctypes.c_void_p).value
        limit = math.inf if slave.step_timeout is None else slave.step_timeout
        self._remote = _Remote(descriptor, 0, 0, slave.memory.ctypes.data, interrupted, limit)

    def __call__(self, time: float, step_size: float) -> None:
        """Take a step; raises SimulationError if it fails, or if the process ends or is late."""
        slave, began = self.slave, perf_counter()
        slave.time = time
        slave.outputs = slave.call("step", time, step_size, limit=slave.step_timeout)
        slave.spent[self.name] += perf_counter() - began

    def for_c(self) -> dict[str, int | None]:
        """Return what the kernel calls."""
        return {"instance": ctypes.addressof(self._remote)}

    def end(self) -> None:
        """End waiting for steps in C, on both sides; raises OSError if an answer is not to come."""
        if self.in_c and load_stepper().panda_listen(ctypes.byref(self._remote)) in (LATE, GONE):
            raise EOFError

    def hear(self) -> None:
        """Hear messages that were logged while C asked for steps."""
        if self._remote.heard:
            self._remote.heard = 0
            self.slave.call("told")

    def fail(self, status: int, time: float) -> NoReturn:
        """Raise the error of a step."""
        self.slave.time = time
        if status == LATE:
            self.slave.fail_late(self.slave.step_timeout or 0.0)
        if status == GONE:
            self.slave.fail_gone()
        raise self.slave.call("told")

    def ending(self, _time: float, _reached: float) -> Any:
        """What says that the FMU has ended the simulation."""
        return self.slave.call("told")


def _mapped(file: int) -> Array:
    return np.frombuffer(mmap.mmap(file, 0), np.float64)


# In the FMU's process.


def nurse_slaves(descriptor: int, parent: int) -> None:
    """Fork a process for each FMU, once all that they need is imported."""
    load_fmpy()
    from . import fmi  # noqa: F401, PLC0415 - as above

    nurse(serve, descriptor, parent)


def serve(descriptor: int, file: int, parent: int) -> None:
    """Serve requests until the other side closes the connection."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the master handles it, and closes the connection
    connection = listen(descriptor, parent)
    host = _Host(_mapped(file))
    os.close(file)
    with suppress(EOFError, OSError):
        while True:
            host.serve_steps()
            error, result = _tried(host.call, *connection.recv())
            connection.send((error, result, host.said()))
    os._exit(0)  # without the clean-up of interpreter and libraries, in which many FMUs crash


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

    def __init__(self, memory: Array) -> None:
        self._memory, self._rows = memory, memory.reshape(1, -1)
        self._messages: list[tuple[str, ...]] = []
        self._wants_answer = ctypes.c_int32()  # set by a message, so that C returns
        self._inputs = self._outputs = self._rows[:, :0]  # values (1, n)
        self._slave: Any = None
        self._bound: Any = SimpleNamespace(set_inputs=nothing, get_outputs=nothing)
        self._step = Step([], "jacobi", 1.0, self._rows, nothing)
        self._kernel: Kernel | None = None
        self._error: CosimError | None = None  # of the last step in C

    def serve_steps(self) -> None:
        """Take the steps that are asked for in C, until a request is."""
        while self._kernel and (taken := self._kernel.serve(self._memory)):
            time, self._step.size, _ = self._memory[:ORDER].tolist()
            self._error, _ = _tried(self._kernel.check, time + (taken == STEPPED) * self._step.size)
            answer = FAILED if self._error else HEARD
            if self._step.ended:
                self._error, answer = self._step.ended, ENDED_AT_END
            load_stepper().panda_say(ctypes.c_void_p(self._memory.ctypes.data), answer)

    def told(self) -> CosimError | None:
        """Return the error of the last step in C, if it has one."""
        return self._error

    def said(self) -> list[tuple[str, ...]]:
        """Return the messages since it was last asked."""
        messages, self._messages, self._wants_answer.value = self._messages, [], 0
        return messages

    def hear(self, *message: str) -> None:
        """Keep a message."""
        self._messages.append(message)
        self._wants_answer.value = 1

    def call(self, inputs: list[Any] | None, method: str, arguments: Any) -> Any:
        """Set the inputs, then call a method of this object or of the slave."""
        if inputs:
            self._inputs[0] = inputs
        if inputs is not None:
            self._bound.set_inputs(0)
        return getattr(self if hasattr(self, method) else self._slave, method)(*arguments)

    def open(self, name: str, fmu: Fmu) -> bool:
        """Make the slave; returns, as `bind`, whether C can take its steps."""
        from .fmi import open_slave  # noqa: PLC0415 - FMPy takes 0.1 s

        self._slave = open_slave(name, fmu, self.hear)
        self._bound.step = self._slave.step
        self._step.leaders = [self._bound]
        return self._make_kernel()

    def bind(self, method: str, names: list[str], place: int) -> bool:
        """Bind to the shared memory from a place on, or, at -1, to a block of its own."""
        shared = self._rows[:, place : place + len(names)]
        block: Array = shared if place >= 0 else np.zeros((1, len(names)), np.object_)
        exchange = getattr(self._slave, method)(names, block)
        if method == "bind_set":
            self._inputs, self._bound.set_inputs = block, exchange
        else:
            self._outputs, self._bound.get_outputs = block, exchange
        return self._make_kernel()

    def _make_kernel(self) -> bool:
        self._kernel = make_kernel(self._step, self._rows, 0.0, self._wants_answer)
        return self._kernel is not None

    def save_state(self, place: int = 0) -> None:
        """Keep the present state; from the first on, steps say that they may be repeated."""
        was_final = self._slave.no_going_back
        self._slave.save_state(place)
        if was_final:
            self._make_kernel()

    def step(self, time: float, step_size: float) -> list[Any]:
        """Take a step."""
        self._slave.step(time, step_size)
        return self.outputs()

    def outputs(self) -> list[Any]:
        """Read the outputs; returns those that are not in the shared memory."""
        self._bound.get_outputs(0)
        is_shared = self._outputs.dtype == np.float64
        return [] if is_shared else self._outputs[0].tolist()

    def close(self) -> None:
        """Free the slave, and write what its library has printed: the process is killed next."""
        self._slave.close()
        ctypes.CDLL(None).fflush(None)
