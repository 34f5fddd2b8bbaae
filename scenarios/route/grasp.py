"""Postures from which the hand goes straight down to a place, and straight up again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import HOME_Q, HOME_XQUAT, Q_MAX, Q_MIN
from .. import rotations
from .scene import HIGH, LOW, Load, RouteScene

Array = NDArray[np.float64]

SEED: Final = 1
STARTS: Final = 8  # of the search for postures, random ones for each of the block's four sides
KNOTS: Final = 25  # of a straight line
ROOM: Final = 0.35  # [rad] to the ends of the joints, more of which is no better
_HOME: Final = np.array(HOME_Q)


def poses(place: Array, yaw: float) -> list[Array]:
    """Return the hand's poses (7,) at a place (3,) [m], pointing down: the block has four sides."""
    turns = [math.remainder(yaw + k * math.pi / 2, 2 * math.pi) for k in range(4)]
    return [
        np.concatenate((place, rotations.multiply(rotations.about_z(turn), np.array(HOME_XQUAT))))
        for turn in turns
    ]


def candidates(scene: RouteScene, places: list[Array], rise: float) -> Iterator[Array]:
    """Yield postures (7,) [rad] at a height `rise` [m] above poses of the hand, the best first.

    Those far from the joints' ends and close to `home` are best.
    """
    random = np.random.default_rng(SEED)
    rated = []
    for pose in places:
        above = raised(pose, rise)
        near = np.array([math.atan2(pose[1], pose[0]), *_HOME[1:]])
        for start in (np.clip(near, LOW, HIGH), *random.uniform(LOW, HIGH, (STARTS, 7))):
            q = scene.posture(start, above)
            if q is not None:
                room = float(np.minimum(q - Q_MIN, Q_MAX - q).min())
                rated.append((0.05 * float(np.abs(q - _HOME).sum()) - min(room, ROOM), tuple(q)))
    yield from (np.array(q) for _, q in sorted(rated))


def line(scene: RouteScene, q: Array, rise: float) -> Array | None:
    """Return postures (n, 7) [rad] as the hand rises from q, from rest to rest; None: no way.

    It sinks where `rise` is negative [m].
    """
    pose = scene.hand(q)
    u = np.linspace(0.0, 1.0, KNOTS + 1)
    path = [q]
    for share in (u**3 * (10.0 + u * (6.0 * u - 15.0)))[1:]:
        following = scene.posture(path[-1], raised(pose, share * rise))
        if following is None or np.abs(following - path[-1]).max() > 0.2:  # [rad] another branch
            return None
        path.append(following)
    return np.array(path)


def free_line(scene: RouteScene, q: Array, rise: float, load: Load) -> Array | None:
    """Return a line that keeps the clearance; None: there is none."""
    path = line(scene, q, rise)
    return path if path is not None and scene.are_free(path, load) else None


def raised(pose: Array, rise: float) -> Array:
    """Return a pose (7,) that is so much higher [m]."""
    higher: Array = pose + np.array([0.0, 0.0, rise, 0.0, 0.0, 0.0, 0.0])
    return higher
