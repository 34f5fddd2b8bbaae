"""Ends of a run before its time: on a signal, an event or a time limit, and by an FMU's exit()."""

from __future__ import annotations

import atexit
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from ..fmus.errors import SimulationError

if TYPE_CHECKING:  # the command line reads this module first: it must be quick
    from ..fmus.master.master import Master

PATIENCE = 1.0  # [s] after which a second signal ends the process at once


class StopRequest:
    """Asks a run to stop after the current step, such as when another thread's event is set."""

    def __init__(self, event: threading.Event | None = None) -> None:
        self.signal = 0  # number of the one that came first
        self.reason = ""  # what asked for it
        self.is_late = False  # whether that was the time limit
        self._event = event
        self._came = 0.0
        self._deadline = float("inf")
        self._time_limit = 0.0
        self._master: Master | None = None

    @property
    def text(self) -> str | None:
        """Why the run was stopped, or None."""
        return f"stopped by {self.reason}" if self.reason else None

    def watch(self, master: Master, time_limit: float | None = None) -> None:
        """Make a master stop on request, at once if there is one already."""
        self._master = master
        if time_limit is not None:
            self._time_limit, self._deadline = time_limit, time.monotonic() + time_limit
        master.stop_requested = bool(self.reason)

    def poll(self) -> None:
        """Check the event and the clock; called a few times a second during a run."""
        if self._event is not None and self._event.is_set():
            self._ask("request")
        elif time.monotonic() > self._deadline:
            self.is_late |= not self.reason
            self._ask(f"its time limit of {self._time_limit:g} s of wall time")

    def _ask(self, reason: str) -> None:
        self.reason = self.reason or reason
        if self._master is not None:
            self._master.stop_requested = True

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Note a signal; a later second one ends a run that hangs in a step."""
        if not self.signal:
            self.signal, self._came = number, time.monotonic()
            self._ask(signal.Signals(number).name)
        else:
            end_if_late(number, self._came)


def end_if_late(number: int, came: float) -> None:
    """End the process by a second signal, unless the first came just before it."""
    if time.monotonic() - came > PATIENCE:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


@contextmanager
def stopping_on_signals(event: threading.Event | None = None) -> Iterator[StopRequest]:
    """Turn SIGINT and SIGTERM into a request to stop after the current step.

    A handler must not raise: it might do so inside an FMU. Threads other than the main one get no
    signals; there, only the event stops a run.
    """
    stop = StopRequest(event)
    previous: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in (int(signal.SIGINT), int(signal.SIGTERM)):
                previous[number] = signal.getsignal(number)
                signal.signal(number, stop.handle)
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


# An FMU runs in this process, unless it is isolated. If it calls exit(), the process ends as a
# failure. Rows that were flushed before stay, and the recording says that it is incomplete.

_under_way: list[tuple[int, Path | None]] = []  # thread and folder of each run of this process
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_under_way.clear)


@contextmanager
def exit_guard(folder: Path) -> Iterator[None]:
    """Make the process fail if it ends while the block runs."""
    _watch()
    run = (threading.get_ident(), folder.absolute() if folder.name else None)
    _under_way.append(run)
    try:
        yield
    finally:
        if run in _under_way:  # not in a process that was forked since
            _under_way.remove(run)


def _fail(*_: object) -> None:
    if not _under_way:
        return
    for _thread, folder in _under_way:
        if folder is not None:
            with suppress(OSError):  # it holds what was recorded
                folder.rmdir()
        text = f"Error: {folder or 'a run'}: exit() was called, by an FMU for instance, which ends "
        os.write(2, f"{text}the whole process; --isolate gives each FMU its own\n".encode())
    with suppress(Exception):
        sys.stdout.flush()
    os._exit(SimulationError.exit_code)


_handler = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_fail)
_key = ctypes.c_char()  # by whose address the handler is taken back


@cache
def _watch() -> None:
    """Call `_fail` when the process exits: exit() in C does not end Python first."""
    # glibc and macOS; with other C libraries a handler stays, and Python is gone when it is called.
    if sys.platform == "darwin" or "CS_GNU_LIBC_VERSION" in getattr(os, "confstr_names", ()):
        ctypes.CDLL(None)["__cxa_atexit"](_handler, None, ctypes.byref(_key))
        atexit.register(_end_python)


def _end_python() -> None:
    if threading.get_ident() in [thread for thread, _ in _under_way]:
        _fail()
    _under_way.clear()
    ctypes.CDLL(None)["__cxa_finalize"](ctypes.byref(_key))
