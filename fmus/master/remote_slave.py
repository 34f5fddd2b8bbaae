"""An FMU in a process of its own, whose crash does not affect this one."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, InputError, SimulationError
from ..processes import SAFE_PATH, start_from_lasting_thread
from . import protocol
from .fmu import Value
from .fmu_file import Fmu

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
        on_message: Called with each log message of status warning or worse, as
            (instance, status, text).
        step_timeout: Wall time that a step may take [s]; None: unlimited. After it the process is
            killed.

    Raises:
        InputError: This platform is not supported.
        SimulationError: The process could not be started.
    """

    def __init__(
        self,
        name: str,
        fmu: Fmu,
        on_message: Callable[[str, str, str], None] | None = None,
        step_timeout: float | None = None,
    ) -> None:
        if not hasattr(socket, "AF_UNIX") or sys.platform == "win32":
            raise InputError("--isolate: not on this platform; must be Linux or another Unix")
        self.name = name
        self.fmu = fmu
        self._on_message = on_message
        self._step_timeout = step_timeout
        self._limit: float | None = None  # on the wait for the next reply [s]
        self._time: float | None = None  # of the present step [s]
        self._puts: list[Array] = []
        self._gets: list[Array] = []
        self._dirty = 0  # one bit for each block that has been put since the last step
        self._fresh = False  # whether the values of the last reply are up to date
        self._pending = 0  # requests that have no reply yet
        self._resize()
        self._start()
        self._send(protocol.CALL, {"op": "open", "name": name, "path": str(fmu.path.absolute())})

    def _start(self) -> None:
        here, there = socket.socketpair()
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
            here.close()
            raise SimulationError(
                f"no process could be started: {error.strerror}", instance=self.name
            ) from error
        finally:
            there.close()
        self._connection = here
        self._connection.settimeout(min(LOOK_INTERVAL, self._step_timeout or LOOK_INTERVAL))

    def initialize(self, start_values: Mapping[str, Value], start: float, stop: float) -> None:
        """Set start values and go through initialization, see `FmuSlave.initialize`."""
        self._call("initialize", values=dict(start_values), start=start, stop=stop)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables once, see `FmuSlave.set_values`."""
        self._call("set_values", values=dict(values))

    def get_real(self, names: Sequence[str]) -> Array:
        """Read Real variables once, see `FmuSlave.get_real`."""
        return np.array(self._call("get_real", names=list(names))["values"], dtype=np.float64)

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that reads variables into a row, see `FmuSlave.bind_get`."""
        _check_block(names, block)
        self._call("bind_get", names=list(names))
        self._gets.append(np.zeros(len(names)))
        self._resize()
        index = len(self._gets) - 1

        def read(row: int) -> None:
            if not self._fresh:
                self._exchange(protocol.GET)
            block[row] = self._gets[index]

        return read

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Make a function that writes variables from a row, see `FmuSlave.bind_set`."""
        _check_block(names, block)
        if len(self._puts) == protocol.MAX_BLOCKS:
            raise ValueError(f"{protocol.MAX_BLOCKS} blocks of inputs are bound already")
        self._call("bind_set", names=list(names))
        self._puts.append(np.zeros(len(names)))
        self._resize()
        index, bit = len(self._puts) - 1, 1 << (len(self._puts) - 1)

        def write(row: int) -> None:
            self._puts[index][:] = block[row]
            self._dirty |= bit
            self._fresh = False

        return write

    def step(self, time: float, step_size: float) -> None:
        """Advance by one communication step, see `FmuSlave.step`.

        Raises:
            SimulationError: The FMU does not complete the step, its process has ended, or the
                step has taken too long.
        """
        self._time, self._limit = time, self._step_timeout
        self._exchange(protocol.STEP, time, step_size)

    def close(self) -> None:
        """Free the instance and end the process, in any state. May be called twice."""
        try:
            if self._process.returncode is None and self._pending == 0:
                with suppress(CosimError):
                    self._call("close")
                    self._connection.close()
                    self._has_ended(LEAVE_TIMEOUT)
        finally:  # also if Ctrl-C comes meanwhile
            self._end()

    # Requests and replies.

    def _resize(self) -> None:
        """Place the blocks one after the other in a request and in a reply."""
        self._put_all, self._puts = _side_by_side(self._puts, protocol.REQUEST.size)
        self._get_all, self._gets = _side_by_side(self._gets, protocol.REPLY.size)
        self._fresh = False

    def _call(self, op: str, **arguments: Any) -> Any:
        limit = CLOSE_TIMEOUT if op == "close" else START_TIMEOUT
        self._limit = limit if op == "close" or self._step_timeout is not None else None
        self._receive()  # the reply to the request to open, which is still outstanding
        self._send(protocol.CALL, {"op": op, **arguments})
        self._fresh = False
        return self._receive()

    def _exchange(self, kind: bytes, time: float = 0.0, step_size: float = 0.0) -> None:
        self._send(kind, None, time, step_size)
        self._receive()
        self._fresh = True

    def _send(self, kind: bytes, content: Any, time: float = 0.0, step_size: float = 0.0) -> None:
        text = protocol.pack(content)
        protocol.REQUEST.pack_into(self._put_all, 0, kind, self._dirty, len(text), time, step_size)
        self._dirty = 0
        self._transfer(self._put_all + text if text else self._put_all, self._connection.send)
        self._pending += 1

    def _receive(self) -> Any:
        """Wait for the reply to each request; return the last one's text."""
        content: Any = {}
        while self._pending:
            self._transfer(self._get_all, self._connection.recv_into)
            failed, length = protocol.REPLY.unpack_from(self._get_all)
            self._pending -= 1
            if length:
                text = bytearray(length)
                self._transfer(text, self._connection.recv_into)
                content = protocol.unpack(text)
                self._tell(content.get("messages", ()))
            if failed:
                raise _error(content)
        return content

    def _transfer(self, whole: bytearray, move: Callable[[memoryview], int]) -> None:
        """Send or receive all bytes, as long as the process runs and the time limit allows."""
        waited, buffer = 0.0, memoryview(whole)
        while buffer:
            try:
                count = move(buffer)
            except TimeoutError:
                waited += self._connection.gettimeout() or 0.0
                if self._has_ended():
                    self._fail_gone()
                if self._limit is not None and waited >= self._limit:
                    self._fail_late(self._limit)
                continue
            except OSError:
                count = 0
            if not count:
                self._fail_gone()
            buffer = buffer[count:]

    def _tell(self, messages: Sequence[Sequence[str]]) -> None:
        if self._on_message is not None:
            for instance, status, text in messages:
                self._on_message(instance, status, text)

    def _fail_late(self, limit: float) -> NoReturn:
        self._end()
        raise SimulationError(
            f"no answer for {limit:g} s, so its process was ended; a longer --step-timeout gives "
            f"it more time",
            time=self._time,
            instance=self.name,
        )

    def _fail_gone(self) -> NoReturn:
        ended = self._has_ended(LEAVE_TIMEOUT)
        self._end()
        code = self._process.returncode
        if not ended:
            how = "closed its connection"
        elif code < 0:
            how = f"was ended by {_signal_name(-code)}"
        else:
            how = f"ended with exit code {code}"
        raise SimulationError(f"its process {how}", time=self._time, instance=self.name)

    def _has_ended(self, patience: float = 0.0) -> bool:
        """Whether the process has ended; leaves it a zombie, so that its id is not reused."""
        until = clock.monotonic() + patience
        while True:
            flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
            if os.waitid(os.P_PID, self._process.pid, flags) is not None:
                return True
            if clock.monotonic() >= until:
                return False
            clock.sleep(0.002)

    def _end(self) -> None:
        """Kill the process and all that it has started."""
        self._connection.close()
        if self._process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def _side_by_side(blocks: Sequence[Array], offset: int) -> tuple[bytearray, list[Array]]:
    """Return a buffer, and views of it that hold the blocks' values after an offset."""
    buffer = bytearray(offset + sum(block.nbytes for block in blocks))
    views = []
    for block in blocks:
        view = np.frombuffer(buffer, np.float64, block.size, offset)
        view[:] = block
        views.append(view)
        offset += block.nbytes
    return buffer, views


def _check_block(names: Sequence[str], block: Array) -> None:
    if block.shape[1:] != (len(names),):
        raise ValueError(f"block of shape {block.shape} for {len(names)} variables")


def _error(content: Mapping[str, Any]) -> CosimError:
    """Return the error that was raised in the other process."""
    if content["type"] == InputError.__name__:
        return InputError(content["error"])
    return SimulationError(content["error"], **content.get("where", {}))


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
