"""Signals that end a run: they only ask for it, and the run stops between two steps."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from ...fmus.master.algorithm import Master

PATIENCE = 1.0  # [s] after which a second signal ends the process at once


class StopRequest:
    """What signals ask for: that the run stop after the step under way.

    Attributes:
        signal: Number of the signal that came first, or 0.
    """

    def __init__(self) -> None:
        self.signal = 0
        self._came = 0.0
        self._master: Master | None = None

    def watch(self, master: Master) -> None:
        """Tell a master to stop when a signal comes, or has come already."""
        self._master = master
        master.stop_requested = bool(self.signal)

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Note a signal; who asks again after a while is not kept waiting by a step that hangs."""
        if not self.signal:
            self.signal, self._came = number, time.monotonic()
            if self._master is not None:
                self._master.stop_requested = True
        elif time.monotonic() - self._came > PATIENCE:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)


@contextmanager
def stopping_on_signals() -> Iterator[StopRequest]:
    """Turn SIGINT and SIGTERM into a request to stop after the current step.

    A handler that raised would do so inside whatever runs, which may be an FMU.

    Yields:
        The request.
    """
    stop = StopRequest()
    previous: dict[int, Any] = {}
    with suppress(ValueError):  # in a thread other than the main one there is nothing to do
        for number in (int(signal.SIGINT), int(signal.SIGTERM)):
            previous[number] = signal.signal(number, stop.handle)
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
