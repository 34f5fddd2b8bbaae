"""The process that an isolated FMU runs in; started by `remote_slave.RemoteSlave` alone.

A request is (method, arguments, values of the blocks to set first, by their index). A reply is
(error or None, result, log messages); the result of `step` and `get` is the values of all blocks.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, SimulationError
from ..files.fmu_file import Fmu
from ..processes import end_with
from .system import open_slave

Array = NDArray[np.float64]
Block = tuple[Array, Callable[[int], None]]  # values (1, n), and what sets or gets them


def main(descriptor: int, parent: int) -> None:
    """Serve requests until the other side closes the connection."""
    os.set_inheritable(descriptor, False)  # or a process that the FMU starts would keep it open
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the master handles it, and closes the connection
    end_with(parent)
    with suppress(EOFError, OSError):
        _serve(Connection(descriptor))
    _leave(0)


def _leave(code: int) -> NoReturn:
    """Exit without the clean-up of interpreter and libraries, in which many FMUs crash."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
    os._exit(code)


def _serve(connection: Connection) -> None:
    host, method = Host(), ""
    while method != "close":
        method, arguments, values = connection.recv()
        error, result = None, None
        try:
            result = host.call(method, arguments, values)
        except Exception as raised:
            error = _described(raised)
        messages, host.messages = host.messages, []
        connection.send((error, result, messages))


class Host:
    """Executes requests."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, str, str]] = []
        self._inputs: list[Block] = []
        self._outputs: list[Block] = []

    def call(self, method: str, arguments: Any, values: dict[int, bytes]) -> Any:
        """Set input blocks, then call a method of the slave."""
        for index, numbers in values.items():
            block, put = self._inputs[index]
            block[0] = np.frombuffer(numbers)
            put(0)
        match method:
            case "open":
                name, path = arguments
                self._slave = open_slave(name, Fmu(Path(path)), self._keep)
            case "step":
                self._slave.step(*arguments)
                return self._read()
            case "get":
                return self._read()
            case "get_real":
                return self._slave.get_real(*arguments).tolist()
            case "bind_get" | "bind_set":
                block = np.zeros((1, len(arguments[0])))
                bound = getattr(self._slave, method)(*arguments, block)
                (self._outputs if method == "bind_get" else self._inputs).append((block, bound))
            case _:
                getattr(self._slave, method)(*arguments)
        return None

    def _read(self) -> list[bytes]:
        for _, get in self._outputs:
            get(0)
        return [block[0].tobytes() for block, _ in self._outputs]

    def _keep(self, instance: str, status: str, text: str) -> None:
        self.messages.append((instance, status, text))


def _described(error: Exception) -> tuple[str, dict[str, Any] | None]:
    """An error's message, and the place of a SimulationError."""
    if not isinstance(error, CosimError):
        return f"{type(error).__name__}: {error}", {}
    if not isinstance(error, SimulationError):
        return str(error), None
    place = {"time": error.time, "instance": error.instance, "variable": error.variable}
    return error.message, place
