"""The plant: a Franka Emika Panda, a table and a block, simulated by MuJoCo.

Nothing in here knows of FMI. `Plant` is stepped at 1 ms through preallocated buffers.
"""

from .plant import INPUTS, OUTPUTS, DivergenceError, Plant, PlantParameters

__all__ = ["INPUTS", "OUTPUTS", "DivergenceError", "Plant", "PlantParameters"]
