"""How a slave tells what went wrong: to the importer's log, and to standard error.

The wrapper around a PythonFMU slave crashes a host when a callback raises twice, so nothing
leaves a callback: a failure is logged with its cause and its traceback, kept, and reported as
the status of the next step (fmi2Discard, which every importer survives).
"""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from typing import Any, ClassVar, Final

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

LOG_CATEGORIES: Final = {
    "logStatusWarning": "Values that were out of range and have been clamped.",
    "logStatusDiscard": "Steps that were refused, with the reason.",
    "logStatusError": "Failures, with cause and traceback.",
    "logStatusFatal": "Failures after which the instance cannot be used.",
    "logAll": "All messages.",
}
NOT_READY: Final = "it has not been initialized"


class SlaveError(Exception):
    """A step or a value that a slave refuses; the message is for the user."""


class RefusalError(SlaveError):
    """A step that a slave refuses and has not begun: the next one may be taken."""


class TellingSlave(Fmi2Slave):  # type: ignore[misc]  # pythonfmu ships no types
    """A slave that logs failures and remembers the first of them."""

    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._warned: set[str] = set()
        self._failure: str | None = None
        self._blocked: str | None = NOT_READY  # why the next step would be refused

    def _refuse(self, refusal: RefusalError, where: str) -> None:
        """Log why a step is refused."""
        self._tell(f"{where}: {refusal}", Fmi2Status.discard, "logStatusDiscard")

    def _fail(self, error: BaseException, where: str) -> None:
        """Log a failure and remember it; from now on steps are refused."""
        told = isinstance(error, (SlaveError, ValueError))
        cause = str(error) if told else f"{type(error).__name__}: {error}"
        if self._failure is None:
            self._set_failure(f"{where}: {cause}")
        self._tell(f"{where}: {cause}", Fmi2Status.error, "logStatusError")
        if not told:
            trace = "".join(traceback.format_exception(error))
            self._tell(trace, Fmi2Status.error, "logStatusError")

    def _set_failure(self, failure: str | None) -> None:
        self._failure = failure
        self._blocked = failure and f"not stepped after an earlier failure: {failure}"

    def _warn_once(self, key: str, message: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            self._tell(message, Fmi2Status.warning, "logStatusWarning")

    def _tell(self, message: str, status: Fmi2Status, category: str) -> None:
        """Log to the importer, and to standard error since its logging may be off."""
        with contextlib.suppress(Exception):  # a host may have no standard error
            if os.environ.get("PANDA_COSIM_STDERR", "1") != "0":
                print(f"{self.instance_name} ({self.modelName}): {message}", file=sys.stderr)
        # The importer passes it on as a printf format.
        self.log(message.replace("%", "%%"), status, category)
