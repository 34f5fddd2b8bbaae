"""The command line `panda-cosim`: the program in app.py, its commands in commands/.

Here is what must work before anything else is imported: Ctrl-C and SIGTERM end a command by an
exception, so that temporary files are removed on the way. `run.stopping` takes over during a run.
"""

from __future__ import annotations

import os
import signal
import sys
import time

from . import startup


class Terminated(BaseException):
    """SIGTERM arrived while no FMU was stepping."""

    def __del__(self) -> None:
        """Have the signal sent again if nobody has seen its exception, which a library dropped."""
        ending.dropped()


class _Interrupted(KeyboardInterrupt):
    __del__ = Terminated.__del__


AGAIN = 0.05  # [s] later, when other code runs
INTERRUPTS = (KeyboardInterrupt, Terminated)


class _Ending:
    """Raises an exception for the first signal; a later second signal ends the process.

    Signals that come sooner are ignored: the clean-up is under way.
    """

    def __init__(self) -> None:
        self._number = 0  # of the signal that has ended the command
        self._raises = True
        self._is_seen = False  # the exception, by the program
        self._since = 0.0

    def listen(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        sys.unraisablehook = self._not_raised

    def settle(self) -> None:
        """Raise nothing from now on."""
        if self._raises:
            self._since = time.monotonic()
        self._raises, self._is_seen = False, True

    def is_meant(self) -> None:
        """Take a signal as the way to end this command: errors after it are reported."""
        self._number, self._is_seen = 0, True

    @property
    def code(self) -> int:
        """Exit code of a command that a signal has ended; 0: none has."""
        return self._number and 128 + self._number

    def _handle(self, number: int, _frame: object) -> None:
        if self._raises:
            self._number, self._raises, self._since = number, False, time.monotonic()
            raise _Interrupted if number == signal.SIGINT else Terminated
        from ..run.stopping import end_if_late  # noqa: PLC0415 - the first signal comes before it

        end_if_late(number, self._since)

    def dropped(self) -> None:
        """Send a signal again, unless its exception was seen."""
        if not self._is_seen:
            from threading import Timer  # noqa: PLC0415 - few signals meet such code

            self._raises = True
            Timer(AGAIN, os.kill, (os.getpid(), self._number)).start()

    def _not_raised(self, args: sys.UnraisableHookArgs) -> None:
        """Report what a library drops, but for a signal, which comes again."""
        if not isinstance(args.exc_value, INTERRUPTS):
            sys.__unraisablehook__(args)


def exit_code(error: BaseException) -> int:
    """Return the exit code of a command that Ctrl-C or SIGTERM has ended."""
    return 128 + (signal.SIGINT if isinstance(error, KeyboardInterrupt) else signal.SIGTERM)


ending = _Ending()


def main() -> None:
    """Run the program; the console script's entry."""
    startup.begin()
    try:
        ending.listen()
        from .app import run_program  # noqa: PLC0415 - Ctrl-C may come while this is imported

        run_program()
    except INTERRUPTS as error:
        ending.settle()
        sys.exit(exit_code(error))
