"""The plant as an FMI slave."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from ...assets import asset_files
from ...plant import Plant, PlantParameters
from ..interface.plant import PLANT
from .base import Array, BufferedSlave


class _Ear:
    """Hears MuJoCo's warnings, which else go to a file in the working directory.

    MuJoCo has one ear for the whole process: what is not the plant's is passed on.
    """

    def __init__(self) -> None:
        self.listening = False
        self.heard: list[str] = []
        self._before: Callable[[str], None] | None = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(self._hear)

    def _hear(self, text: str) -> None:
        if self.listening:
            self.heard.append(text)
        elif self._before is not None:
            self._before(text)
        else:
            mujoco.mju_writeLog("WARNING", text)  # what MuJoCo does of its own accord


_EAR = _Ear()


class PlantSlave(BufferedSlave):
    """Translates between FMI and `plant.Plant`."""

    interface = PLANT

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        asset_files()  # read now: a host may remove its folder later

    def _rebuild(self) -> None:
        given: dict[str, Any] = {v.name: self.parameter(v.name) for v in PLANT.of("parameter")}
        parameters = PlantParameters(**given)
        with self._listening():
            self._plant = Plant(parameters, self._inputs, self._outputs)

    def _advance(self, ticks: int) -> None:
        _EAR.listening = True  # not `_listening`, which takes a microsecond
        try:
            self._plant.step(ticks)
        finally:
            _EAR.listening = False
            if _EAR.heard:
                self._pass_on()

    def _object_state(self) -> Array:
        return self._plant.get_state()

    def _restore_object(self, state: Array) -> None:
        with self._listening():
            self._plant.set_state(state)

    @contextmanager
    def _listening(self) -> Iterator[None]:
        """Log what MuJoCo warns of meanwhile."""
        _EAR.listening = True
        try:
            yield
        finally:
            _EAR.listening = False
            self._pass_on()

    def _pass_on(self) -> None:
        for text in _EAR.heard:
            self._warn_once(text[:40], f"MuJoCo warns: {text} (said once)")
        _EAR.heard.clear()
