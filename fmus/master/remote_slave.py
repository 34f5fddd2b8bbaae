"""An FMU in a process of its own, whose crash does not affect this one.

Requests and replies are pickled tuples of numbers, texts and lists of them; see `remote_host`.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Pipe
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, InputError, SimulationError
from ..files.fmu_file import Fmu
from ..interface.variables import Value
from ..processes import SAFE_PATH, start_from_lasting_thread
from .fmu import check_block
from .message_log import OnMessage

Array = NDArray[np.float64]

START_TIMEOUT = 30.0  # [s] for all requests but a step, if there is a step timeout
CLOSE_TIMEOUT = 5.0  # [s] for freeing the instance
LEAVE_TIMEOUT = 1.0  # [s] for a process to end after it has closed its connection
LOOK_INTERVAL: Final = 0.2  # [s] between two checks that the process still runs
# A new interpreter, not a fork: after a fork, locks of this process's threads would stay locked.
_CHILD: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from panda_cosim.fmus.master.remote_host import main; "
    "main(int(sys.argv[2]), int(sys.argv[3]))"
)


class RemoteSlave:
    """One instance of an FMU in a process of its own, as the master steps it.

    Its values equal those of `FmuSlave` bit for bit. A tick costs one exchange of messages: the
    inputs go along with the request to step, and the outputs come back with the reply.

    Args:
        name: Name of the instance.
        fmu: What it is an instance of.
        on_message: Called with each log message of status warning or worse.
        step_timeout: Wall time that a step may take [s]; None: unlimited. After it the process is
            killed.
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
        self.name = name
        self.fmu = fmu
        self._on_message = on_message
        self._step_timeout = step_timeout
        self._time: float | None = None  # of the present step [s]
        self._inputs: dict[int, bytes] = {}  # put since the last request, by block
        self._outputs: list[bytes] | None = None  # of each block; None: out of date
        self._blocks = [0, 0]  # number of blocks to set and to get
        self._pending = 0  # requests that have no reply yet
        self._start()
        self._send("open", name, str(fmu.path.absolute()))  # so that all FMUs open at once

    def _start(self) -> None:
        self._connection, there = Pipe()
        folders = [folder for folder in sys.path if folder]
        arguments = [json.dumps(folders), str(there.fileno()), str(os.getpid())]

        def start() -> subprocess.Popen[bytes]:
            return subprocess.Popen(
                [sys.executable, "-c", _CHILD, *arguments],
                stdin=subprocess.DEVNULL,
                env=os.environ | SAFE_PATH,
                pass_fds=[there.fileno()],
                start_new_session=True,  # gets no Ctrl-C, and can be killed with its children
            )

        try:
            self._process = start_from_lasting_thread(start)
        except OSError as error:
            self._connection.close()
            raise SimulationError(
                f"no process could be started: {error.strerror}", instance=self.name
            ) from error
        finally:
            there.close()

    def initialize(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and go through initialization, see `FmuSlave.initialize`."""
        self._call("initialize", dict(start_values), start, stop)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave.set_values`."""
        self._call("set_values", dict(values))

    def get_real(self, names: Sequence[str]) -> Array:
        """Read variables once, see `FmuSlave.get_real`."""
        return np.array(self._call("get_real", list(names)), dtype=np.float64)

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row, see `FmuSlave.bind_get`."""
        check_block(names, block)
        self._call("bind_get", list(names))
        index = self._blocks[1]
        self._blocks[1] += 1

        def read(row: int) -> None:
            if self._outputs is None:
                self._exchange("get")
            assert self._outputs is not None
            block[row] = np.frombuffer(self._outputs[index])

        return read

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave.bind_set`."""
        check_block(names, block)
        self._call("bind_set", list(names))
        index = self._blocks[0]
        self._blocks[0] += 1

        def put(row: int) -> None:
            self._inputs[index] = block[row].tobytes()
            self._outputs = None

        return put

    def step(self, time: float, step_size: float) -> None:
        """Take a step; raises SimulationError if it fails, or if the process ends or is late."""
        self._time = time
        self._exchange("step", time, step_size)

    def close(self) -> None:
        """Free the instance and end the process, in any state. May be called twice."""
        try:
            if self._process.returncode is None and self._pending == 0:
                with suppress(CosimError, subprocess.TimeoutExpired):
                    self._call("close")
                    self._process.wait(LEAVE_TIMEOUT)
        finally:  # also if Ctrl-C comes meanwhile
            self._end()

    # Requests and replies.

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the slave; what was read of the FMU before is then out of date."""
        limit = CLOSE_TIMEOUT if method == "close" else START_TIMEOUT
        limited = limit if method == "close" or self._step_timeout is not None else None
        while self._pending:  # the request to open
            self._receive(limited)
        self._outputs = None
        self._send(method, *arguments)
        return self._receive(limited)

    def _exchange(self, method: str, *arguments: float) -> None:
        """Step, or do nothing; then read all outputs."""
        self._send(method, *arguments)
        self._outputs = self._receive(self._step_timeout)

    def _send(self, method: str, *arguments: Any) -> None:
        try:
            self._connection.send((method, arguments, self._inputs))
        except OSError:
            self._fail_gone()
        self._inputs = {}
        self._pending += 1

    def _receive(self, limit: float | None) -> Any:
        """Wait for a reply, as long as the process runs and the time limit [s] allows."""
        until = clock.monotonic() + (np.inf if limit is None else limit)
        while not self._connection.poll(min(LOOK_INTERVAL, max(0.0, until - clock.monotonic()))):
            if self._process.poll() is not None:
                self._fail_gone()
            if clock.monotonic() >= until:
                self._fail_late(limit)
        try:
            error, result, messages = self._connection.recv()
        except (EOFError, OSError):
            self._fail_gone()
        self._pending -= 1
        if self._on_message is not None:
            for message in messages:
                self._on_message(*message)
        if error is not None:
            raise _error(*error)
        return result

    def _fail_late(self, limit: float | None) -> NoReturn:
        self._end()
        raise SimulationError(
            f"no answer for {limit:g} s, so its process was ended; a longer --step-timeout gives "
            f"it more time",
            time=self._time,
            instance=self.name,
        )

    def _fail_gone(self) -> NoReturn:
        how = "closed its connection"
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(LEAVE_TIMEOUT)
            how = f"ended with exit code {code}"
            if code < 0:
                how = f"was ended by {_signal_name(-code)}"
        self._end()
        raise SimulationError(f"its process {how}", time=self._time, instance=self.name)

    def _end(self) -> None:
        """Kill the process and all that it has started, once."""
        if self._connection.closed:
            return
        self._connection.close()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _error(message: str, where: dict[str, Any] | None) -> CosimError:
    """Return the error that was raised in the other process; only SimulationErrors have a place."""
    return InputError(message) if where is None else SimulationError(message, **where)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
