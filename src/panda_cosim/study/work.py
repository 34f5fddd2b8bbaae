"""Gives work to processes of this machine: a crash or a hang costs one call and no other.

A process is this module as a program: `python -m panda_cosim.study.work SOCKET PARENT`. It gets
pickled functions with an argument, one at a time, and answers with values.
"""

from __future__ import annotations

import gc
import os
import platform
import sys
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Final, TypeVar

from ..fmus.processes import STANDARD_ERROR, Child, listen

A = TypeVar("A")
T = TypeVar("T")

MODULE: Final = "panda_cosim.study.work"
# The processes already share the cores, and a fixed order of sums gives the same bits.
ENVIRONMENT: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
MOST_CALLS: Final = 1000  # of a process: memory that FMUs leak is returned
LEAVING: Final = 5.0  # [s] for idle processes to end by themselves, with their temporary folders


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
    """At most `count` processes for one call at a time, with `attempts` for each call.

    A process that has answered waits for another call; if none waits, one is started.
    """

    def __init__(self, count: int, attempts: int = 1) -> None:
        self._attempts, self._threads = attempts, ThreadPoolExecutor(count)
        self._lock = Lock()  # of what follows
        self._idle: list[_Process] = []
        self._busy: set[_Process] = set()
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
                process = self._taken()
                try:
                    value: T = process.call(function, argument, time_limit)
                except TimeoutError:
                    self._end(process)
                    return late(f"took more than {time_limit:g} s and was killed")
                except (EOFError, ConnectionError):
                    process.leave()  # it may not have come to its end yet
                    reason = f"its process ended with {self._end(process)}"
                else:
                    self._keep(process)
                    return value
            return died(reason)

        return self._threads.submit(call)

    def _taken(self) -> _Process:
        with self._lock:
            if self._is_closed:
                raise CancelledError
            process = self._idle.pop() if self._idle else _Process()
            self._busy.add(process)
        return process

    def _keep(self, process: _Process) -> None:
        """Keep a process for another call, unless it has had many."""
        if process.calls == MOST_CALLS:
            process.leave()
            self._end(process)
            return
        with self._lock:
            self._busy.remove(process)
            self._idle.append(process)

    def _end(self, process: _Process) -> str:
        with self._lock:
            self._busy.remove(process)
        code = process.end()
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def __exit__(self, *_: object) -> None:
        """Kill what runs, and start nothing more."""
        with self._lock:
            self._is_closed = True
            for process in self._busy:
                process.kill()  # its thread sees that, and ends it
        try:
            self._threads.shutdown(cancel_futures=True)
            for process in self._idle:
                process.leave()
        finally:  # Ctrl-C may come while they leave
            for process in self._busy.union(self._idle):
                process.end()


class _Process(Child):
    """A process that runs calls; what FMUs print there is no result."""

    def __init__(self) -> None:
        super().__init__("-m", MODULE, output=STANDARD_ERROR, environment=ENVIRONMENT)
        self.calls = 0

    def call(self, function: Callable[[A], T], argument: A, time_limit: float | None) -> T:
        """Run a call, and return its value."""
        self.calls += 1
        self.connection.send((function, argument))
        self.connection.recv()  # it has loaded what the function needs
        if not self.connection.poll(time_limit):
            raise TimeoutError
        value: T = self.connection.recv()
        return value

    def leave(self) -> None:
        """Let it end by itself; idle, it only waits for a call."""
        self.connection.close()
        self.ended(LEAVING)


def main(socket: int, parent: int) -> None:
    """Work until the connection ends."""
    connection = listen(socket, parent)
    with suppress(EOFError, ConnectionError):
        while True:
            function, argument = connection.recv()
            connection.send(None)
            if not gc.get_freeze_count():
                gc.freeze()  # modules, which the search for garbage can leave out
            connection.send(function(argument))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
