"""What both slaves share: values in one flat buffer, state, and errors that get told.

The wrapper around a PythonFMU slave crashes a host when a callback raises twice, so nothing
leaves a callback here: a failure is logged with its cause and its traceback, kept, and
reported as the status of the next step (fmi2Discard, which every importer survives).
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
import traceback
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from fmus.interface import Interface, Scalar

TICK: Final = 0.001  # [s] internal step; communication steps are whole multiples
TICK_TOLERANCE: Final = 1e-6  # [1] of a tick; a sum of 1e6 floating-point steps stays within
STATE_MAGIC: Final = b"PCS1"
LOG_CATEGORIES: Final = {
    "logStatusWarning": "Values that were out of range and have been clamped.",
    "logStatusDiscard": "Steps that were refused, with the reason.",
    "logStatusError": "Failures, with cause and traceback.",
    "logStatusFatal": "Failures after which the instance cannot be used.",
    "logAll": "All messages.",
}
Array = NDArray[np.float64]
Read = Callable[[], list[float]]
Write = Callable[..., None]
LARGEST: Final = sys.float_info.max  # bound of what is only finite


class SlaveError(Exception):
    """A step or a value that a slave refuses; the message is for the user."""


class _Plan(NamedTuple):
    """How a list of value references maps to the buffer; found out once, then used as it is.

    Attributes:
        references: The list.
        read: Returns the values as a list.
        write: Takes the values as arguments.
        parameters: Whether a parameter is among them.
    """

    references: list[int]
    read: Read
    write: Write
    parameters: bool


class BufferedSlave(Fmi2Slave):  # type: ignore[misc]  # pythonfmu ships no types
    """A slave whose Real variables are one array, indexed by value reference.

    Subclasses say what interface they have, and translate between it and a plain object in
    `_rebuild`, `_retune` and `_advance`.
    """

    interface: ClassVar[Interface]
    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.modelName = self.interface.model
        scalars = self.interface.scalars()
        self._scalars: dict[str, list[Scalar]] = {
            kind: [s for s in scalars if s.variable.kind == kind]
            for kind in ("Real", "Boolean", "String")
        }
        reals = self._scalars["Real"]
        self._reals = np.array([s.start if s.start is not None else 0.0 for s in reals])
        self._booleans = [bool(s.start) for s in self._scalars["Boolean"]]
        self._strings = [str(s.start) for s in self._scalars["String"]]
        self._inputs = self._block("input")
        self._outputs = self._block("output")
        self._parameters = self._block("parameter")
        inputs = reals[: self._inputs.size]
        self._low = np.array([-LARGEST if s.minimum is None else s.minimum for s in inputs])
        self._high = np.array([LARGEST if s.maximum is None else s.maximum for s in inputs])
        self._sound = np.ones((2, len(inputs)), dtype=bool)
        self._above, self._below = self._sound
        self._all_sound = self._sound.tobytes()
        self._plans: dict[tuple[int, int], _Plan] = {}
        self._got = self._put = self._plan([])
        self._step_size, self._step_ticks = 0.0, 0
        self._ticks = 0
        self._stale, self._untuned = True, False
        self._warned: set[str] = set()
        self._failure: str | None = None

    def _block(self, causality: str) -> Array:
        """View of the Reals of one causality, which stand side by side."""
        where = [
            s.value_reference for s in self._scalars["Real"] if s.variable.causality == causality
        ]
        return self._reals[where[0] : where[-1] + 1]

    # What a subclass does.

    @abstractmethod
    def _rebuild(self) -> None:
        """Make the object anew from the parameters."""

    def _retune(self) -> None:
        """Take over tunable parameters that have changed."""

    @abstractmethod
    def _advance(self, ticks: int) -> None:
        """Advance the object by a number of ticks."""

    @abstractmethod
    def _object_state(self) -> Array:
        """Return all that the object's next step depends on."""

    @abstractmethod
    def _restore_object(self, state: Array) -> None:
        """Restore what `_object_state` returned."""

    def parameter(self, name: str) -> float | tuple[float, ...] | bool | str:
        """Value of a parameter, by its name without indices."""
        variable = self.interface.variable(name)
        first = next(
            s.value_reference for s in self._scalars[variable.kind] if s.variable is variable
        )
        if variable.kind == "String":
            return self._strings[first]
        if variable.kind == "Boolean":
            return self._booleans[first]
        values = self._reals[first : first + variable.size].tolist()
        return tuple(values) if variable.shape else float(values[0])

    # FMI callbacks. None of them may raise.

    def enter_initialization_mode(self) -> None:
        """Fmi2EnterInitializationMode."""

    def exit_initialization_mode(self) -> None:
        """Fmi2ExitInitializationMode: the object is made from the parameters."""
        self._refresh()

    def terminate(self) -> None:
        """Fmi2Terminate."""

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Fmi2DoStep; False (fmi2Discard) after a failure, with its reason logged."""
        try:
            if self._failure is not None:
                raise SlaveError(f"not stepped after an earlier failure: {self._failure}")
            if step_size != self._step_size:
                self._step_size, self._step_ticks = step_size, self._whole_ticks(step_size)
            ticks = self._step_ticks
            # In range means finite, too: NaN fails each comparison, infinity one.
            np.greater_equal(self._inputs, self._low, self._above)
            np.less_equal(self._inputs, self._high, self._below)
            if self._sound.tobytes() != self._all_sound:
                self._check_inputs()
            if self._stale:
                self._rebuild_now()
            if self._untuned:
                self._retune()
                self._untuned = False
            self._advance(ticks)
            self._ticks += ticks
        except Exception as error:
            self._fail(error, f"t = {current_time:.6g} s")
            return False
        return True

    def get_real(self, vrs: list[int]) -> list[float]:
        """Fmi2GetReal."""
        if self._stale:
            self._refresh()
        try:
            if vrs != self._got.references:
                self._got = self._plan(vrs)
            return self._got.read()
        except Exception as error:
            self._fail(error, "fmi2GetReal")
            return [0.0] * len(vrs)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Fmi2SetReal."""
        try:
            if vrs != self._put.references:
                self._put = self._plan(vrs)
            self._put.write(*values)
            if self._put.parameters:
                self._parameters_changed(vrs)
        except Exception as error:
            self._fail(error, "fmi2SetReal")

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Fmi2GetBoolean."""
        return self._get(self._booleans, vrs, False, "fmi2GetBoolean")

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Fmi2SetBoolean."""
        self._set(self._booleans, vrs, [bool(v) for v in values], "fmi2SetBoolean")

    def get_string(self, vrs: list[int]) -> list[str]:
        """Fmi2GetString."""
        return self._get(self._strings, vrs, "", "fmi2GetString")

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Fmi2SetString."""
        self._set(self._strings, vrs, values, "fmi2SetString")

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Fmi2GetInteger: there are none."""
        return self._get([], vrs, 0, "fmi2GetInteger")

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Fmi2SetInteger: there are none."""
        self._set([], vrs, values, "fmi2SetInteger")

    def _get_fmu_state(self) -> bytes:
        """Fmi2GetFMUstate: everything, as bytes; b"" after a failure."""
        try:
            if self._stale:
                self._rebuild_now()
            header = json.dumps(
                {
                    "model": self.modelName,
                    "booleans": self._booleans,
                    "strings": self._strings,
                    "ticks": self._ticks,
                    "failure": self._failure,
                    "reals": self._reals.size,
                }
            ).encode()
            body = self._reals.tobytes() + self._object_state().tobytes()
            return STATE_MAGIC + struct.pack("<I", len(header)) + header + body
        except Exception as error:
            self._fail(error, "fmi2GetFMUstate")
            return b""

    def _set_fmu_state(self, state: bytes) -> None:
        """Fmi2SetFMUstate."""
        try:
            self._restore(state)
        except Exception as error:
            self._fail(error, "fmi2SetFMUstate")

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)

    # How they do it.

    def _restore(self, state: bytes) -> None:
        if state[:4] != STATE_MAGIC:
            raise SlaveError("the state is not one of this FMU")
        (length,) = struct.unpack_from("<I", state, 4)
        header = json.loads(state[8 : 8 + length])
        if header["model"] != self.modelName or header["reals"] != self._reals.size:
            raise SlaveError(f"the state is one of {header['model']}, not of {self.modelName}")
        values = np.frombuffer(state, offset=8 + length)
        self._reals[:] = values[: self._reals.size]
        self._booleans[:], self._strings[:] = header["booleans"], header["strings"]
        saved = self._reals.copy()
        self._rebuild_now()
        self._untuned = False
        self._restore_object(values[self._reals.size :])
        self._reals[:] = saved
        self._ticks, self._failure = header["ticks"], header["failure"]

    def _refresh(self) -> None:
        """Make the object if parameters have changed; a failure shows at the next step."""
        if self._stale and self._failure is None:
            try:
                self._rebuild_now()
            except Exception as error:
                self._fail(error, "initialization")

    def _rebuild_now(self) -> None:
        inputs = self._inputs.copy()
        self._rebuild()
        self._inputs[:] = inputs
        self._stale = self._untuned = False

    def _parameters_changed(self, vrs: list[int]) -> None:
        first = self._reals.size - self._parameters.size
        touched = [self._scalars["Real"][vr].variable for vr in vrs if vr >= first]
        if any(variable.variability == "fixed" for variable in touched):
            self._stale = True
        if any(variable.variability == "tunable" for variable in touched):
            self._untuned = True

    def _plan(self, vrs: list[int]) -> _Plan:
        """Find out once how a list of value references maps to the buffer."""
        key = (vrs[0], len(vrs)) if vrs else (0, 0)
        plan = self._plans.get(key)
        if plan is None or plan.references != vrs:
            if vrs and not 0 <= min(vrs) <= max(vrs) < self._reals.size:
                bad = next(vr for vr in vrs if not 0 <= vr < self._reals.size)
                raise SlaveError(f"value reference {bad} is not that of a Real variable")
            contiguous = vrs == list(range(key[0], key[0] + len(vrs)))
            bind = _bind_block if contiguous else _bind_scattered
            parameters = max(vrs, default=0) >= self._reals.size - self._parameters.size
            plan = self._plans[key] = _Plan(list(vrs), *bind(self._reals, vrs), parameters)
        return plan

    def _whole_ticks(self, step_size: float) -> int:
        ticks = round(step_size / TICK) if math.isfinite(step_size) else 0
        if ticks < 1 or abs(step_size - ticks * TICK) > TICK_TOLERANCE * TICK:
            raise SlaveError(
                f"communication step {step_size!r} s refused: it must be a whole multiple of "
                f"{TICK} s, the internal step"
            )
        return ticks

    def _check_inputs(self) -> None:
        """Refuse inputs that are not finite; warn once of each that is out of range."""
        for i in np.flatnonzero(~self._sound.all(axis=0)).tolist():
            scalar, value = self._scalars["Real"][i], float(self._inputs[i])
            if not math.isfinite(value):
                raise SlaveError(f"input {scalar.name} = {value} is not finite")
            self._warn_range(scalar, value)

    def _warn_range(self, scalar: Scalar, value: float) -> None:
        self._warn_once(
            scalar.name,
            f"input {scalar.name} = {value:g} is out of range [{scalar.minimum:g}, "
            f"{scalar.maximum:g}] and is clamped (said once)",
        )

    def _warn_once(self, key: str, message: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            self._tell(message, Fmi2Status.warning, "logStatusWarning")

    def _get(self, store: list[Any], vrs: list[int], blank: Any, where: str) -> list[Any]:
        try:
            return [store[_index(vr, store)] for vr in vrs]
        except Exception as error:
            self._fail(error, where)
            return [blank] * len(vrs)

    def _set(self, store: list[Any], vrs: list[int], values: list[Any], where: str) -> None:
        try:
            for vr, value in zip(vrs, values, strict=True):
                store[_index(vr, store)] = value
            # A Boolean or String may be fixed (the scene) or tunable (a switch).
            self._stale = self._stale or store is self._strings
            self._untuned = True
        except Exception as error:
            self._fail(error, where)

    def _fail(self, error: Exception, where: str) -> None:
        """Log a failure and remember it."""
        told = isinstance(error, (SlaveError, ValueError))
        cause = str(error) if told else f"{type(error).__name__}: {error}"
        if self._failure is None:
            self._failure = f"{where}: {cause}"
        self._tell(f"{where}: {cause}", Fmi2Status.error, "logStatusError")
        if not told:
            self._tell(traceback.format_exc(), Fmi2Status.error, "logStatusError")

    def _tell(self, message: str, status: Fmi2Status, category: str) -> None:
        """Log to the importer, and to standard error since its logging may be off."""
        if os.environ.get("PANDA_COSIM_STDERR", "1") != "0":
            print(f"{self.instance_name} ({self.modelName}): {message}", file=sys.stderr)
        # The importer passes it on as a printf format.
        self.log(message.replace("%", "%%"), status, category)


def _index(vr: int, store: list[Any]) -> int:
    if not 0 <= vr < len(store):
        raise SlaveError(f"value reference {vr} is not that of a variable of this type")
    return vr


def _bind_block(reals: Array, vrs: list[int]) -> tuple[Read, Write]:
    """How to read and write values that stand side by side."""
    first, count = (vrs[0] if vrs else 0), len(vrs)
    # Packing takes a third of the time of an assignment from a list.
    write = partial(struct.Struct(f"{count}d").pack_into, reals.data, 8 * first)
    return reals[first : first + count].tolist, write


def _bind_scattered(reals: Array, vrs: list[int]) -> tuple[Read, Write]:
    """How to read and write values that stand anywhere."""
    indices = np.array(vrs, dtype=np.intp)

    def read() -> list[float]:
        values: list[float] = reals.take(indices).tolist()
        return values

    def write(*values: float) -> None:
        reals[indices] = values

    return read, write
