"""The sensors as an FMI slave."""

from __future__ import annotations

from dataclasses import fields
from typing import cast

import numpy as np

from ...assets import STEP_SIZE
from ...controller.sensor_errors import SensorErrors
from ...controller.sensors import Sensors
from ..interface.sensors import SENSORS
from .base import SharedSlave


class SensorsSlave(SharedSlave):
    """Translates between FMI and `controller.sensors.Sensors`."""

    interface = SENSORS

    def rebuild(self, start_time: float) -> None:
        """Make the sensors, with the robot model's measurements before the first step."""
        self._sensors = Sensors(self._errors(), self._inputs, self._outputs)
        self._sensors.model_start()

    def _errors(self) -> SensorErrors:
        given = self.parameters(f.name for f in fields(SensorErrors))
        return SensorErrors(**given | {"delay": round(cast(float, given["delay"]) / STEP_SIZE)})

    def tune(self) -> None:
        """Take over errors that have changed."""
        self._sensors.set_errors(self._errors())

    def advance(self, count: int) -> None:
        """Take a measurement at the start of each step."""
        for _ in range(count):
            self._sensors.update()

    def get_state(self) -> bytes:
        """The tick and the delayed measurements."""
        return self._sensors.get_state().tobytes()

    def set_state(self, state: bytes) -> None:
        """Restore them; the readings have been restored with the values."""
        self._sensors = Sensors(self._errors(), self._inputs, self._outputs)
        self._sensors.set_state(np.frombuffer(state))
