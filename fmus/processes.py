"""The processes that the project starts: their environment, and how they end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Final, Self

from .errors import CosimError

# For every Python process: files in the working directory are data and are never imported.
# Unlike `-P`, it also holds for the Pythons that this one starts.
SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}


class Children:
    """Programs that several threads wait for, such as compilers.

    Ctrl-C reaches only the main thread, which would wait for the others to come to their end. As a
    context manager it therefore kills what they still run:

        children = Children()
        with ThreadPoolExecutor(initializer=children.adopt) as pool, children:
            ...  # threads call `run`
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._running: set[subprocess.Popen[str]] = set()
        self._ended = False

    def adopt(self) -> None:
        """Count the programs that this thread runs among them."""
        _children.set(self)

    def run(
        self, command: Sequence[str], folder: Path | None, environment: Mapping[str, str]
    ) -> subprocess.CompletedProcess[str]:
        """Run a program, see the function `run`."""
        with self._lock:
            if self._ended:
                raise CosimError(f"{command[0]} was not started: the command is ending")
            process = subprocess.Popen(
                command,
                cwd=folder,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",  # they may write anything
                start_new_session=True,  # so that it can be killed with all that it has started
            )
            self._running.add(process)
        with process:
            try:
                output, errors = process.communicate()
            finally:
                with self._lock:
                    self._running.discard(process)
        return subprocess.CompletedProcess(command, process.returncode, output, errors)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill those that still run; no other is started."""
        with self._lock:
            self._ended = True
            for process in self._running:
                _kill(process)


_children: ContextVar[Children | None] = ContextVar("children", default=None)


def run(
    command: Sequence[str], folder: Path | None = None, environment: Mapping[str, str] = os.environ
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; if Ctrl-C interrupts this thread, it is killed.

    Args:
        command: The program and its arguments.
        folder: Its working directory.
        environment: Its environment.

    Returns:
        Its exit code and what it wrote.

    Raises:
        CosimError: The thread's `Children` have been ended.
    """
    if (children := _children.get()) is not None:
        return children.run(command, folder, environment)
    # In another thread: the exception of Ctrl-C could come while a program is being started, which
    # nobody would know then.
    children = Children()
    with ThreadPoolExecutor(1) as pool, children:
        return pool.submit(children.run, command, folder, environment).result()


Process = subprocess.Popen[bytes]
Start = tuple[Future[Process], Callable[[], Process]]


def start_from_lasting_thread(start: Callable[[], Process]) -> Process:
    """Start a process from a thread that lasts as long as this process.

    Linux kills a process that asks to end with its parent (PR_SET_PDEATHSIG in prctl(2)) when the
    thread that started it ends, and a session may be opened in one thread and used in another.

    Args:
        start: Starts and returns the process.

    Raises:
        OSError: It cannot be started.
    """
    started: Future[Process] = Future()
    _starts().put((started, start))
    return started.result()


@cache
def _starts() -> SimpleQueue[Start]:
    """What the lasting thread is to start; the first call starts the thread."""
    starts: SimpleQueue[Start] = SimpleQueue()
    Thread(target=_start_each, args=(starts,), name="starts processes", daemon=True).start()
    return starts


def _start_each(starts: SimpleQueue[Start]) -> None:
    while True:
        started, start = starts.get()
        try:
            started.set_result(start())
        except BaseException as error:
            started.set_exception(error)
        del started, start


if hasattr(os, "register_at_fork"):  # a fork has none of its parent's threads
    os.register_at_fork(after_in_child=_starts.cache_clear)


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a process, unless it has ended, and all that it has started."""
    if process.poll() is None:
        if sys.platform == "win32":
            process.kill()
        else:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
