"""The log messages of FMUs: which instance each is from, and which are kept and passed on."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import count
from pathlib import PurePath
from typing import Final
from weakref import WeakValueDictionary

OnMessage = Callable[[str, str, str], None]  # with instance, status and text
OK, WARNING, ERROR, FATAL = 0, 1, 3, 4
STATUS: Final = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
LAST_MESSAGES: Final = 20
MOST_MESSAGES: Final = 100  # per instance; some FMUs warn at every step

_TRACEBACK: Final = "Traceback (most recent call last):"
_FRAME: Final = re.compile(r'^ +File "([^"\n]*)", line (\d+).*$', re.MULTILINE)

# By the environment pointer that each instance gets and hands back with its messages.
_logs: WeakValueDictionary[int, MessageLog] = WeakValueDictionary()
_numbers = count(1)


def receive(number: int | None, name: bytes, status: int, text: bytes) -> None:
    """Pass a message on to the log of its instance, found by environment or name."""
    log = _logs.get(number or 0)
    if log is None:  # the FMU does not hand back its environment
        called = (name or b"").decode("utf-8", "replace")
        log = next((each for each in list(_logs.values()) if each.instance == called), None)
    if log is not None:
        log.take(status, (text or b"").decode("utf-8", "replace").strip())


def without_traceback(message: str) -> str:
    """Return what a message says before a traceback, and the traceback's place and error."""
    before, _, trace = message.partition(_TRACEBACK)
    frames = list(_FRAME.finditer(trace))
    if not frames:
        return message
    # The lines of code after a frame are indented; the error is not.
    rest = trace[frames[-1].end() :].splitlines()
    error = " ".join(line for line in rest if line and not line.startswith(" "))
    file, line = frames[-1].groups()
    return f"{before}{PurePath(file).name}, line {line}: {error}"


class MessageLog:
    """The messages of one instance; those of status warning or worse are passed on."""

    def __init__(self, instance: str, on_message: OnMessage | None = None) -> None:
        self.instance = instance
        self.messages: list[str] = []  # the last ones of status warning or worse
        self.worst = OK
        self.number = next(_numbers)  # environment pointer that the FMU hands back
        self._on_message = on_message
        self._passed_on: set[str] = set()
        _logs[self.number] = self

    @property
    def cause(self) -> str:
        """The last message that is not a traceback, else the end of the last; "" if none is."""
        plain = (m for m in reversed(self.messages) if _TRACEBACK not in m)
        return next(plain, without_traceback(self.messages[-1]) if self.messages else "")

    def take(self, status: int, message: str) -> None:
        """Keep a message, and pass it on."""
        if status > OK:
            self.worst = max(self.worst, status)
            self.messages = [*self.messages[1 - LAST_MESSAGES :], message]
            self._pass_on(STATUS[min(status, 5)], message)

    def _pass_on(self, status: str, message: str) -> None:
        """Pass a message on, unless it is a repetition or one too many."""
        number = len(self._passed_on)
        if self._on_message is None or number > MOST_MESSAGES or message in self._passed_on:
            return
        if number == MOST_MESSAGES:
            message = "further messages are left out"
        self._passed_on.add(message)
        self._on_message(self.instance, status, message)
