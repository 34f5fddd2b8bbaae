"""What stands in for a slave whose code cannot start: it instantiates, and says why not."""

from __future__ import annotations

import contextlib
import math
import sys
from typing import Any

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave


class StandIn(Fmi2Slave):  # type: ignore[misc]  # pythonfmu ships no types
    """A slave that refuses to be stepped, with the reason in the log.

    Failing to instantiate would show the importer no reason at all.
    """

    reason = ""
    trace = ""

    def enter_initialization_mode(self) -> None:
        """Fmi2EnterInitializationMode: tells the reason."""
        self._tell()

    def do_step(self, _current_time: float, _step_size: float) -> bool:
        """Fmi2DoStep: refused."""
        self._tell()
        return False

    def get_real(self, vrs: list[int]) -> list[float]:
        """Fmi2GetReal: nothing is known."""
        return [math.nan] * len(vrs)

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Fmi2GetBoolean."""
        return [False] * len(vrs)

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Fmi2GetInteger."""
        return [0] * len(vrs)

    def get_string(self, vrs: list[int]) -> list[str]:
        """Fmi2GetString."""
        return [""] * len(vrs)

    def _ignore(self, vrs: list[int], values: list[Any]) -> None:
        """Take a value and forget it; the next step is refused anyway."""

    set_real = set_boolean = set_integer = set_string = _ignore

    def _get_fmu_state(self) -> bytes:
        return b""

    def _set_fmu_state(self, state: bytes) -> None:
        pass

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    def _tell(self) -> None:
        for text in (self.reason, self.trace):
            self.log(text.replace("%", "%%"), Fmi2Status.error, "logStatusError")
            with contextlib.suppress(Exception):  # a host without standard error
                print(f"{self.instance_name}: {text}", file=sys.stderr)


def stand_in(reason: str, trace: str) -> type[StandIn]:
    """Return a class of slaves that tell a reason and where it arose."""
    return type("StandInWithReason", (StandIn,), {"reason": reason, "trace": trace})
