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

AGAIN = 0.05  # [s] after which a signal comes again, when other code runs


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
        sys.unraisablehook = self._not_raised

    def settle(self) -> None:
        """Raise nothing from now on."""
        if self._error is None:
            self._error, self._since = SystemExit(), time.monotonic()

    def is_meant(self) -> None:
        """Take a signal as the way to end this command: errors after it are reported."""
        self._error = SystemExit()

    @property
    def code(self) -> int:
        """Exit code of a command that a signal has ended; 0: none has."""
        return exit_code(self._error) if isinstance(self._error, INTERRUPTS) else 0

    def _handle(self, number: int, _frame: object) -> None:
        if self._error is None:
            self._error = KeyboardInterrupt() if number == signal.SIGINT else Terminated()
            self._since = time.monotonic()
            raise self._error
        from ..run.stopping import end_if_late  # noqa: PLC0415 - the first signal comes before it

        end_if_late(number, self._since)

    def _not_raised(self, args: sys.UnraisableHookArgs) -> None:
        """Send a signal again whose exception met code that has no caller, as in a C library."""
        if self._error is None or args.exc_value is not self._error:
            sys.__unraisablehook__(args)
            return
        from threading import Timer  # noqa: PLC0415 - few signals meet such code

        number, self._error = exit_code(self._error) - 128, None
        Timer(AGAIN, os.kill, (os.getpid(), number)).start()


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
        sys.exit(exit_code(error))
