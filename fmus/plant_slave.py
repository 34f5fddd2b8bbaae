"""The plant as an FMI slave."""

from __future__ import annotations

from typing import cast

from fmus.plant_interface import PLANT
from fmus.slave import Array, BufferedSlave
from plant import Plant, PlantParameters


class PlantSlave(BufferedSlave):
    """Translates between FMI and `plant.Plant`."""

    interface = PLANT

    def _rebuild(self) -> None:
        parameters = PlantParameters(
            scene=cast(str, self.parameter("scene")),
            block_pos=cast(tuple[float, float], self.parameter("block_pos")),
            block_yaw=cast(float, self.parameter("block_yaw")),
            block_mass=cast(float, self.parameter("block_mass")),
            block_friction=cast(float, self.parameter("block_friction")),
        )
        self._plant = Plant(parameters, self._inputs, self._outputs)

    def _advance(self, ticks: int) -> None:
        self._plant.step(ticks)

    def _object_state(self) -> Array:
        return self._plant.get_state()

    def _restore_object(self, state: Array) -> None:
        self._plant.set_state(state)
