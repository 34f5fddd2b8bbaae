"""The controller's own model of the arm."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import asset_files

_FILES = asset_files()
Vector = NDArray[np.float64]


class ArmModel:
    """Inertia of arm and hand, without a load, from assets/panda.xml."""

    def __init__(self) -> None:
        self._model: Any = mujoco.MjModel.from_xml_string(
            _FILES["panda.xml"].decode(), assets=_FILES
        )
        self._data: Any = mujoco.MjData(self._model)
        self._q = self._data.qpos[:7]
        self._qacc = np.zeros(self._model.nv)
        self._force = np.zeros(self._model.nv)

    def inertia_force(self, q: Vector, qacc: Vector) -> Vector:
        """Force that accelerates the arm, M(q) qacc.

        Args:
            q: Joint positions (7,) [rad].
            qacc: Joint accelerations (7,) [rad/s^2].

        Returns:
            Joint forces (7,) [N.m]; a view that the next call overwrites.
        """
        model, data = self._model, self._data
        self._q[:] = q
        self._qacc[:7] = qacc
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_mulM(model, data, self._force, self._qacc)
        return self._force[:7]
