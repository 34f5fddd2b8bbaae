"""Base class of the slaves, which work directly in the memory of the FMU's values.

The FMI layer (`fmus/native`) keeps the values, checks them and the order of calls, and calls
`start`, `tune`, `advance`, `get_state` and `set_state`, as `fmus/native/python_host.py` describes.
If one of these raises an exception, the FMI call fails and the exception's text is logged.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ..interface.variables import Interface

Array = NDArray[np.float64]
TICK: Final = STEP_SIZE  # [s] internal step
WARNING: Final = 1  # FMI's status
LOG_CATEGORIES: Final = {
    "logStatusWarning": "Values that were out of range and have been clamped.",
    "logStatusDiscard": "Steps that were rejected, with the reason.",
    "logStatusError": "Failures, with cause and traceback.",
    "logStatusFatal": "Failures after which the instance cannot be used.",
    "logAll": "All messages.",
}


class SharedSlave(ABC):
    """A slave that works directly in the memory of the FMU's values."""

    interface: ClassVar[Interface]

    def __init__(self, instance_name: str = "", resources: str = "", visible: bool = False) -> None:
        # Statuses and texts for the log; the FMI layer takes them after each call.
        self.messages: list[tuple[int, str]] = []
        self._warned: set[str] = set()

    def share_values(self, values: memoryview, texts: dict[int, str]) -> None:
        """Use this memory: doubles (inputs, outputs, parameters), and texts by value reference."""
        memory = np.frombuffer(values, np.float64)
        first = 0
        self._views: dict[str, Array] = {}
        self._references: dict[str, int] = {}
        for variable in self.interface.variables:
            self._references[variable.name] = first
            self._views[variable.name] = memory[first : first + variable.size]
            first += variable.size
        inputs = sum(v.size for v in self.interface.of("input"))
        outputs = sum(v.size for v in self.interface.of("output"))
        self._inputs, self._outputs = memory[:inputs], memory[inputs : inputs + outputs]
        self._texts = texts

    def parameter(self, name: str) -> float | tuple[float, ...] | bool | str:
        """Value of a parameter, by its name without indices."""
        variable = self.interface.variable(name)
        if variable.kind == "String":
            return self._texts[self._references[variable.name]]
        values: list[float] = self._views[variable.name].tolist()
        if variable.kind == "Enumeration":
            return variable.choices[int(values[0]) - 1]
        if variable.kind == "Boolean":
            return bool(values[0])
        return tuple(values) if variable.shape else values[0]

    def warn_once(self, key: str, message: str) -> None:
        """Log a warning, unless one with this key has been logged."""
        if key not in self._warned:
            self._warned.add(key)
            self.messages.append((WARNING, message))

    def start(self, start_time: float) -> None:
        """Make the object from the parameters, at a time [s]; the inputs keep their values."""
        inputs = self._inputs.copy()
        self._warned.clear()
        self.rebuild(start_time)
        self._inputs[:] = inputs

    @abstractmethod
    def rebuild(self, start_time: float) -> None:
        """Make a new object from the parameters, and write the outputs at the start."""

    def tune(self) -> None:  # noqa: B027 - a slave without tunable parameters needs none
        """Use the new values of tunable parameters."""

    @abstractmethod
    def advance(self, count: int) -> None:
        """Take `count` internal steps, and write the outputs at the end of the last one."""

    @abstractmethod
    def get_state(self) -> bytes:
        """Everything that the next step depends on, apart from the values."""

    @abstractmethod
    def set_state(self, state: bytes) -> None:
        """Restore what `get_state` returned; the values have been restored before."""
