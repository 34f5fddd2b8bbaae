"""An FMU in a process of its own, whose crash does not affect this one.

A request is (method, arguments, values of the blocks to set first, by their index). A reply is
(error or None, result, log messages); the result of `step` and `outputs` is the values of all
blocks that are read.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from ..errors import CosimError, InputError, SimulationError
from ..interface.variables import Value
from ..processes import Child, listen
from .calls import OnMessage
from .fmu import FmuSlave
from .fmu_file import Fmu
from .wiring import Array, Exchange

START_TIMEOUT = 30.0  # [s] for all requests but a step, if there is a step timeout
CLOSE_TIMEOUT = 5.0  # [s] for freeing the instance
LEAVE_TIMEOUT = 1.0  # [s] for a process to end after it has closed its connection
# A new interpreter, not a fork: after a fork, locks of this process's threads would stay locked.
_CHILD: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from panda_cosim.fmus.master.system import open_slave; "
    "from panda_cosim.fmus.master.remote_slave import serve; "
    "serve(int(sys.argv[2]), int(sys.argv[3]), open_slave)"
)


class RemoteSlave:
    """An FMU in a process of its own, with the same bits; `step_timeout` [s] ends a late one.

    `open_system` makes it with `isolate`, for FMUs that may crash or hang; a tick takes longer, and
    its state cannot be restored by a `PerturbedSystem`.
    """

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
        self._on_message, self._step_timeout = on_message, step_timeout
        self._time: float | None = None  # of the present step [s]
        self._blocks = 0  # number of those that are bound, in the order of their making
        self._inputs: dict[int, Array] = {}  # put since the last request, by block
        self._outputs: dict[int, Array] | None = None  # by block; None: out of date
        self._waiting = False  # for a reply
        folders = json.dumps([folder for folder in sys.path if folder])
        self._child = Child("-c", _CHILD, folders)
        self._connection = self._child.connection

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
        index = self._bind("bind_get", names, block)

        def read(row: int) -> None:
            if self._outputs is None:
                self._outputs = self._call("outputs")
            block[row] = self._outputs[index]

        return read

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables from a row, see `FmuSlave.bind_set`."""
        index = self._bind("bind_set", names, block)

        def put(row: int) -> None:
            self._inputs[index] = block[row].copy()
            self._outputs = None

        return put

    def _bind(self, method: str, names: Sequence[str], block: Array) -> int:
        self._call("bind", method, list(names), block.dtype.char)
        self._outputs = None
        self._blocks += 1
        return self._blocks - 1

    def step(self, time: float, step_size: float) -> None:
        """Take a step; raises SimulationError if it fails, or if the process ends or is late."""
        self._time = time
        self._outputs = self._call("step", time, step_size, limit=self._step_timeout)

    def save_state(self) -> None:
        """Keep the present state, see `FmuSlave.save_state`."""
        self._call("save_state")

    def restore_state(self) -> None:
        """Go back to the state that was kept."""
        self._call("restore_state")

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
        if limit is None and self._step_timeout is not None:
            limit = START_TIMEOUT
        inputs, self._inputs, self._outputs = self._inputs, {}, None
        self._waiting = True
        try:
            self._connection.send((method, arguments, inputs))
            if not self._connection.poll(limit):
                self._fail(
                    f"no answer for {limit:g} s, so its process was ended; a longer --step-timeout "
                    "gives it more time"
                )
            error, result, messages = self._connection.recv()
        except (EOFError, OSError):
            self._fail_gone()
        self._waiting = False
        if self._on_message is not None:
            for message in messages:
                self._on_message(*message)
        if error is not None:
            raise error
        return result

    def _fail_gone(self) -> NoReturn:
        match self._child.ended(LEAVE_TIMEOUT):
            case None:
                self._fail("its process closed its connection")
            case code if code < 0:
                self._fail(f"its process was ended by {signal.Signals(-code).name}")
            case code:
                self._fail(f"its process ended with exit code {code}")

    def _fail(self, message: str) -> NoReturn:
        self._child.end()
        raise SimulationError(message, time=self._time, instance=self.name)


# In the FMU's process.


def serve(descriptor: int, parent: int, open_slave: Callable[..., FmuSlave]) -> None:
    """Serve requests until the other side closes the connection."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the master handles it, and closes the connection
    connection, host, method = listen(descriptor, parent), _Host(open_slave), ""
    with suppress(EOFError, OSError):
        while method != "close":
            method, arguments, values = connection.recv()
            error, result = None, None
            try:
                result = host.call(method, arguments, values)
            except CosimError as raised:
                error = raised
            except Exception as raised:
                error = SimulationError(f"{type(raised).__name__}: {raised}")
            messages, host.messages = host.messages, []
            connection.send((error, result, messages))
    # Without the clean-up of interpreter and libraries, in which many FMUs crash.
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(0)


class _Host:
    """Executes requests."""

    def __init__(self, open_slave: Callable[..., FmuSlave]) -> None:
        self.messages: list[tuple[str, ...]] = []
        self._open_slave = open_slave
        self._blocks: list[Array] = []  # values (1, n)
        self._exchanges: dict[str, dict[int, Exchange]] = {"bind_get": {}, "bind_set": {}}
        self._slave: Any = None

    def call(self, method: str, arguments: Any, values: dict[int, Array]) -> Any:
        """Set input blocks, then call a method of this object or of the slave."""
        for index, numbers in values.items():
            self._blocks[index][0] = numbers
            self._exchanges["bind_set"][index](0)
        return getattr(self if hasattr(self, method) else self._slave, method)(*arguments)

    def open(self, name: str, path: str, sizes: Mapping[str, int]) -> None:
        """Make the slave."""
        fmu = Fmu(Path(path)).restructured(sizes)
        self._slave = self._open_slave(name, fmu, lambda *message: self.messages.append(message))

    def bind(self, method: str, names: list[str], dtype: str) -> None:
        """Bind a block for values."""
        block = np.zeros((1, len(names)), dtype)
        self._exchanges[method][len(self._blocks)] = getattr(self._slave, method)(names, block)
        self._blocks.append(block)

    def step(self, time: float, step_size: float) -> dict[int, Array]:
        """Take a step."""
        self._slave.step(time, step_size)
        return self.outputs()

    def outputs(self) -> dict[int, Array]:
        """Read the blocks that are read."""
        for get in self._exchanges["bind_get"].values():
            get(0)
        return {index: self._blocks[index][0] for index in self._exchanges["bind_get"]}
