"""The controller as an FMI slave."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Final, cast

import numpy as np

from assets.franka import HOME_XQUAT
from controller import Controller, Gains
from fmus.interface.controller import CONTROLLER
from fmus.slaves.base import TICK, Array, BufferedSlave, SlaveError

UNIT_TOLERANCE: Final = 1e-6  # [1] of a quaternion's squared length; beyond, it is scaled
ZERO_TOLERANCE: Final = 1e-6  # [1] a squared length below this has no direction


class ControllerSlave(BufferedSlave):
    """Translates between FMI and `controller.Controller`."""

    interface = CONTROLLER

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._quats: dict[str, Array] = {}
        self._last: dict[str, list[float]] = {}  # last valid ones, (w, x, y, z)
        for name in ("quat_cmd", "hand_xquat"):
            first = next(
                s.value_reference for s in self.interface.scalars() if s.variable.name == name
            )
            self._quats[name] = self._inputs[first : first + 4]
            self._last[name] = list(HOME_XQUAT)
        self._last["hand_xquat"] = [0.0] * 4  # nothing has been measured yet

    def _rebuild(self) -> None:
        period = cast(float, self.parameter("period"))
        self._period_ticks = round(period / TICK) if math.isfinite(period) else 0
        if self._period_ticks < 1 or abs(period - self._period_ticks * TICK) > 1e-9:
            raise SlaveError(f"period: {period!r} s must be a whole multiple of {TICK} s")
        self._controller = Controller(self._gains(), period, self._inputs, self._outputs)

    def _gains(self) -> Gains:
        values: dict[str, Any] = {f.name: self.parameter(f.name) for f in fields(Gains)}
        return Gains(**values)

    def _retune(self) -> None:
        self._controller.gains = self._gains()

    def _advance(self, ticks: int) -> None:
        for name, quat in self._quats.items():
            w, x, y, z = values = quat.tolist()
            if abs(w * w + x * x + y * y + z * z - 1.0) > UNIT_TOLERANCE:
                self._mend(name, quat)
            else:
                self._last[name] = values
        if not any(self._last["hand_xquat"]):
            return  # some importers send zeros first: the law begins with a measurement
        for tick in range(self._ticks, self._ticks + ticks):
            if tick % self._period_ticks == 0:
                self._controller.update()

    def _mend(self, name: str, quat: Array) -> None:
        """Scale a quaternion to length 1; in place of one of length 0, take the last valid one."""
        length = math.sqrt(quat @ quat)
        if length * length < ZERO_TOLERANCE:
            quat[:] = self._last[name]
            self._warn_once(name, f"input {name} is zero; the last valid one is kept (said once)")
            return
        self._warn_once(
            name, f"input {name} has length {length:g} and is scaled to length 1 (said once)"
        )
        quat /= length
        self._last[name] = quat.tolist()

    def _object_state(self) -> Array:
        return np.concatenate((*self._last.values(), self._controller.get_state()))

    def _restore_object(self, state: Array) -> None:
        for i, name in enumerate(self._last):
            self._last[name] = state[4 * i : 4 * i + 4].tolist()
        self._controller.set_state(state[4 * len(self._last) :])
