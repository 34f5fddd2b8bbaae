"""The process that an isolated FMU runs in; started by `remote_slave.RemoteSlave` alone."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, SimulationError
from ..processes import end_with
from . import protocol
from .fmu import FmuSlave, open_slave
from .fmu_file import Fmu

Array = NDArray[np.float64]
Called = tuple[dict[str, Any], Callable[[], None] | None]  # reply, and a function to call after it


def main(descriptor: int, parent: int) -> None:
    """Serve requests until the other side closes the connection.

    Args:
        descriptor: Number of the inherited socket.
        parent: Process that started this one; when it ends, this one does.
    """
    os.set_inheritable(descriptor, False)  # or a process that the FMU starts would keep it open
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the master handles it, and closes the connection
    end_with(parent)  # even if the FMU hangs
    with suppress(ConnectionError):
        Host(socket.socket(fileno=descriptor)).serve()
    _leave(0)


def _leave(code: int) -> NoReturn:
    """Exit without the clean-up of interpreter and libraries, in which many FMUs crash."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(code)


class Host:
    """Executes requests and replies to them."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._slave: FmuSlave | None = None
        self._messages: list[tuple[str, str, str]] = []
        self._puts: list[tuple[Array, Callable[[int], None]]] = []
        self._gets: list[tuple[Array, Callable[[int], None]]] = []
        self._request = bytearray(protocol.REQUEST.size)

    def serve(self) -> NoReturn:
        """Answer requests until the connection is closed.

        Raises:
            ConnectionError: The other side has closed it.
        """
        while True:
            self._fill(memoryview(self._request))
            kind, mask, length, time, step_size = protocol.REQUEST.unpack_from(self._request)
            text = bytearray(length)
            self._fill(memoryview(text))
            content: dict[str, Any] = {}
            later, failed = None, False
            try:
                self._put(mask)
                if kind == protocol.CALL:
                    content, later = self._call(protocol.unpack(text))
                else:
                    self._advance(kind, time, step_size)
            except Exception as error:
                content, failed = _told(error), True
            self._answer(failed, content)
            if later is not None:
                later()

    def _fill(self, buffer: memoryview) -> None:
        while buffer:
            count = self._connection.recv_into(buffer)
            if not count:
                raise ConnectionError
            buffer = buffer[count:]

    def _put(self, mask: int) -> None:
        offset = protocol.REQUEST.size
        for index, (block, put) in enumerate(self._puts):
            if mask >> index & 1:
                block[:] = np.frombuffer(self._request, np.float64, block.size, offset)
                put(0)
            offset += block.nbytes

    def _advance(self, kind: bytes, time: float, step_size: float) -> None:
        if kind == protocol.STEP:
            self._opened().step(time, step_size)
        for _, get in self._gets:
            get(0)

    def _answer(self, failed: bool, content: dict[str, Any]) -> None:
        if self._messages:
            content["messages"], self._messages = self._messages, []
        text = protocol.pack(content)
        blocks = [block.tobytes() for block, _ in self._gets]
        self._connection.sendall(b"".join((protocol.REPLY.pack(failed, len(text)), *blocks, text)))

    def _call(self, request: dict[str, Any]) -> Called:
        """Execute a request that is not a step; blocks that it adds are not in this reply yet."""
        op, names = request["op"], request.get("names", ())
        buffer = np.zeros(len(names))
        if op == "open":
            self._open(request["name"], Path(request["path"]))
        elif op == "initialize":
            self._opened().initialize(request["values"], request["start"], request["stop"])
        elif op == "set_values":
            self._opened().set_values(request["values"])
        elif op == "get_real":
            return {"values": self._opened().get_real(names).tolist()}, None
        elif op == "bind_get":
            get = self._opened().bind_get(names, buffer[np.newaxis])
            return {}, lambda: self._gets.append((buffer, get))
        elif op == "bind_set":
            put = self._opened().bind_set(names, buffer[np.newaxis])
            return {}, lambda: self._add_put(buffer, put)
        elif op == "close":
            self._opened().close()
        return {}, None

    def _open(self, name: str, path: Path) -> None:
        self._slave = open_slave(name, Fmu(path), self._keep)

    def _keep(self, instance: str, status: str, text: str) -> None:
        self._messages.append((instance, status, text))

    def _add_put(self, buffer: Array, put: Callable[[int], None]) -> None:
        self._puts.append((buffer, put))
        self._request = bytearray(len(self._request) + buffer.nbytes)

    def _opened(self) -> FmuSlave:
        if self._slave is None:
            raise SimulationError("not instantiated")
        return self._slave


def _told(error: Exception) -> dict[str, Any]:
    """Return an error in a form for JSON."""
    if not isinstance(error, CosimError):
        error = SimulationError(f"{type(error).__name__}: {error}")
    if not isinstance(error, SimulationError):
        return {"type": type(error).__name__, "error": str(error)}
    return {
        "type": SimulationError.__name__,
        "error": error.message,
        "where": {"time": error.time, "instance": error.instance, "variable": error.variable},
    }
