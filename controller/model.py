"""The controller's own model of the arm."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ..assets.arm import read_spec, saved
from ..assets.fields import Vector
from ..assets.franka import DEFAULT_ROBOT

FINGERTIPS = (0.0, 0.0, 0.1034)  # [m] their centre in the hand's frame (Franka Control Interface)


@lru_cache(maxsize=8)
def load_arm(load: float = 0.0, robot: str = DEFAULT_ROBOT) -> Any:
    """Compile arm and hand, 9 joints, without geoms, which carry no mass."""
    # `load` is the mass of a point between the fingertips [kg]. Compiling takes 50 ms, and nobody
    # writes to the model: all share it.
    return arm_spec(load, robot).compile()


def arm_spec(load: float = 0.0, robot: str = DEFAULT_ROBOT) -> Any:
    """Return the arm as `load_arm` compiles it (`mujoco.MjSpec`)."""
    spec = read_spec("panda.xml", robot)
    for shape in [*spec.geoms, *spec.meshes, *spec.materials]:
        spec.delete(shape)
    if load > 0.0:
        spec.body("hand").add_body(
            name="load", pos=FINGERTIPS, mass=load, inertia=[1e-9] * 3, explicitinertial=True
        )
    return spec


def arm_mjb(robot: str) -> bytes:
    """Return a robot's compiled arm as a file of MuJoCo's (MJB), for the law in C."""
    return saved(load_arm(robot=robot))


class HandState(NamedTuple):
    """The hand's body, by the model, world frame; views that the next call overwrites."""

    position: Vector  # of its origin (3,) [m]
    orientation: Vector  # (w, x, y, z)
    jacobian: Vector  # of its origin (6, 7); rows 1-3 linear, 4-6 angular
    bias: Vector  # gravity, Coriolis and centrifugal forces of the joints (7,) [N.m]


class ArmModel:
    """Inertia of arm and hand, without a load, of a robot."""

    def __init__(self, robot: str = DEFAULT_ROBOT) -> None:
        self._model = load_arm(robot=robot)
        self._data: Any = mujoco.MjData(self._model)
        self._qpos, self._qvel = self._data.qpos[:7], self._data.qvel[:7]
        self._acceleration, self._force = np.zeros((2, self._model.nv))
        self._qdd, self._full = self._acceleration[:7], np.zeros((self._model.nv, self._model.nv))
        self._jac, self._hand = np.zeros((6, self._model.nv)), self._model.body("hand").id

    def _make_inertia(self, q: Vector) -> None:
        self._qpos[...] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_makeM(self._model, self._data)

    def inertia(self, q: Vector) -> Vector:
        """Return M(q) (7, 7) [kg.m2], rotor inertia included; a view that the next call writes."""
        self._make_inertia(q)
        mujoco.mj_fullM(self._model, self._data, self._full)
        return self._full[:7, :7]

    def inertia_force(self, q: Vector, qdd: Vector) -> Vector:
        """Return M(q) qdd (7,) [N.m], rotor inertia included, with the fingers at rest."""
        self._make_inertia(q)
        self._qdd[...] = qdd
        mujoco.mj_mulM(self._model, self._data, self._force, self._acceleration)
        return np.array(self._force[:7])

    def hand(self, q: Vector, qd: Vector) -> HandState:
        """Return where the hand is and what holds the arm, with closed fingers and no load."""
        model, data = self._model, self._data
        self._qpos[...], self._qvel[...] = q, qd
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._force)
        mujoco.mj_jacBody(model, data, self._jac[:3], self._jac[3:], self._hand)
        pose = data.xpos[self._hand], data.xquat[self._hand]
        return HandState(*pose, self._jac[:, :7], self._force[:7])

    def moved_by(self, jac: Vector) -> Vector:
        """Return J M^-1 (6, 7) of a Jacobian J (6, 7), where `hand` was last called."""
        rows, moved = np.zeros((2, 6, self._model.nv))
        rows[:, :7] = jac
        mujoco.mj_makeM(self._model, self._data)
        mujoco.mj_factorM(self._model, self._data)
        mujoco.mj_solveM(self._model, self._data, moved, rows)
        return np.array(moved[:, :7])
