"""Saves a run if an FMU calls exit(), and makes the process end with a failure.

An FMU runs in this process, unless it is isolated. Its exit() call would set the command's
exit code, even to 0, and rows not yet flushed would be lost.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from ...fmus.errors import SimulationError
from ...fmus.master.fmu import FmuSlave
from ...fmus.master.master import Master
from ..recording import AnyRecorder

PATIENCE = 2.0  # [s] for a run to save itself if another thread ends the process
OWN = "called exit(), which ends the whole process; with --isolate it has a process of its own"
OTHER = "exit() was called in another thread{}, which ends the whole process"

_under_way: list[ExitGuard] = []


class ExitGuard:
    """Saves one run if the process ends during it.

    Args:
        folder: The run's folder, for the message.
        saved: Called when the recording has been closed after a failure.
    """

    def __init__(self, folder: Path, saved: Callable[[], None] = lambda: None) -> None:
        self._folder = folder
        self._saved = saved
        self._process, self._thread = os.getpid(), threading.get_ident()
        self._master: Master | None = None
        self._recorder: AnyRecorder | None = None
        self._error: SimulationError | None = None
        self._ended = threading.Event()
        self._take_back: list[Callable[[], None]] = []

    def arm(self) -> None:
        """Start watching for exits."""
        _under_way.append(self)
        self._take_back = [_at_exit(_end_process)]
        atexit.register(_end_python)

    def watch(self, master: Master, recorder: AnyRecorder) -> None:
        """Save these as well."""
        self._master, self._recorder = master, recorder
        # Registered again, as handlers run last to first: saving needs libraries loaded since then.
        self._take_back.append(_at_exit(_end_process))

    def check(self) -> None:
        """Fail if another thread has called exit().

        Raises:
            SimulationError: It has.
        """
        if self._error is not None:
            raise self._error

    def disarm(self) -> None:
        """End the guard: later exits no longer concern this run."""
        self._ended.set()
        if self._error is not None:
            clock.sleep(2 * PATIENCE)  # the other thread reports it and ends the process
        self.forget()
        if not _under_way:
            atexit.unregister(_end_python)

    def forget(self) -> None:
        """Stop watching for exits."""
        _under_way.remove(self)
        for take_back in self._take_back:
            take_back()

    @property
    def is_here(self) -> bool:
        """Whether the run belongs to this thread."""
        return self._thread == threading.get_ident()

    @property
    def is_forked(self) -> bool:
        """Whether this process is a fork of the run's."""
        return self._process != os.getpid()

    def fail(self) -> str:
        """Note the failure and ask the run to stop; return the message."""
        fmu = _called_fmu(self._thread)
        # Another thread may be that of any FMU, not only of the one that is being stepped.
        meanwhile = f" while FMU {fmu!r} was running" if fmu else ""
        self._error = SimulationError(
            OWN if self.is_here else OTHER.format(meanwhile),
            time=self._master.time if self._master is not None else None,
            instance=fmu if self.is_here else "",
        )
        kept = f"; the recording up to then is in {self._folder}" if self._recorder else ""
        if self._master is not None:
            self._master.stop_requested = True
        return f"Error: {self._error}{kept}\n"

    def save(self, until: float) -> None:
        """Close the recording, unless the run does so itself before a deadline."""
        if not self.is_here and self._ended.wait(max(until - clock.monotonic(), 0.0)):
            return
        if self._master is not None and self._recorder is not None:
            with suppress(SimulationError):
                self._master.flush()
            self._recorder.close(complete=False, reason=f"SimulationError: {self._error}")
            self._saved()


@contextmanager
def exit_guard(folder: Path, saved: Callable[[], None] = lambda: None) -> Iterator[ExitGuard]:
    """Guard a run against FMUs that end the process, see `ExitGuard`."""
    guard = ExitGuard(folder, saved)
    guard.arm()
    try:
        yield guard
    finally:
        guard.disarm()


def _end_process() -> None:
    """Save all runs and end as a failure; called by the C library when the process exits."""
    runs = [run for run in _under_way if not run.is_forked]
    if not runs:
        return
    try:
        runs.sort(key=lambda run: not run.is_here)
        said = [run.fail() for run in runs]
        until = clock.monotonic() + PATIENCE
        for run in runs:
            with suppress(Exception):  # save the other runs, too
                run.save(until)
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os.write(2, "".join(said).encode(errors="replace"))
    finally:
        os._exit(SimulationError.exit_code)


def _end_python() -> None:
    """Do the same if an FMU ends Python; if Python ends by itself, leave runs alone."""
    if any(run.is_here for run in _under_way):
        _end_process()
    for run in list(_under_way):
        run.forget()


def _called_fmu(thread: int) -> str:
    """Name of the FMU that a thread is executing, or ""."""
    frame = sys._current_frames().get(thread)
    while frame is not None:
        slave = frame.f_locals.get("self")
        if isinstance(slave, FmuSlave):
            return slave.name
        frame = frame.f_back
    return ""


@cache
def _c_library() -> ctypes.CDLL:
    """The C library of this process; cached, as loading it is slow."""
    return ctypes.CDLL(None)


def _at_exit(handler: Callable[[], None]) -> Callable[[], None]:
    """Have the C library call a function when the process exits.

    Python's `atexit` is not enough: a call of exit() from C does not end Python first.

    Returns:
        A function that undoes this; it must be called before Python ends.
    """
    if sys.platform != "darwin" and "CS_GNU_LIBC_VERSION" not in getattr(os, "confstr_names", ()):
        return lambda: None  # other C libraries offer no way to undo it
    library = _c_library()
    armed = True
    # Ref: Itanium C++ ABI, 3.3.6.3: a handler is registered for a key, any address, and
    # __cxa_finalize(key) calls and removes it.
    key = ctypes.create_string_buffer(1)

    def call(_: object) -> None:
        if armed:
            handler()

    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(call)

    def take_back() -> None:
        nonlocal armed
        armed = False
        library["__cxa_finalize"](key)
        del _kept[id(key)]

    _kept[id(key)] = (key, function)
    library["__cxa_atexit"](function, None, key)
    return take_back


_kept: dict[int, object] = {}  # what the C library points to
