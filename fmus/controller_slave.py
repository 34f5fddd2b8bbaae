"""The controller as an FMI slave."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, cast

from controller import Controller, Gains
from fmus.controller_interface import CONTROLLER
from fmus.slave import TICK, Array, BufferedSlave, SlaveError


class ControllerSlave(BufferedSlave):
    """Translates between FMI and `controller.Controller`."""

    interface = CONTROLLER

    def _rebuild(self) -> None:
        period = cast(float, self.parameter("period"))
        self._period_ticks = round(period / TICK)
        if self._period_ticks < 1 or abs(period - self._period_ticks * TICK) > 1e-9:
            raise SlaveError(f"period: {period!r} s must be a whole multiple of {TICK} s")
        self._controller = Controller(self._gains(), period, self._inputs, self._outputs)

    def _gains(self) -> Gains:
        values: dict[str, Any] = {f.name: self.parameter(f.name) for f in fields(Gains)}
        return Gains(**values)

    def _retune(self) -> None:
        self._controller.gains = self._gains()

    def _advance(self, ticks: int) -> None:
        for tick in range(self._ticks, self._ticks + ticks):
            if tick % self._period_ticks == 0:
                self._controller.update()

    def _object_state(self) -> Array:
        return self._controller.get_state()

    def _restore_object(self, state: Array) -> None:
        self._controller.set_state(state)
