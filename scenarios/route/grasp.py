"""Lines on which the hand goes straight down to a place, and straight up again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import HOME_Q, HOME_XQUAT, Q_MAX, Q_MIN
from .. import rotations
from .scene import HIGH, LOW, Load, RouteScene

Array = NDArray[np.float64]
Lines = tuple[Array, Array]  # down and up, (n, 7) each [rad]

SEED: Final = 1
KNOTS: Final = 25  # of a straight line
SAME_BRANCH: Final = 0.2  # [rad] between two knots of a line
ABOVE: Final = 0.06  # [m] over a place, where the hand comes from
ROOM: Final = 0.35  # [rad] to the ends of the joints, more of which is no better
FEW: Final = 0.1  # [rad] the same, less of which is the last choice
_HOME: Final = np.array(HOME_Q)


def lines(  # noqa: PLR0913 - all that they depend on
    scene: RouteScene,
    place: Array,
    yaw: float,
    rise: float,
    loads: tuple[Load, Load],
    between: Callable[[Array], None],
    starts: int,
) -> Iterator[Lines]:
    """Yield the lines down to the hand's place (3,) [m] and up again by `rise` [m], best first.

    `loads` are those of both lines, and `between` is called with the posture where they meet.
    """
    for above in _postures(scene, place + np.array([0.0, 0.0, ABOVE]), yaw, starts):
        down = _line(scene, above, -ABOVE, loads[0])
        if down is None:
            continue
        between(down[-1])
        up = _line(scene, down[-1], rise, loads[1])
        if up is not None:
            yield down, up


def _postures(scene: RouteScene, place: Array, yaw: float, starts: int) -> list[Array]:
    """Return postures (7,) [rad] with the hand at a place (3,) [m], pointing down, best first.

    The block has four sides. A number of random postures is tried for each, besides `home` turned
    to the place. Those far from the joints' ends and close to `home` are best.
    """
    random, rated = np.random.default_rng(SEED), []
    near = np.array([math.atan2(place[1], place[0]), *_HOME[1:]])
    for side in range(4):
        turn = rotations.about_z(math.remainder(yaw + side * math.pi / 2, 2 * math.pi))
        pose = np.concatenate((place, rotations.multiply(turn, np.array(HOME_XQUAT))))
        for start in (np.clip(near, LOW, HIGH), *random.uniform(LOW, HIGH, (starts, 7))):
            q = scene.posture(start, pose)
            if q is not None:
                room = float(np.minimum(q - Q_MIN, Q_MAX - q).min())
                effort = 0.05 * float(np.abs(q - _HOME).sum())
                rated.append((effort - min(room, ROOM) + (room < FEW), tuple(q)))
    return [np.array(q) for _, q in sorted(rated)]


def _line(scene: RouteScene, q: Array, rise: float, load: Load) -> Array | None:
    """Return postures (n, 7) [rad] as the hand rises from q [m], from rest to rest; None: no way.

    It sinks where `rise` is negative.
    """
    pose = scene.hand(q)
    u = np.linspace(0.0, 1.0, KNOTS + 1)
    path = [q]
    for height in rise * (u**3 * (10.0 + u * (6.0 * u - 15.0)))[1:]:
        following = scene.posture(path[-1], pose + np.array([0, 0, height, 0, 0, 0, 0]))
        if following is None or np.abs(following - path[-1]).max() > SAME_BRANCH:
            return None
        path.append(following)
    line = np.array(path)
    return line if scene.are_free(line, load) else None
