"""Gives work to processes of this machine: a crash or a hang costs one call and no other.

A process is this module as a program: `python -m panda_cosim.study.work SOCKET PARENT`. It gets
pickled functions with an argument, one at a time, and answers with values. Unlike a process of
`multiprocessing`, it neither runs the caller's script nor takes over its module path. It has its
own session, so that Ctrl-C reaches only the caller, and it ends with the caller.
"""

from __future__ import annotations

import gc
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from typing import Final, TypeVar

from ..fmus.processes import SAFE_PATH, end_with

A = TypeVar("A")
T = TypeVar("T")

MODULE: Final = "panda_cosim.study.work"
# The processes already share the cores, and a fixed order of sums gives the same bits.
ENVIRONMENT: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **SAFE_PATH}
MOST_CALLS: Final = 1000  # of a process: memory that FMUs leak is returned
LEAVING: Final = 5.0  # [s] for idle processes to end by themselves, with their temporary folders
STANDARD_ERROR: Final = 2


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def processor() -> str:
    """Return the processor's model name, by which numerics libraries choose their code."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


class Workers(AbstractContextManager["Workers"]):
    """At most `count` processes for one call at a time, with `attempts` for each call."""

    def __init__(self, count: int, attempts: int = 1) -> None:
        self._attempts = attempts
        self._threads = ThreadPoolExecutor(count)
        self._lock = Lock()  # of what follows
        self._processes: set[_Process] = set()
        self._idle: list[_Process] = []
        self._is_closed = False

    def submit(
        self,
        function: Callable[[A], T],
        argument: A,
        *,
        died: Callable[[str], T],
        late: Callable[[str], T],
        time_limit: float | None = None,
    ) -> Future[T]:
        """Queue a call; `died` and `late` answer for one whose process had to be replaced."""

        def call() -> T:
            reason = ""
            for _ in range(self._attempts):
                process = self._take()
                try:
                    value: T = process.call(function, argument, time_limit)
                except TimeoutError:
                    self._end(process)
                    return late(f"took more than {time_limit:g} s and was killed")
                except (EOFError, ConnectionError):
                    process.leave()  # it may not have come to its end yet
                    reason = f"its process ended with {self._end(process)}"
                else:
                    self._give_back(process)
                    return value
            return died(reason)

        return self._threads.submit(call)

    def _take(self) -> _Process:
        """Return an idle process, or a new one."""
        with self._lock:
            if self._is_closed:
                raise CancelledError
            process = self._idle.pop() if self._idle else _Process()
            self._processes.add(process)
        return process

    def _give_back(self, process: _Process) -> None:
        if process.calls >= MOST_CALLS:
            process.leave()
            self._end(process)
        else:
            with self._lock:
                self._idle.append(process)

    def _end(self, process: _Process) -> str:
        with self._lock:
            self._processes.discard(process)
        return process.end()

    def close(self) -> None:
        """Kill what runs, and start nothing more; a second call does nothing."""
        with self._lock:
            self._is_closed = True
            processes, idle = set(self._processes), list(self._idle)
        for process in processes.difference(idle):
            process.kill()  # its thread sees that, and ends it
        try:
            for process in idle:
                process.leave()
        finally:  # Ctrl-C may come while they leave
            for process in processes:
                process.kill()
            self._threads.shutdown(cancel_futures=True)
            for process in processes:
                process.end()

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self.close()


class _Process:
    """A process that runs calls."""

    def __init__(self) -> None:
        self._connection, there = Pipe()
        self.calls = 0
        socket = there.fileno()
        self._process = subprocess.Popen(
            [sys.executable, "-m", MODULE, str(socket), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=STANDARD_ERROR,  # what FMUs print is no result
            pass_fds=(socket,),
            start_new_session=True,
            env={**os.environ, **ENVIRONMENT},
        )
        there.close()

    def call(self, function: Callable[[A], T], argument: A, time_limit: float | None) -> T:
        """Run a call, and return its value."""
        self.calls += 1
        self._connection.send((function, argument))
        self._connection.recv()  # it has loaded what the function needs
        if not self._connection.poll(time_limit):
            raise TimeoutError
        value: T = self._connection.recv()
        return value

    def kill(self) -> None:
        self._process.kill()

    def leave(self) -> None:
        """Let it end by itself; idle, it only waits for a call."""
        self._connection.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVING)

    def end(self) -> str:
        """End it at once; return how it ended."""
        self.kill()
        self._connection.close()
        code = self._process.wait()
        return f"signal {-code}" if code < 0 else f"exit code {code}"


def main(socket: int, parent: int) -> None:
    """Work until the connection ends."""
    end_with(parent)
    os.set_inheritable(socket, False)  # what an FMU starts must not keep it open
    connection = Connection(socket)
    with suppress(EOFError, ConnectionError):
        while True:
            function, argument = connection.recv()
            connection.send(None)
            if not gc.get_freeze_count():
                gc.freeze()  # modules, which the search for garbage can leave out
            connection.send(function(argument))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
