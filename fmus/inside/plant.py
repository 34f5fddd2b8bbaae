"""The plant as an FMI slave."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...assets import asset_files
from ...plant.mujoco_warnings import taken_warnings
from ...plant.parameters import PlantParameters
from ...plant.plant import Plant
from ..interface.engine import COUNTED
from ..interface.plant import PLANT
from .base import SharedSlave


class PlantSlave(SharedSlave):
    """Translates between FMI and `plant.Plant`."""

    interface = PLANT

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        asset_files()  # read them now: a host may remove its folder later

    def rebuild(self, start_time: float) -> None:
        """Make the plant."""
        given = self.parameters(v.name for v in PLANT.of("parameter"))
        with self._logged():
            self._plant = Plant(PlantParameters(**given), self._inputs, self._outputs)
        self._views[COUNTED.name][:] = self._seen = np.zeros(COUNTED.size)
        self._count()

    def advance(self, count: int) -> None:
        """Step the plant."""
        with self._logged():
            self._plant.step(count)
        self._count()

    def get_state(self) -> bytes:
        """MuJoCo's state for integration, inputs and outputs."""
        return self._plant.get_state().tobytes()

    def set_state(self, state: bytes) -> None:
        """Restore it, and the outputs."""
        with self._logged():
            self._plant.set_state(np.frombuffer(state))
        self._seen = self._plant.warnings[: COUNTED.size].copy()

    def _count(self) -> None:
        """Add the engine's warnings since the last time."""
        now = self._plant.warnings[: COUNTED.size]
        self._views[COUNTED.name] += now - self._seen
        self._seen = now.copy()

    @contextmanager
    def _logged(self) -> Iterator[None]:
        """Log MuJoCo's warnings."""
        with taken_warnings() as texts:
            try:
                yield
            finally:
                for text in texts:
                    self.warn_once(text[:40], f"MuJoCo warns: {text} (logged once)")
