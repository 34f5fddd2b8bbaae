"""Ends of a run before its time: on a signal, an event or a time limit."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

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
        self.poll()

    def poll(self) -> None:
        """Check the event and the clock; called a few times a second during a run."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):  # an FMU may have taken them over
                if (handler := signal.getsignal(number)) is not None:
                    signal.signal(number, handler)
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
                previous[number] = signal.signal(number, stop.handle)
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
