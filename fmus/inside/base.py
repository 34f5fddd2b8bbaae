"""Base class of the slaves, which work directly in the memory of all values of their FMU.

Two hosts run them. Our own, the FMI layer (`fmus/native`), hands over its memory (`share_values`),
checks values and the order of calls, and calls `start`, `tune`, `advance`, `get_state` and
`set_state`, as `fmus/native/python_host.py` describes. If one of these raises an exception, the FMI
call fails and the exception's text is logged.

PythonFMU's wrapper calls the methods of `Fmi2Slave`, for which the slave keeps a memory of its own.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pythonfmu import variables as types
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.fmi2slave import Fmi2Slave

from ...assets import STEP_SIZE
from ..interface.variables import Interface, Scalar

Array = NDArray[np.float64]
WARNING: Final = 1  # FMI's status
STEP_TOLERANCE: Final = 1e-6  # in internal steps: rounding of communication points
# For each instance, PythonFMU's wrapper loads the script again, and releases its globals once more
# than it acquires them.
_KEPT: list[dict[str, Any]] = []


class SharedSlave(Fmi2Slave):  # type: ignore[misc]  # PythonFMU has no types
    """A slave that works directly in the memory of the FMU's values."""

    interface: ClassVar[Interface]

    def __init_subclass__(cls) -> None:
        """Keep the globals of the class's script."""
        _KEPT.append(vars(sys.modules[cls.__module__]))

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**{"instance_name": "", **arguments})
        self.modelName, self.description = self.interface.model, self.interface.description
        # Statuses and texts for the log; the host takes them after each call.
        self.messages: list[tuple[int, str]] = []
        self._warned: set[str] = set()
        self._start_time, self._is_started = 0.0, False
        self._applied: object = None
        scalars = self.interface.scalars()
        texts = {s.value_reference: str(s.start) for s in scalars if s.variable.kind == "String"}
        self.share_values(np.array([s.start_value() or 0.0 for s in scalars]).data, texts)
        for scalar in scalars:
            self.register_variable(self._described(scalar), nested=False)

    def share_values(self, values: memoryview, texts: dict[int, str]) -> None:
        """Use this memory: doubles (inputs, outputs, parameters), and texts by value reference."""
        self._values = np.frombuffer(values, np.float64)
        first = 0
        self._views: dict[str, Array] = {}
        self._references: dict[str, int] = {}
        for variable in self.interface.variables:
            self._references[variable.name] = first
            self._views[variable.name] = self._values[first : first + variable.size]
            first += variable.size
        inputs = sum(v.size for v in self.interface.of("input"))
        outputs = sum(v.size for v in self.interface.of("output"))
        self._inputs = self._values[:inputs]
        self._outputs = self._values[inputs : inputs + outputs]
        self._texts = texts

    def parameters(self, names: Iterable[str]) -> dict[str, Any]:
        """Values of parameters by their names."""
        return {name: self.parameter(name) for name in names}

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

    def tune(self) -> None:
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

    # What PythonFMU's wrapper calls. An exception becomes fmi2Fatal, which allows no more calls;
    # it is told more clearly than a step that returns False, which FMPy goes on after.

    def _described(self, scalar: Scalar) -> Any:
        """A variable as PythonFMU knows it."""
        variable, is_text = scalar.variable, scalar.variable.kind == "String"
        kind = "Integer" if variable.kind == "Enumeration" else variable.kind
        get, put = self._values.item, self._values.put
        return getattr(types, kind)(
            scalar.name,
            causality=Fmi2Causality[variable.causality],
            description=variable.description,
            initial=Fmi2Initial[variable.initial] if variable.initial else None,
            variability=Fmi2Variability[variable.variability],
            getter=partial(self._texts.get if is_text else get, scalar.value_reference),
            setter=partial(self._texts.__setitem__ if is_text else put, scalar.value_reference),
        )

    def setup_experiment(self, start_time: float, *_others: float | None) -> None:
        """Take the start time [s]."""
        self._start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Start."""
        self._apply_parameters()
        self._is_started = True

    def _apply_parameters(self) -> None:
        """Start from parameters that have changed, or tune the object that runs."""
        parameters = (self._views[v.name].tobytes() for v in self.interface.of("parameter"))
        given = (self._start_time, *parameters, *self._texts.values())
        if given != self._applied:
            (self.tune if self._is_started else partial(self.start, self._start_time))()
            self._applied = given

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Take the whole internal steps up to the end of a communication step."""
        self._apply_parameters()
        if not np.isfinite(self._inputs).all():
            raise ValueError("an input is not finite")
        times = np.array([current_time, current_time + step_size]) - self._start_time
        first, last = np.floor(times / STEP_SIZE + STEP_TOLERANCE).astype(int).tolist()
        if last > first:
            self.advance(last - first)
        return True

    def get_real(self, references: Sequence[int]) -> list[float]:
        """Values of variables; PythonFMU's own method takes ten times as long."""
        self._apply_parameters()
        values: list[float] = self._values.take(references).tolist()
        return values

    def set_real(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables; see `get_real`."""
        self._values.put(references, values)

    def _get_fmu_state(self) -> dict[str, Any]:
        self._apply_parameters()
        return {**super()._get_fmu_state(), "_state": self.get_state().hex()}

    def _set_fmu_state(self, state: Mapping[str, Any]) -> None:
        super()._set_fmu_state(state)
        self._is_started, self._applied = False, None
        self.exit_initialization_mode()
        super()._set_fmu_state(state)  # the outputs, too
        self.set_state(bytes.fromhex(self._state))

    def _get_log_queue(self) -> list[Any]:
        for status, text in self.messages:
            self.log(text.replace("%", "%%"), Fmi2Status(status))
        self.messages.clear()
        queue: list[Any] = super()._get_log_queue()
        return queue
