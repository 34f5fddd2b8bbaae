"""The controller's own model of the arm."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import asset_files

_FILES = asset_files()
Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def load_arm() -> Any:
    """Compile arm and hand without their shapes, which carry no mass.

    Returns:
        The `mujoco.MjModel`: 7 arm joints and 2 fingers.
    """
    spec = mujoco.MjSpec.from_string(_FILES["panda.xml"].decode(), include=_FILES, assets=_FILES)
    for shape in [*spec.geoms, *spec.meshes, *spec.materials]:
        spec.delete(shape)
    return spec.compile()


class ArmModel:
    """Inertia of arm and hand, without a load, from assets/panda.xml."""

    def __init__(self) -> None:
        self._model = load_arm()
        self._data: Any = mujoco.MjData(self._model)
        self._mass = np.zeros((self._model.nv, self._model.nv))

    def mass(self, q: Vector) -> Matrix:
        """Mass matrix of the arm, that of the motors included, with the fingers at rest.

        Args:
            q: Joint positions (7,) [rad].

        Returns:
            Mass matrix M(q) (7, 7) [kg.m^2]; the next call overwrites it.
        """
        model, data = self._model, self._data
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, self._mass)
        return self._mass[:7, :7]
