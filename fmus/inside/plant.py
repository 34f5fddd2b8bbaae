"""The plant as an FMI slave."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

import mujoco
import numpy as np

from ...assets import asset_files
from ...plant.plant import Plant, PlantParameters
from ..interface.plant import PLANT
from .base import SharedSlave


class _Warnings:
    """Collects MuJoCo's warnings of the plant, which would go to a file; others are passed on."""

    def __init__(self) -> None:
        self.listening = False
        self.texts: list[str] = []
        log = partial(mujoco.mju_writeLog, "WARNING")  # MuJoCo's default
        self._before: Callable[[str], None] = mujoco.get_mju_user_warning() or log
        mujoco.set_mju_user_warning(self._take)

    def _take(self, text: str) -> None:
        (self.texts.append if self.listening else self._before)(text)


@cache
def _warnings() -> _Warnings:
    """The handler, installed by the first instance."""
    return _Warnings()


class PlantSlave(SharedSlave):
    """Translates between FMI and `plant.Plant`."""

    interface = PLANT

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._mujoco = _warnings()
        asset_files()  # read them now: a host may remove its folder later

    def rebuild(self, start_time: float) -> None:
        """Make the plant."""
        given: dict[str, Any] = {v.name: self.parameter(v.name) for v in PLANT.of("parameter")}
        with self._logged():
            self._plant = Plant(PlantParameters(**given), self._inputs, self._outputs)

    def advance(self, count: int) -> None:
        """Step the plant."""
        with self._logged():
            self._plant.step(count)

    def get_state(self) -> bytes:
        """MuJoCo's state for integration."""
        return self._plant.get_state().tobytes()

    def set_state(self, state: bytes) -> None:
        """Restore it; the outputs have been restored with the values."""
        outputs = self._outputs.copy()
        with self._logged():
            self._plant.set_state(np.frombuffer(state))
        self._outputs[:] = outputs

    @contextmanager
    def _logged(self) -> Iterator[None]:
        """Log MuJoCo's warnings."""
        self._mujoco.listening = True
        try:
            yield
        finally:
            self._mujoco.listening = False
            for text in self._mujoco.texts:
                self.warn_once(text[:40], f"MuJoCo warns: {text} (logged once)")
            self._mujoco.texts.clear()
