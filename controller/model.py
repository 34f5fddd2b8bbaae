"""The controller's own model of the arm."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import asset_files

_FILES = asset_files()
Vector = NDArray[np.float64]


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

    Attributes:
        armature: Inertia of each joint's motor (7,) [kg.m^2].
    """

    def __init__(self) -> None:
        self._model = load_arm()
        self._model.opt.gravity[:] = 0.0  # so that inverse dynamics at rest is inertia alone
        self._data: Any = mujoco.MjData(self._model)
        self._q, self._qacc = self._data.qpos[:7], self._data.qacc[:7]
        self.armature: Vector = self._model.dof_armature[:7].copy()

    def impulse(self, q: Vector, qd: Vector, qd_before: Vector, out: Vector) -> None:
        """Impulse that changes the links' speed, M(q) (qd - qd_before), without the armature's.

        Args:
            q: Joint positions (7,) [rad].
            qd: Joint velocities (7,) [rad/s].
            qd_before: Joint velocities before (7,) [rad/s].
            out: Receives the impulses on the 7 joints and 2 fingers (9,) [N.m.s, N.s].
        """
        model, data = self._model, self._data
        np.copyto(self._q, q)
        np.subtract(qd, qd_before, out=self._qacc)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 1, out)
