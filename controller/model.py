"""The controller's own model of the arm."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assets import asset_files
from ..assets.calls import bind
from . import linalg

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
    """Inertia of arm and hand, without a load, from assets/panda.xml.

    Args:
        q: Buffer of the joint positions (7,) [rad].
    """

    def __init__(self, q: Vector) -> None:
        self._model = load_arm()
        self._data: Any = mujoco.MjData(self._model)
        self._mass = np.zeros((self._model.nv, self._model.nv))
        self._arm = self._mass[:7, :7]
        self._look = linalg.chain(
            linalg.copy(self._data.qpos[:7], q),
            bind("mj_kinematics", self._model, self._data),
            bind("mj_comPos", self._model, self._data),
            bind("mj_makeM", self._model, self._data),
        )

    def mass(self) -> Matrix:
        """Mass matrix of the arm, that of the motors included, with the fingers at rest.

        Returns:
            Mass matrix M(q) (7, 7) [kg.m^2]; the next call overwrites it.
        """
        self._look()
        mujoco.mj_fullM(self._model, self._data, self._mass)
        return self._arm
