"""The controller as an FMI slave."""

from __future__ import annotations

from dataclasses import fields
from typing import Final, cast

import mujoco
import numpy as np

from ...assets import STEP_SIZE
from ...assets.franka import HOME_XQUAT
from ...controller.controller import Controller
from ...controller.gains import Gains
from ..interface.controller import CONTROLLER
from .base import Array, SharedSlave

# [1] A quaternion with a length in this range is used as it is.
SHORTEST: Final = 1.0 - 5e-7
LONGEST: Final = 1.0 + 5e-7
PERIOD_TOLERANCE: Final = 1e-9  # [s]
ZERO_TOLERANCE: Final = 1e-3  # [1] a shorter quaternion counts as zero


class ControllerSlave(SharedSlave):
    """Translates between FMI and `controller.Controller`."""

    interface = CONTROLLER

    def rebuild(self, start_time: float) -> None:
        """Make the controller."""
        period = cast(float, self.parameter("period"))
        self._period_ticks = round(period / STEP_SIZE)
        if abs(period - self._period_ticks * STEP_SIZE) > PERIOD_TOLERANCE:
            raise ValueError(f"period: {period!r} s must be a whole multiple of {STEP_SIZE} s")
        self._ticks = 0
        self._last = np.zeros(8)  # last valid quaternions; no measurement of the hand yet
        self._last[:4] = HOME_XQUAT
        self._controller = Controller(self._gains(), period, self._inputs, self._outputs)

    def _gains(self) -> Gains:
        return Gains(**self.parameters(f.name for f in fields(Gains)))

    def tune(self) -> None:
        """Use the new gains and switches."""
        self._controller.gains = self._gains()

    def advance(self, count: int) -> None:
        """Update the controller once per period, at the beginning of a step."""
        self._normalize("quat_cmd", self._last[:4])
        self._normalize("hand_xquat", self._last[4:])
        first = -self._ticks % self._period_ticks  # steps to the next update
        self._ticks += count
        if not np.count_nonzero(self._last[4:]):
            return  # some importers send zeros first; the law must start from a measurement
        for _ in range(first, count, self._period_ticks):
            self._controller.update()

    def _normalize(self, name: str, last: Array) -> None:
        """Scale a quaternion to length 1; replace one of length 0 by the last valid one."""
        quat = self._views[name]
        length = mujoco.mju_norm(quat)
        if length < ZERO_TOLERANCE:
            quat[:] = last
            self.warn_once(name, f"input {name} is zero; the last valid one is used (logged once)")
            return
        if not SHORTEST < length < LONGEST:
            self.warn_once(
                name, f"input {name} has length {length:g} and is scaled to length 1 (logged once)"
            )
            quat /= length
        last[:] = quat

    def get_state(self) -> bytes:
        """The time, the last valid quaternions and the law's state."""
        return np.concatenate(([self._ticks], self._last, self._controller.get_state())).tobytes()

    def set_state(self, state: bytes) -> None:
        """Restore what `get_state` returned; the outputs have been restored with the values."""
        numbers = np.frombuffer(state)
        self._ticks, self._last[:] = int(numbers[0]), numbers[1:9]
        self._controller.set_state(numbers[9:])
