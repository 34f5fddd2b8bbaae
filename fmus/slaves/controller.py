"""The controller as an FMI slave."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Final, cast

import mujoco
import numpy as np

from ...assets.franka import HOME_XQUAT
from ...controller import Controller, Gains
from ..interface.controller import CONTROLLER, MOST
from .base import TICK, Array, BufferedSlave, SlaveError

# [1] Lengths of a quaternion between which it is taken as it is.
SHORTEST: Final = 1.0 - 5e-7
LONGEST: Final = 1.0 + 5e-7
ZERO_TOLERANCE: Final = 1e-3  # [1] a quaternion that is shorter has no direction


class _Orientation:
    """A quaternion (w, x, y, z) among the inputs, with the last valid one.

    Args:
        name: Name of the variable.
        quat: Its place among the inputs (4,).
        last: Where the last valid one is (4,).
    """

    def __init__(self, name: str, quat: Array, last: Array) -> None:
        self.name, self.quat, self.last = name, quat, last

    def length(self) -> float:
        """Length of the quaternion [1]."""
        length: float = mujoco.mju_norm(self.quat)
        return length


class ControllerSlave(BufferedSlave):
    """Translates between FMI and `controller.Controller`."""

    interface = CONTROLLER

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        first, last = self._place("quat_cmd"), self._place("hand_xquat")
        self._last = np.zeros(8)  # the last valid ones
        self._command = _Orientation("quat_cmd", self._inputs[first], self._last[:4])
        self._hand = _Orientation("hand_xquat", self._inputs[last], self._last[4:])
        self._command.last[:] = HOME_XQUAT  # of the hand, nothing has been measured yet

    def _place(self, name: str) -> slice:
        """Where a quaternion is among the inputs."""
        scalars = self.interface.scalars()
        at = next(s.value_reference for s in scalars if s.variable.name == name)
        return slice(at, at + 4)

    def _rebuild(self) -> None:
        period = cast(float, self.parameter("period"))
        self._period_ticks = round(period / TICK) if math.isfinite(period) else 0
        if self._period_ticks < 1 or abs(period - self._period_ticks * TICK) > 1e-9:
            raise SlaveError(f"period: {period!r} s must be a whole multiple of {TICK} s")
        self._controller = Controller(self._gains(), period, self._inputs, self._outputs)

    def _gains(self) -> Gains:
        values: dict[str, Any] = {f.name: self.parameter(f.name) for f in fields(Gains)}
        for name, most in MOST.items():
            if values[name] > most:
                raise SlaveError(
                    f"{name}: {values[name]!r} is out of range; must be at most {most:g}"
                )
        return Gains(**values)

    def _retune(self) -> None:
        self._controller.gains = self._gains()

    def _advance(self, ticks: int) -> None:
        self._mend(self._command)
        self._mend(self._hand)
        if not self._hand.last.any():
            return  # some importers send zeros first: the law starts with a measurement
        period, now = self._period_ticks, self._ticks
        # Ticks to the next update, and then from one to the next.
        for _ in range(-now % period, ticks, period):
            self._controller.update()

    def _mend(self, orientation: _Orientation) -> None:
        """Scale a quaternion to length 1; in place of one of length 0, take the last valid one."""
        name, quat, length = orientation.name, orientation.quat, orientation.length()
        if length < ZERO_TOLERANCE:
            quat[:] = orientation.last
            self._warn_once(name, f"input {name} is zero; the last valid one is kept (said once)")
            return
        if not SHORTEST < length < LONGEST:
            self._warn_once(
                name, f"input {name} has length {length:g} and is scaled to length 1 (said once)"
            )
            quat /= length
        orientation.last[:] = quat

    def _object_state(self) -> Array:
        return np.concatenate((self._last, self._controller.get_state()))

    def _restore_object(self, state: Array) -> None:
        split = self._last.size
        self._last[:] = state[:split]
        self._controller.set_state(state[split:])
