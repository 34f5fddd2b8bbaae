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

ENDS: Final = 0.05  # [rad] that every posture keeps from the ends of the joints' ranges
LOW, HIGH = Q_MIN + ENDS, Q_MAX - ENDS  # [rad]
CLEARANCE: Final = 0.004  # [m] of everything that moves from everything else, on the finished path
PLANNED: Final = 0.02  # [m] the same where a path is planned, as its corners are rounded later
REACH: Final = 0.9  # [m] no point of the arm is further from a joint's axis
INSIDE: Final = 1e-4  # [m] deeper contact is none of rest
_REACHED: Final = 1e-7  # [m, rad] error of a posture for a pose of the hand
_ROUNDS: Final = 60
_STEP: Final = 0.4  # [rad] at most in a round
_FAR, _FAR_DAMPING, _DAMPING = 0.05, 1e-3, 1e-6  # an error [m, rad], and damping beyond and within
_SURROUNDINGS, _ARM, _GRIPPER, _BLOCK = range(4)  # kinds of geoms


class Load(Enum):
    """Whether the block is held; whether surroundings, and the gripper, may be near it."""

    STANDS = (False, True, False)
    GRASPED = (False, True, True)
    SET_DOWN = (True, True, True)
    HELD = (True, False, True)


class RouteScene:
    """Kinematics of arm and block, and distances by MuJoCo's own contacts.

    `block` is the pose of the standing block, `held` its pose in the hand's frame: position (3,)
    [m] and quaternion (w, x, y, z), and `opening` that between the fingertips [m]. All else is
    where `qpos` says.
    """

    def __init__(self, model: Any, qpos: Array, block: Array) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._data.qpos[:] = qpos
        self._hand = model.body("hand").id
        self._jac = np.zeros((6, model.nv))
        self._free = int(model.jnt_qposadr[model.body(BLOCK).jntadr[0]])
        self._kinds = np.array([_kind(model.body(body).name) for body in model.geom_bodyid])
        model.geom_margin[self._kinds != _SURROUNDINGS] = PLANNED
        model.body_margin[:] = PLANNED  # what MuJoCo looks for pairs by
        self._allowed = {load: _pairs(self._kinds, load) for load in Load}
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

    def can_stand(self, block: Array) -> bool:
        """Tell whether a block at a pose (7,) touches nothing but what it stands on."""
        contact = self._contacts(block)
        kinds = self._kinds[contact.geom]
        is_blocks = (kinds == _BLOCK).any(axis=1) & (kinds == _SURROUNDINGS).any(axis=1)
        return bool((contact.dist[is_blocks] > -INSIDE).all())

    def is_free(self, q: Array, load: Load, clearance: float = CLEARANCE) -> bool:
        """Tell whether joint positions (7,) [rad] are in range, and keep the clearance [m]."""
        if (q < Q_MIN + 0.9 * ENDS).any() or (q > Q_MAX - 0.9 * ENDS).any():
            return False
        block = self.held_block(q) if load.value[0] else self.block
        self._data.qpos[:7], self._data.qpos[7:9] = q, self.opening / 2.0
        contact = self._contacts(block)
        near = contact.geom[contact.dist < clearance]
        return bool(self._allowed[load][near[:, 0], near[:, 1]].all())

    def _contacts(self, block: Array) -> Any:
        """Contacts with the block at a pose (7,)."""
        data = self._data
        data.qpos[self._free : self._free + 7] = block
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        return data.contact

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
        for _ in range(_ROUNDS):
            hand = self.hand(q)
            error[:3] = pose[:3] - hand[:3]
            mujoco.mju_subQuat(turn, pose[3:], hand[3:])
            mujoco.mju_rotVecQuat(error[3:], turn, hand[3:])
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


def _pairs(kinds: NDArray[np.int_], load: Load) -> NDArray[np.bool_]:
    """Pairs of geoms (n, n) that may be near each other."""
    _, surroundings, gripper = load.value
    table = np.zeros((4, 4), bool)
    table[_GRIPPER, _GRIPPER] = table[_SURROUNDINGS, _SURROUNDINGS] = True
    table[_BLOCK, [_SURROUNDINGS, _GRIPPER]] = surroundings, gripper
    return (table | table.T)[kinds[:, None], kinds[None, :]]
