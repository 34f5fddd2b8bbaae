"""What all slaves share: FMI's calls on one flat buffer of values, in their legal order."""

from __future__ import annotations

import gc
import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Final, Literal
from weakref import ref

import numpy as np

from ...assets import STEP_SIZE
from ..interface.variables import Interface, Kind
from .state import pack, unpack
from .telling import LOG_CATEGORIES, NOT_READY, RefusalError, SlaveError, TellingSlave
from .values import Array, Values

__all__ = ["LOG_CATEGORIES", "TICK", "Array", "BufferedSlave", "SlaveError"]

TICK: Final = STEP_SIZE  # [s] internal step; communication steps are whole multiples
TICK_TOLERANCE: Final = 1e-6  # [1] of a tick; a sum of 1e6 floating-point steps stays within
Phase = Literal["instantiated", "initializing", "stepping", "terminated"]


class BufferedSlave(TellingSlave):
    """A slave whose Real variables are one array, indexed by value reference.

    Subclasses say what interface they have, and translate between it and a plain object in
    `_rebuild`, `_retune` and `_advance`.
    """

    interface: ClassVar[Interface]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Have what a tick calls in the first class that is looked at.

        The wrapper's names are new strings at each call, which Python's cache of attributes
        does not know.
        """
        super().__init_subclass__(**kwargs)
        for name in ("do_step", "get_real", "set_real"):
            setattr(cls, name, getattr(cls, name))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.modelName = self.interface.model
        self._values = Values(self.interface)
        self._inputs, self._outputs = self._values.inputs, self._values.outputs
        self._low, self._high = self._values.input_bounds()
        self._unsound = False  # whether an input may be out of range or not finite
        self._got = self._put = self._values.plan([])
        self._step_size, self._step_ticks = math.nan, 0
        self._start_tick = self._ticks = 0
        self._phase: Phase = "instantiated"
        self._stale, self._untuned = True, False
        self._built: tuple[bytes, tuple[str, ...]] | None = None
        self._unbuilt = False  # whether the failure is one of the parameters
        self.__dict__["set_string"] = _guarded_set_string(ref(self))

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
        return self._values.parameter(name)

    # FMI callbacks. None of them may raise, not even on Ctrl-C.

    def setup_experiment(
        self, start_time: float, _stop_time: float | None = None, _tolerance: float | None = None
    ) -> None:
        """Fmi2SetupExperiment."""
        try:
            self._start_tick = round(start_time / TICK)
        except (ValueError, OverflowError):
            self._fail(SlaveError(f"start time {start_time!r} s is not finite"), "fmi2Setup")

    def enter_initialization_mode(self) -> None:
        """Fmi2EnterInitializationMode."""
        self._go("instantiated", "initializing", "fmi2EnterInitializationMode")

    def exit_initialization_mode(self) -> None:
        """Fmi2ExitInitializationMode: the object is made from the parameters."""
        if self._go("initializing", "stepping", "fmi2ExitInitializationMode"):
            if self._stale:
                self._refresh()
            self._settle()

    def terminate(self) -> None:
        """Fmi2Terminate."""
        if self._phase == "terminated":
            self._fail(SlaveError("it has been terminated before"), "fmi2Terminate")
        self._phase = "terminated"
        self._settle()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Fmi2DoStep; False (fmi2Discard) after a failure, with its reason logged."""
        try:
            if self._blocked is not None:
                raise RefusalError(self._blocked)
            if step_size != self._step_size:
                self._step_size, self._step_ticks = step_size, _whole_ticks(step_size)
            ticks = self._step_ticks
            if self._unsound:
                self._check_inputs()
            if self._untuned:
                self._retune()
                self._untuned = False
            self._advance(ticks)
            self._ticks += ticks
        except RefusalError as refusal:
            self._refuse(refusal, f"t = {current_time:.6g} s")
            return False
        except BaseException as error:
            self._fail(error, f"t = {current_time:.6g} s")
            return False
        return True

    def get_real(self, vrs: list[int]) -> list[float]:
        """Fmi2GetReal."""
        if self._stale:
            self._refresh()
        try:
            if vrs != self._got.references:
                self._got = self._values.plan(vrs)
            return self._got.read()
        except BaseException as error:
            self._fail(error, "fmi2GetReal")
            return [math.nan] * len(vrs)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Fmi2SetReal."""
        try:
            if vrs != self._put.references:
                self._put = self._values.plan(vrs)
            self._put.write(*values)
            # In the middle of other work, plain Python beats numpy's ufuncs at this by far.
            if not math.isfinite(sum(values)):
                self._unsound = True
            for i, low, high in self._put.bounds:
                if not low <= values[i] <= high:
                    self._unsound = True
            if self._put.parameters:
                self._parameters_changed()
        except BaseException as error:
            self._fail(error, "fmi2SetReal")

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Fmi2GetBoolean."""
        return self._get("Boolean", vrs, False)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Fmi2SetBoolean."""
        self._set("Boolean", vrs, values)

    def get_string(self, vrs: list[int]) -> list[str]:
        """Fmi2GetString."""
        return self._get("String", vrs, "")

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Fmi2SetString."""
        self._set("String", vrs, values)

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Fmi2GetInteger, of enumerations."""
        return self._get("Enumeration", vrs, 0)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Fmi2SetInteger, of enumerations."""
        self._set("Enumeration", vrs, values)

    def _get_fmu_state(self) -> bytes:
        """Fmi2GetFMUstate: everything, as bytes; b"" after a failure."""
        try:
            return self._save()
        except BaseException as error:
            self._fail(error, "fmi2GetFMUstate")
            return b""

    def _set_fmu_state(self, state: bytes) -> None:
        """Fmi2SetFMUstate."""
        try:
            self._restore(state)
        except BaseException as error:
            self._fail(error, "fmi2SetFMUstate")

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    # How they do it.

    def _go(self, expected: Phase, following: Phase, where: str) -> bool:
        """Go to the next phase, or fail."""
        if self._phase != expected:
            self._fail(SlaveError(f"called out of order: the instance is {self._phase}"), where)
            return False
        self._phase = following
        return True

    def _settle(self) -> None:
        """Allow in this phase what may be done in it, and nothing else."""
        self._values.lock(self._phase == "terminated")
        self._got = self._put = self._values.plan([])
        if self._phase == "terminated":
            self._blocked = "it has been terminated"
        elif self._failure is None:
            self._blocked = None if self._phase == "stepping" else NOT_READY

    def _refresh(self) -> None:
        """Make the object if parameters have changed; a failure shows at the next step."""
        if self._failure is None:
            try:
                self._rebuild_now()
            except BaseException as error:
                self._unbuilt = True
                self._fail(error, "initialization")

    def _rebuild_now(self) -> None:
        inputs = self._inputs.copy()
        self._rebuild()
        self._inputs[:] = inputs
        self._stale = self._untuned = False
        self._built = self._values.fixed()

    def _parameters_changed(self) -> None:
        """Take note that parameters may have changed."""
        if self._phase == "stepping" and self._built is not None:
            changed = self._values.keep_fixed(self._built)
            if changed:
                raise SlaveError(
                    f"{changed} is a fixed parameter: it cannot be set after initialization"
                )
            self._untuned = True
            return
        self._stale = True
        if self._unbuilt:  # these may be better
            self._unbuilt = False
            self._failure, self._blocked = None, NOT_READY

    def _check_inputs(self) -> None:
        """Refuse inputs that are not finite; clamp those out of range, with a warning each."""
        # In range means finite, too: NaN fails each comparison, infinity one.
        sound = (self._low <= self._inputs) & (self._inputs <= self._high)
        non_finite = np.flatnonzero(~sound).tolist()
        scalars = [self._values.scalars[i] for i in non_finite]
        for i, scalar in zip(non_finite, scalars, strict=True):
            if not math.isfinite(self._inputs[i]):
                raise RefusalError(f"input {scalar.name} = {self._inputs[i]} is not finite")
        for i, scalar in zip(non_finite, scalars, strict=True):
            low, high = self._low[i], self._high[i]
            self._warn_once(
                scalar.name,
                f"input {scalar.name} = {self._inputs[i]:g} is out of range [{low:g}, {high:g}] "
                f"and is clamped (said once)",
            )
        np.clip(self._inputs, self._low, self._high, out=self._inputs)
        self._unsound = False

    def _get(self, kind: Kind, vrs: list[int], blank: Any) -> list[Any]:
        try:
            return self._values.get_others(kind, vrs)
        except BaseException as error:
            self._fail(error, f"fmi2Get{_function(kind)}")
            return [blank] * len(vrs)

    def _set(self, kind: Kind, vrs: list[int], values: list[Any]) -> None:
        try:
            self._values.set_others(kind, vrs, values)
            self._parameters_changed()
        except BaseException as error:
            self._fail(error, f"fmi2Set{_function(kind)}")

    def _save(self) -> bytes:
        if self._stale:
            self._rebuild_now()
        values = self._values
        header = {
            "phase": self._phase,
            "clock": [self._start_tick, self._ticks],
            "untuned": self._untuned,
            "failure": self._failure,
            "texts": list(values.texts.values()),
        }
        return pack(self.modelName, header, values.values, self._object_state())

    def _restore(self, state: bytes) -> None:
        header, numbers = unpack(self.modelName, state)
        values, size = self._values, self._values.values.size
        values.values[:] = numbers[:size]
        values.texts |= dict(zip(values.texts, header["texts"], strict=True))
        if values.fixed() != self._built:
            self._rebuild_now()
        self._untuned = header["untuned"]
        if not self._untuned:
            self._retune()
        self._restore_object(numbers[size:])
        values.values[:] = numbers[:size]
        self._stale = self._unbuilt = False
        self._unsound = True  # not known
        self._start_tick, self._ticks = header["clock"]
        self._phase = header["phase"]
        self._set_failure(header["failure"])
        self._settle()


