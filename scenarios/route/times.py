"""The times of a route: its motions one after the other, as fast as the robot's limits allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import QD_MAX
from ...fmus.errors import InputError
from ..scenario.table import TableRow, TrajectoryTable
from ..scenario.trajectory import Trajectory
from ..timing.demand import demands
from ..timing.joint_reference import JointReference
from ..timing.stretch import ORDERS
from .scene import RouteScene

Array = NDArray[np.float64]

SPACING: Final = 0.02  # [s] between the knots of a motion, before it is slowed down
SPEED: Final = 0.5  # [1] of the joints' velocity limits along a path, before it is slowed down
WINDOWS: Final = (0.22, 0.12, 0.06)  # [s] a path's corners are rounded by averages over them
ROUNDS: Final = 12
SPARE: Final = 1.01
_ORDERS: Final = ORDERS | {"hand speed": 1.0, "hand acceleration": 2.0, "hand turn": 1.0}


@dataclass(frozen=True, eq=False)
class Motion:
    """Knots from rest to rest, evenly spaced in time."""

    knots: Array  # joint positions (n, 7) [rad]
    grip: float  # opening between the fingertips [m]
    spacing: float = SPACING  # [s]
    name: str = ""  # of the place where it begins

    @property
    def duration(self) -> float:
        """Time from its first knot to its last [s]."""
        return self.spacing * (len(self.knots) - 1)


def rounded(corners: Array, rounding: float) -> Array:
    """Return knots (m, 7) [rad] along corners (n, 7): a constant speed, averaged three times.

    That rounds the corners, and begins and ends at rest. `rounding` scales the averages [1].
    """
    spans = np.maximum(np.abs(np.diff(corners, axis=0) / QD_MAX).max(axis=1) / SPEED, STEP_SIZE)
    ends = np.concatenate(([0.0], np.cumsum(spans)))
    ticks = STEP_SIZE * np.arange(np.ceil(ends[-1] / STEP_SIZE) + 1.0)
    path = np.column_stack([np.interp(ticks, ends, joint) for joint in corners.T])
    for window in WINDOWS:
        count = max(round(rounding * window / STEP_SIZE), 1)
        padded = np.pad(path, ((count - 1, count - 1), (0, 0)), mode="edge")
        sums = np.cumsum(np.vstack((np.zeros((1, 7)), padded)), axis=0)
        path = (sums[count:] - sums[:-count]) / count
    path = np.vstack((corners[:1], path[1:-1], corners[-1:]))
    every = round(rounding * SPACING / STEP_SIZE)
    at = np.linspace(0, len(path) - 1, max(-(-(len(path) - 1) // every), 5) + 1).round().astype(int)
    knots: Array = path[at]
    return knots


def timed(
    scene: RouteScene, motions: Sequence[Motion], load: float, share: float, carry: float
) -> TrajectoryTable:
    """Return the table of motions that use at most a share of each limit [1].

    `load` is what the closed fingers carry [kg], with `carry` of that share.
    """
    poses = [np.array([scene.hand(q) for q in motion.knots]) for motion in motions]
    slower = np.ones(len(motions))
    for _ in range(ROUNDS):
        trajectory, ends = _trajectory(motions, poses, slower)
        ticks = STEP_SIZE * np.arange(round(ends[-1] / STEP_SIZE) + 1)
        commands = trajectory.sample(ticks)
        planned = JointReference(ticks, commands[:, 14:21], commands[:, 21:], np.zeros(len(ticks)))
        used = demands(trajectory, planned, load)
        factors = np.ones(len(motions))
        for number, (first, last) in enumerate(pairwise(np.searchsorted(ticks, ends))):
            most = share * (carry if motions[number].grip < _closed(motions) else 1.0)
            for name, values in used.items():
                worst = float(np.abs(values[first : last + 1]).max())
                limit = share if name in ("torque", "torque rate") else most
                if worst > limit:
                    factor = SPARE * (worst / limit) ** (1.0 / min(_ORDERS[name], 2.0))
                    factors[number] = max(factors[number], factor)
        if (factors == 1.0).all():
            return _table(motions, trajectory)
        slower *= factors
    raise InputError(f"no times within {share:.0%} of the limits were found")


def _closed(motions: Sequence[Motion]) -> float:
    return 0.5 * (min(m.grip for m in motions) + max(m.grip for m in motions))


def _trajectory(
    motions: Sequence[Motion], poses: Sequence[Array], slower: Array
) -> tuple[Trajectory, Array]:
    """Join the motions; returns the times [s] between them, too."""
    times, starts = [], [0.0]
    for motion, factor in zip(motions, slower, strict=True):
        spacing = factor * motion.spacing
        times.append(starts[-1] + spacing * np.arange(len(motion.knots) - 1))
        starts.append(starts[-1] + spacing * (len(motion.knots) - 1))
    joined = np.vstack([*(each[:-1] for each in poses), poses[-1][-1:]])
    knots = np.vstack([*(motion.knots[:-1] for motion in motions), motions[-1].knots[-1:]])
    grips = np.concatenate([np.full(len(m.knots) - 1, m.grip) for m in motions])
    orientations = joined[:, 3:] / np.linalg.norm(joined[:, 3:], axis=1, keepdims=True)
    trajectory = Trajectory(
        np.append(np.concatenate(times), starts[-1]).round(9),
        joined[:, :3],
        orientations,
        np.append(grips, motions[-1].grip),
        "spline",
        knots,
    )
    return trajectory, np.array(starts)


def _table(motions: Sequence[Motion], trajectory: Trajectory) -> TrajectoryTable:
    counts = [len(motion.knots) - 1 for motion in motions]
    names = dict(zip(np.cumsum([0, *counts]).tolist(), (m.name for m in motions), strict=False))
    rows = zip(trajectory.times, trajectory.positions, trajectory.orientations, trajectory.grips,
               trajectory.postures, strict=True)  # type: ignore[arg-type]  # fmt: skip
    return TrajectoryTable(
        tuple(
            TableRow(
                time=float(time),
                frame="world",
                position=tuple(position.tolist()),
                grip=float(grip),
                orientation=tuple(orientation.tolist()),
                posture=tuple(posture.tolist()),
                name=names.get(row, ""),
            )
            for row, (time, position, orientation, grip, posture) in enumerate(rows)
        )
    )
