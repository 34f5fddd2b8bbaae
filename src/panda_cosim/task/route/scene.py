"""The scene that a route leads through: postures of the arm, and what it may be near."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, Final

import mujoco
import numpy as np

from ...assets.fields import Array
from ...assets.franka import DEFAULT_ROBOT, HOME_Q, HOME_XQUAT, ROBOTS
from ...controller.ik import pose_error
from ...plant.parameters import ARM_AND_PALM, BLOCK, FINGERS
from .. import rotations

Lines = tuple[Array, Array]  # down and up, (n, 7) each [rad]

HOME: Final = np.array(HOME_Q)
SEED: Final = 1
ENDS: Final = 0.05  # [rad] that every posture keeps from the ends of the joints' ranges
ROOM, FEW = 0.35, 0.1  # [rad] to the ends: more is no better, less the last choice
CLEARANCE: Final = 0.004  # [m] of everything that moves from everything else, on the finished path
PLANNED: Final = 0.02  # [m] the same where a path is planned, as its corners are rounded later
REACH: Final = 0.9  # [m] no point of the arm is further from a joint's axis
ABOVE: Final = 0.06  # [m] over a place, where the hand comes from
KNOTS: Final = 25  # of a straight line
SAME_BRANCH: Final = 0.2  # [rad] between two of them
_REACHED: Final = 1e-7  # [m, rad] error of a posture for a pose of the hand
_ROUNDS: Final = 60
_STEP: Final = 0.4  # [rad] at most in a round
_FAR, _FAR_DAMPING, _DAMPING = 0.05, 1e-3, 1e-6  # an error [m, rad], and damping beyond and within
_SURROUNDINGS, _ARM, _GRIPPER, _BLOCK = range(4)  # kinds of geoms
_KINDS: Final = {  # by the body's name
    **dict.fromkeys(ARM_AND_PALM, _ARM), **dict.fromkeys((*FINGERS, "hand"), _GRIPPER),
    BLOCK: _BLOCK,
}  # fmt: skip


class Load(Enum):
    """Whether the block is held; whether surroundings, and the gripper, may be near it."""

    STANDS = (False, True, False)
    GRASPED = (False, True, True)
    SET_DOWN = (True, True, True)
    HELD = (True, False, True)


class RouteScene:
    """Kinematics of arm and block, and distances by MuJoCo's own contacts.

    A scenario whose route is planned makes one when it is prepared. It knows no time and no
    control, and steps nothing: dynamics are in `timing`.

    `block` is the pose of the standing block, `held` its pose in the hand's frame: position (3,)
    [m] and quaternion (w, x, y, z), and `opening` that between the fingertips [m]. All else is
    where `qpos` says. Postures are between `low` and `high` (7,) [rad], away from the joints' ends.
    """

    def __init__(self, model: Any, qpos: Array, block: Array, robot: str = DEFAULT_ROBOT) -> None:
        self.robot, ends = robot, ROBOTS[robot]
        self.low, self.high = ends.q_min + ENDS, ends.q_max - ENDS
        self._model, self._data = model, mujoco.MjData(model)
        self._data.qpos[:] = qpos
        self._hand, self._jac = model.body("hand").id, np.zeros((6, model.nv))
        self._free = int(model.jnt_qposadr[model.body(BLOCK).jntadr[0]])
        names = [model.body(body).name for body in model.geom_bodyid]
        self._kinds = np.array([_KINDS.get(name, _SURROUNDINGS) for name in names])
        model.geom_margin[self._kinds != _SURROUNDINGS] = PLANNED
        model.body_margin[:] = PLANNED  # what MuJoCo looks for pairs by
        self.block, self.held, self.opening = block, block, 0.0

    def hand(self, q: Array) -> Array:
        """Return the hand's pose (7,) at joint positions (7,) [rad]."""
        self._data.qpos[:7] = q
        mujoco.mj_kinematics(self._model, self._data)
        return np.concatenate((self._data.xpos[self._hand], self._data.xquat[self._hand]))

    def grasp(self, q: Array) -> None:
        """Take the block, where it stands, into the hand at joint positions (7,) [rad]."""
        hand, back = self.hand(q), np.empty(7)
        mujoco.mju_negPose(back[:3], back[3:], hand[:3], hand[3:])
        self.held = _product(back, self.block)

    def release(self, q: Array) -> None:
        """Let the held block stand where it is at joint positions (7,) [rad]."""
        self.block = _product(self.hand(q), self.held)

    def is_free(self, q: Array, load: Load, clearance: float = CLEARANCE) -> bool:
        """Tell whether joint positions (7,) [rad] are in range, and keep the clearance [m]."""
        if (q < self.low - 1e-3).any() or (q > self.high + 1e-3).any():
            return False
        is_held, surroundings, gripper = load.value
        block = _product(self.hand(q), self.held) if is_held else self.block
        self._data.qpos[:7], self._data.qpos[7:9] = q, self.opening / 2.0
        self._data.qpos[self._free : self._free + 7] = block
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        one, other = np.sort(self._kinds[contact.geom[contact.dist < clearance]], axis=1).T
        allowed = (one == other) & ((one == _GRIPPER) | (one == _SURROUNDINGS))
        allowed |= (other == _BLOCK) & (one == _SURROUNDINGS) & surroundings
        allowed |= (other == _BLOCK) & (one == _GRIPPER) & gripper
        return bool(allowed.all())

    def are_free(self, path: Array, load: Load) -> bool:
        """Tell whether a path (n, 7) [rad] is free, with no way between two checks too long."""
        way = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))))
        checked = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], spacing(CLEARANCE))))
        return all(self.is_free(path[i], load) for i in (*checked, len(path) - 1))

    def lines(  # noqa: PLR0913 - all that they depend on
        self, place: Array, yaw: float, rise: float, loads: tuple[Load, Load],
        between: Callable[[Array], None], starts: int,
    ) -> Iterator[Lines]:  # fmt: skip
        """Yield the lines down to the hand's place (3,) [m] and up again by `rise` [m], best first.

        `loads` are those of both lines, and `between` is called with the posture where they meet.
        """
        for above in self._postures(place + np.array([0.0, 0.0, ABOVE]), yaw, starts):
            down = self._line(above, -ABOVE, loads[0])
            if down is not None:
                between(down[-1])
                up = self._line(down[-1], rise, loads[1])
                if up is not None:
                    yield down, up

    def _postures(self, place: Array, yaw: float, starts: int) -> list[Array]:
        """Return postures (7,) [rad] with the hand at a place (3,) [m], pointing down, best first.

        The block has four sides. A number of random postures is tried for each, besides `home`
        turned to the place. Those far from the joints' ends and close to `home` are best.
        """
        random, rated = np.random.default_rng(SEED), []
        near = np.clip([math.atan2(place[1], place[0]), *HOME[1:]], self.low, self.high)
        for side in range(4):
            turn = rotations.about_z(math.remainder(yaw + side * math.pi / 2, 2 * math.pi))
            pose = np.concatenate((place, rotations.multiply(turn, np.array(HOME_XQUAT))))
            for start in (near, *random.uniform(self.low, self.high, (starts, 7))):
                q = self.posture(start, pose)
                if q is not None:
                    room = ENDS + float(np.minimum(q - self.low, self.high - q).min())
                    effort = 0.05 * float(np.abs(q - HOME).sum())
                    rated.append((effort - min(room, ROOM) + (room < FEW), tuple(q)))
        return [np.array(q) for _, q in sorted(rated)]

    def _line(self, q: Array, rise: float, load: Load) -> Array | None:
        """Return postures (n, 7) [rad] as the hand rises from q [m], from rest to rest; None: none.

        It sinks where `rise` is negative.
        """
        pose, u, path = self.hand(q), np.linspace(0.0, 1.0, KNOTS + 1), [q]
        for height in rise * (u**3 * (10.0 + u * (6.0 * u - 15.0)))[1:]:
            following = self.posture(path[-1], pose + np.array([0, 0, height, 0, 0, 0, 0]))
            if following is None or np.abs(following - path[-1]).max() > SAME_BRANCH:
                return None
            path.append(following)
        return np.array(path) if self.are_free(np.array(path), load) else None

    def posture(self, q: Array, pose: Array) -> Array | None:
        """Return joint positions (7,) [rad] for a pose of the hand (7,), near q; None: not found.

        Damped least squares, Ref: Nakamura and Hanafusa, 1986.
        """
        jac = self._jac
        for _ in range(_ROUNDS):
            hand = self.hand(q)
            error = pose_error(pose[:3], pose[3:], hand[:3], hand[3:])
            size = float(np.linalg.norm(error))
            if size < _REACHED:
                return q
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_jacBody(self._model, self._data, jac[:3], jac[3:], self._hand)
            arm, damping = jac[:, :7], _FAR_DAMPING if size > _FAR else _DAMPING
            change = arm.T @ np.linalg.solve(arm @ arm.T + damping * np.eye(6), error)
            change *= min(1.0, _STEP / float(np.abs(change).max()))
            q = np.clip(q + change, self.low, self.high)
        return None


def spacing(clearance: float) -> float:
    """Return the way between two checks [rad] on which no point moves past the clearance [m]."""
    return 2.0 * clearance / REACH


def _product(one: Array, other: Array) -> Array:
    """Return the pose (7,) of what is at the pose `other` in the frame of the pose `one`."""
    pose = np.empty(7)
    mujoco.mju_mulPose(pose[:3], pose[3:], one[:3], one[3:], other[:3], other[3:])
    return pose
