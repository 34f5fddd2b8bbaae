"""The controller's own model of the arm."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import asset_files
from controller import linalg

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

    Args:
        q: Buffer of the joint positions (7,) [rad].
        qd: Buffer of the joint velocities (7,) [rad/s].
        qd_before: Buffer of the joint velocities before (7,) [rad/s].
        impulse: Buffer (9,) that receives the impulses on the 7 joints and 2 fingers that change
            the links' speed, M(q) (qd - qd_before), without the armature's [N.m.s, N.s].

    Attributes:
        armature: Inertia of each joint's motor (7,) [kg.m^2].
    """

    def __init__(self, q: Vector, qd: Vector, qd_before: Vector, impulse: Vector) -> None:
        self._model = load_arm()
        self._model.opt.gravity[:] = 0.0  # so that inverse dynamics at rest is inertia alone
        self._data: Any = mujoco.MjData(self._model)
        self._impulse = impulse
        self._place = linalg.copy(self._data.qpos[:7], q)
        self._change = linalg.subtract(self._data.qacc[:7], qd, qd_before)
        self._change_norm = linalg.norm(self._data.qacc[:7])
        self.armature: Vector = self._model.dof_armature[:7].copy()

    def change(self) -> float:
        """Take the change of the joint velocities; return its length [rad/s]."""
        self._change()
        return self._change_norm()

    def update(self) -> None:
        """Set the impulse, after `change`."""
        model, data = self._model, self._data
        self._place()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 1, self._impulse)
