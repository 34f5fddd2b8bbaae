"""The processes that the project starts: their environment, and how they end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from pathlib import Path
from threading import Lock
from typing import Final, Self

from .errors import CosimError

# For every Python process: files in the working directory are data and are never imported.
# `-P` does the same for that Python alone, this also for those that it starts.
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
            except BaseException:
                _kill(process)
                raise
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
    """Run a program to its end; if this thread is interrupted, it is killed.

    Args:
        command: The program and its arguments.
        folder: Its working directory.
        environment: Its environment.

    Returns:
        Its exit code and what it wrote.

    Raises:
        CosimError: The thread's `Children` have been ended.
    """
    return (_children.get() or Children()).run(command, folder, environment)


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a process, unless it has ended, and all that it has started."""
    if process.poll() is None:
        if sys.platform == "win32":
            process.kill()
        else:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
