"""Which of the random moves from random starts exist: `python .ci/studies/straight_paths.py`.

The hand's path is straight, and the arm's posture at its start is given; the arm may turn about the
hand. At each place of the path, all postures are kept that the joints come to from those of the
place before, without leaving their ranges. Where none is left, no law can follow the path. The law,
speeds and contacts play no part, and the ranges are wider by `SLACK`, so that few are lost between
the postures that are looked at.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from numpy.typing import NDArray
from random_moves import Start, random_starts
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from panda_cosim.assets.franka import Q_MAX, Q_MIN
from panda_cosim.controller.model import load_arm

Array = NDArray[np.float64]

SPACING = 0.12  # [rad] between postures of one place
SLACK = 0.02  # [rad] by which the joints' ranges are wider
STEP, TURN = 0.02, 0.04  # [m], [rad] of the hand between two places
EXACT = 2e-5  # [m, rad]
DAMPING = 1e-6


def arm_frames() -> list[tuple[Array, Rotation, bool]]:
    """Offset and rotation of each body in the one before, from the base; whether it has a joint."""
    model, frames = load_arm(), []
    body = model.body("hand").id
    while body:
        turn = Rotation.from_quat(model.body_quat[body], scalar_first=True)
        frames.append((model.body_pos[body].copy(), turn, bool(model.body_jntnum[body])))
        body = model.body_parentid[body]
    return frames[::-1]


FRAMES = arm_frames()


def hand(q: Array) -> tuple[Array, Rotation, Array]:
    """Positions (n, 3), orientations and Jacobians (n, 6, 7) of postures (n, 7), world."""
    place, turn = np.zeros((len(q), 3)), Rotation.identity(len(q))
    axes, origins = [], []
    for offset, rotation, has_joint in FRAMES:
        place, turn = place + turn.apply(offset), turn * rotation
        if has_joint:
            axes.append(turn.apply([0.0, 0.0, 1.0]))
            origins.append(place)
            turn = turn * Rotation.from_rotvec(q[:, len(axes) - 1, None] * [0.0, 0.0, 1.0])
    linear = [np.cross(axis, place - origin) for axis, origin in zip(axes, origins, strict=True)]
    return place, turn, np.concatenate((np.stack(linear, 2), np.stack(axes, 2)), 1)


def moved_to(q: Array, place: Array, turn: Rotation, furthest: float) -> Array:
    """Postures near others at which the hand is at a pose and the joints within their ranges."""
    start = q
    for _ in range(6):
        place_now, turn_now, jac = hand(q)
        error = np.concatenate((place - place_now, (turn * turn_now.inv()).as_rotvec()), 1)
        square = jac @ jac.transpose(0, 2, 1) + DAMPING * np.eye(6)
        step = jac.transpose(0, 2, 1) @ np.linalg.solve(square, error[..., None])
        q = q + np.clip(step[..., 0], -0.2, 0.2)
    place_now, turn_now, _ = hand(q)
    error = np.concatenate((place - place_now, (turn * turn_now.inv()).as_rotvec()), 1)
    inside = ((q >= Q_MIN - SLACK) & (q <= Q_MAX + SLACK)).all(1)
    near = np.linalg.norm(q - start, axis=1) < furthest
    return np.asarray(q[inside & near & (np.linalg.norm(error, axis=1) < EXACT)])


def thinned(q: Array, spacing: float) -> Array:
    """Postures of which no two are closer than a spacing [rad]."""
    dropped: set[int] = set()
    for kept, other in sorted(cKDTree(q).query_pairs(spacing)):
        if kept not in dropped:
            dropped.add(other)
    return np.delete(q, list(dropped), axis=0)


def spread(q: Array, place: Array, turn: Rotation) -> Array:
    """Also all postures that the arm can turn to from these with the hand at rest."""
    front = q
    while len(front):
        null = np.linalg.svd(hand(front)[2])[2][:, -1]
        both = np.concatenate((front + SPACING * null, front - SPACING * null))
        front = moved_to(both, place, turn, SPACING)
        if len(front):
            front = thinned(front[cKDTree(q).query(front)[0] > 0.6 * SPACING], 0.6 * SPACING)
        q = np.concatenate((q, front))
    return q


def share_of_path(start: Start, goal: tuple[Array, Array]) -> float:
    """Share of the straight path up to which there are postures [1]."""
    first, last = (Rotation.from_quat(q, scalar_first=True) for q in (start.orientation, goal[1]))
    way, turn = goal[0] - start.position, (last * first.inv()).as_rotvec()
    steps = int(np.ceil(max(np.linalg.norm(way) / STEP, np.linalg.norm(turn) / TURN)))
    postures = start.q[None]
    for share in np.arange(steps + 1) / steps:
        pose = start.position + share * way, Rotation.from_rotvec(share * turn) * first
        postures = moved_to(postures, *pose, 0.5)
        if not len(postures):
            return float(max(share - 1.0 / steps, 0.0))
        postures = spread(thinned(postures, 0.3 * SPACING), *pose)
    return 1.0


def main() -> None:
    """Print which moves end before their goals, and how many do not."""
    parser = argparse.ArgumentParser(prog="python .ci/studies/straight_paths.py")
    parser.add_argument("--count", type=int, default=100, help="number of moves")
    with ProcessPoolExecutor() as pool:
        moves = random_starts(parser.parse_args().count)
        shares = list(pool.map(share_of_path, *zip(*moves, strict=True)))
    for number, share in enumerate(shares, 1):
        if share < 1.0:
            print(f"move {number}: ends after {share:.0%} of its path")
    print(f"{shares.count(1.0)} of {len(shares)} straight paths exist")


if __name__ == "__main__":
    main()
