"""The scene that a route leads through: where hand and block are, and what the arm may be near."""

from __future__ import annotations

from enum import Enum
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assets.franka import Q_MAX, Q_MIN
from ...plant.parameters import ARM_AND_PALM, BLOCK, FINGERS

Array = NDArray[np.float64]

ENDS: Final = 0.1  # [rad] that every posture keeps from the ends of the joints' ranges
LOW, HIGH = Q_MIN + ENDS, Q_MAX - ENDS  # [rad]
CLEARANCE: Final = 0.004  # [m] of everything that moves from everything else, on the finished path
PLANNED: Final = 0.02  # [m] the same where a path is planned, as its corners are rounded later
REACH: Final = 0.9  # [m] no point of the arm is further from a joint's axis
INSIDE: Final = 1e-4  # [m] deeper contact is none of rest
_REACHED: Final = 1e-7  # [m, rad] error of a posture for a pose of the hand
_ROUNDS: Final = 60
_STEP: Final = 0.4  # [rad] at most in a round
_FAR, _FAR_DAMPING, _DAMPING = 0.05, 1e-3, 1e-6  # an error [m, rad], and damping beyond and within


class Load(Enum):
    """Where the block is, and what may be near it."""

    STANDS = "the block stands, and nothing may be near it"
    GRASPED = "the block stands, and the gripper may be near it"
    SET_DOWN = "the block is held, and may be near what it stands on"
    HELD = "the block is held, and only the gripper may be near it"


_SURROUNDINGS, _ARM, _GRIPPER, _BLOCK = range(4)
_MAY_BE_NEAR: Final = {
    Load.STANDS: [(_SURROUNDINGS, _BLOCK)],
    Load.GRASPED: [(_SURROUNDINGS, _BLOCK), (_GRIPPER, _BLOCK)],
    Load.SET_DOWN: [(_SURROUNDINGS, _BLOCK), (_GRIPPER, _BLOCK)],
    Load.HELD: [(_GRIPPER, _BLOCK)],
}


class RouteScene:
    """Kinematics of arm and block, and distances by MuJoCo's own contacts.

    `block` is the pose of the standing block, `held` its pose in the hand's frame: position (3,)
    [m] and quaternion (w, x, y, z), and `opening` that between the fingertips [m].
    """

    def __init__(self, model: Any, block: Array) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._hand = model.body("hand").id
        self._jac = np.zeros((6, model.nv))
        self._free = int(model.jnt_qposadr[model.body(BLOCK).jntadr[0]])
        kinds = np.array([_kind(model.body(body).name) for body in model.geom_bodyid])
        self._kinds = kinds
        model.geom_margin[kinds != _SURROUNDINGS] = PLANNED
        model.body_margin[:] = PLANNED  # what MuJoCo looks for pairs by
        self._allowed = {load: _pairs(kinds, near) for load, near in _MAY_BE_NEAR.items()}
        self.block, self.held, self.opening = block, block, 0.0

    def hand(self, q: Array) -> Array:
        """Return the hand's pose (7,) at joint positions (7,) [rad]."""
        self._data.qpos[:7] = q
        mujoco.mj_kinematics(self._model, self._data)
        return np.concatenate((self._data.xpos[self._hand], self._data.xquat[self._hand]))

    def grasp(self, q: Array) -> None:
        """Take the block, where it stands, into the hand at joint positions (7,) [rad]."""
        hand, back, held, block = self.hand(q), np.empty(7), np.empty(7), self.block
        mujoco.mju_negPose(back[:3], back[3:], hand[:3], hand[3:])
        mujoco.mju_mulPose(held[:3], held[3:], back[:3], back[3:], block[:3], block[3:])
        self.held = held

    def held_block(self, q: Array) -> Array:
        """Return the pose (7,) of the held block at joint positions (7,) [rad]."""
        hand, pose = self.hand(q), np.empty(7)
        mujoco.mju_mulPose(pose[:3], pose[3:], hand[:3], hand[3:], self.held[:3], self.held[3:])
        return pose

    def stands(self) -> bool:
        """Tell whether the block touches nothing but what it stands on."""
        data = self._data
        data.qpos[self._free : self._free + 7] = self.block
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        kinds = self._kinds[data.contact.geom]
        is_blocks = (kinds == _BLOCK).any(axis=1) & (kinds == _SURROUNDINGS).any(axis=1)
        return bool((data.contact.dist[is_blocks] > -INSIDE).all())

    def is_free(self, q: Array, load: Load, clearance: float = CLEARANCE) -> bool:
        """Tell whether joint positions (7,) [rad] are in range, and keep the clearance [m]."""
        if (q < Q_MIN + 0.9 * ENDS).any() or (q > Q_MAX - 0.9 * ENDS).any():
            return False
        data = self._data
        is_held = load in (Load.HELD, Load.SET_DOWN)
        data.qpos[self._free : self._free + 7] = self.held_block(q) if is_held else self.block
        data.qpos[:7], data.qpos[7:9] = q, self.opening / 2.0
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        near = data.contact.geom[data.contact.dist < clearance]
        return bool(self._allowed[load][near[:, 0], near[:, 1]].all())

    def are_free(self, path: Array, load: Load) -> bool:
        """Tell whether a path (n, 7) [rad] is free, with no way between two checks too long."""
        way = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))))
        checked = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], spacing(CLEARANCE))))
        return all(self.is_free(path[i], load) for i in (*checked, len(path) - 1))

    def posture(self, q: Array, pose: Array) -> Array | None:
        """Return joint positions (7,) [rad] for a pose of the hand (7,), near q; None: not found.

        Damped least squares, Ref: Nakamura and Hanafusa, 1986.
        """
        data, error, turn = self._data, np.empty(6), np.empty(3)
        q = q.copy()
        for _ in range(_ROUNDS):
            data.qpos[:7] = q
            mujoco.mj_kinematics(self._model, data)
            error[:3] = pose[:3] - data.xpos[self._hand]
            mujoco.mju_subQuat(turn, pose[3:], data.xquat[self._hand])
            mujoco.mju_rotVecQuat(error[3:], turn, data.xquat[self._hand])
            size = float(np.linalg.norm(error))
            if size < _REACHED:
                return q
            mujoco.mj_comPos(self._model, data)
            mujoco.mj_jacBody(self._model, data, self._jac[:3], self._jac[3:], self._hand)
            jac = self._jac[:, :7]
            damping = _FAR_DAMPING if size > _FAR else _DAMPING
            change = jac.T @ np.linalg.solve(jac @ jac.T + damping * np.eye(6), error)
            change *= min(1.0, _STEP / max(float(np.abs(change).max()), 1e-12))
            q = np.clip(q + change, LOW, HIGH)
        return None


def spacing(clearance: float) -> float:
    """Return the way between two checks [rad] on which no point moves past the clearance [m]."""
    return 2.0 * clearance / REACH


def _kind(body: str) -> int:
    if body in (*FINGERS, "hand"):
        return _GRIPPER
    return _ARM if body in ARM_AND_PALM else _BLOCK if body == BLOCK else _SURROUNDINGS


def _pairs(kinds: NDArray[np.int_], near: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Pairs of geoms (n, n) that may be near each other."""
    table = np.zeros((4, 4), bool)
    for one, other in [*near, (_GRIPPER, _GRIPPER), (_SURROUNDINGS, _SURROUNDINGS)]:
        table[one, other] = table[other, one] = True
    return table[kinds[:, None], kinds[None, :]]