def _guarded_set_string(slave: ref[BufferedSlave]) -> Callable[[list[int], list[str]], None]:
    """Make a `set_string` that survives text that is not UTF-8.

    For such text, the wrapper leaves a hole in the list and an exception pending. Python then
    finds no method of a class, but still what is in the instance's own dictionary.
    """

    def set_string(vrs: list[int], values: list[str]) -> None:
        try:
            whole = len(gc.get_referents(values)) == len(vrs)  # which skips holes
        except SystemError:  # the pending exception
            whole = False
        found = slave()
        if found is not None:
            BufferedSlave.set_string(found, vrs, values if whole else [""] * len(vrs))
            if not whole:
                found._fail(SlaveError("text is not UTF-8"), "fmi2SetString")

    return set_string


def _function(kind: Kind) -> str:
    """What the functions of a type are called by FMI 2.0."""
    return "Integer" if kind == "Enumeration" else kind


def _whole_ticks(step_size: float) -> int:
    ticks = round(step_size / TICK) if math.isfinite(step_size) else 0
    if ticks < 1 or abs(step_size - ticks * TICK) > TICK_TOLERANCE * TICK:
        raise RefusalError(
            f"communication step {step_size!r} s refused: it must be a whole multiple of "
            f"{TICK} s, the internal step"
        )
    return ticks
