"""Ctrl-C and SIGTERM end a command wherever it is; `running.stopping` takes over during a run.

An exception ends the command, so that temporary files are removed on the way. Python prints and
drops an exception that a signal handler raises inside a finalizer or a weakref's callback; it is
then raised again a moment later, elsewhere. A compiled module may drop it without a word while it
is initialized (Cython's do, as they register with `collections.abc`): it waits until that is done.

Python calls a signal's handler when the main thread runs its next line. If a signal comes just
before that thread starts to wait for another one, this would be after the wait: a thread wakes it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import Any

from ..running.stopping import PATIENCE

AGAIN = 0.005  # [s] after which a dropped exception is raised again
WAKE = (0.05, 0.2, 1.0)  # [s] after a signal, and after each other: when the main thread is woken
_LOADERS = {
    function.__code__
    for function in (ExtensionFileLoader.create_module, ExtensionFileLoader.exec_module)
}


class Terminated(BaseException):
    """SIGTERM arrived while no FMU was stepping."""


INTERRUPTS = (KeyboardInterrupt, Terminated)


class _Ending:
    """Raises an exception for the first signal; a later second signal ends the process.

    Signals that come sooner are ignored: the clean-up is under way.
    """

    def __init__(self) -> None:
        self._error: BaseException | None = None
        self._since = 0.0

    def listen(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        if hasattr(signal, "SIGALRM"):  # not on Windows, where a dropped exception stays so
            signal.signal(signal.SIGALRM, self._raise)
            sys.unraisablehook = self._note_dropped
            _wake_for_signals()

    def settle(self) -> None:
        """Raise nothing from now on."""
        self._begin(SystemExit())

    def is_meant(self) -> None:
        """Take a signal as the way to end this command: errors after it are told."""
        self._error = SystemExit()

    @property
    def code(self) -> int:
        """Exit code of a command that a signal has ended; 0: none has."""
        return exit_code(self._error) if isinstance(self._error, INTERRUPTS) else 0

    def _begin(self, error: BaseException) -> None:
        if self._error is None:
            self._error, self._since = error, time.monotonic()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._error is None:
            self._begin(KeyboardInterrupt() if number == signal.SIGINT else Terminated())
            self._raise(number, frame)
        elif time.monotonic() - self._since > PATIENCE:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)

    def _raise(self, _number: int, frame: FrameType | None) -> None:
        if not isinstance(self._error, INTERRUPTS):
            return
        if hasattr(signal, "SIGALRM") and _is_loading(frame):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        else:
            raise self._error

    def _note_dropped(self, dropped: Any) -> None:
        if dropped.exc_value is not None and dropped.exc_value is self._error:
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        else:
            sys.__unraisablehook__(dropped)


def _wake_for_signals() -> None:
    """Start a thread that interrupts what the main thread waits for after each signal."""
    signals, into = os.pipe()
    os.set_blocking(into, False)
    signal.set_wakeup_fd(into, warn_on_full_buffer=False)  # Python writes their numbers into it
    signal.signal(signal.SIGURG, lambda *_: None)  # it only wakes
    main = threading.main_thread().ident or 0

    def wake() -> None:
        while number := os.read(signals, 1):
            if number[0] != signal.SIGURG:
                for seconds in WAKE:
                    time.sleep(seconds)
                    signal.pthread_kill(main, signal.SIGURG)

    threading.Thread(target=wake, name="signals", daemon=True).start()


def _is_loading(frame: FrameType | None) -> bool:
    """Whether a compiled module is being loaded."""
    while frame is not None:
        if frame.f_code in _LOADERS:
            return True
        frame = frame.f_back
    return False


def exit_code(error: BaseException) -> int:
    """Return the exit code of a command that Ctrl-C or SIGTERM has ended."""
    return 128 + (signal.SIGINT if isinstance(error, KeyboardInterrupt) else signal.SIGTERM)


ending = _Ending()

__all__ = ["INTERRUPTS", "Terminated", "ending", "exit_code"]
