"""The motions of a route, each from rest to rest, as fast as the robot's limits allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...assets.franka import QD_MAX, ROBOTS
from ...controller.limits import APPROACH_RATE
from ...fmus.errors import InputError
from ..table import TrajectoryTable, world_table
from ..timing.demand import demands
from ..timing.joint_reference import JointReference
from ..timing.stretched import ORDERS
from ..trajectory import Trajectory
from .scene import RouteScene

SPACING: Final = 0.02  # [s] between the knots of a motion, before it is slowed down
SPEED: Final = 0.5  # [1] of the joints' velocity limits along a path, before it is slowed down
WINDOWS: Final = (0.22, 0.12, 0.06)  # [s] a path's corners are rounded by averages over them
ROUNDS: Final = 12
SPARE: Final = 1.01


class Motion(NamedTuple):
    """Knots from rest to rest, evenly spaced in time."""

    name: str  # of the place where it begins
    knots: Array  # joint positions (n, 7) [rad]
    grip: float  # opening between the fingertips [m]
    share: float = 1.0  # of what may be used of the limits, but those of the torques [1]


def rounded(corners: Array, rounding: float) -> tuple[Array, Array]:
    """Return a path (m, 7) [rad] along corners (n, 7), one point each ms, and knots along it.

    A constant speed is averaged three times, which rounds the corners, and begins and ends at rest.
    `rounding` scales the averages [1].
    """
    spans = np.maximum(np.abs(np.diff(corners, axis=0) / QD_MAX).max(axis=1) / SPEED, STEP_SIZE)
    ends = np.concatenate(([0.0], np.cumsum(spans)))
    ticks = STEP_SIZE * np.arange(np.ceil(ends[-1] / STEP_SIZE) + 1.0)
    path = np.column_stack([np.interp(ticks, ends, joint) for joint in corners.T])
    for window in WINDOWS:
        count = max(round(rounding * window / STEP_SIZE), 1)
        padded = np.pad(path, ((count, count - 1), (0, 0)), mode="edge")
        sums = np.cumsum(padded - path[0], axis=0)
        path = path[0] + (sums[count:] - sums[:-count]) / count
    knots = max(int(len(path) * STEP_SIZE / (rounding * SPACING)), 5)
    return path, path[np.linspace(0, len(path) - 1, knots + 1).round().astype(int)]


def timed(
    scene: RouteScene, motions: Sequence[Motion], load: float, share: float
) -> TrajectoryTable:
    """Return the table of motions that use at most a share of each limit [1].

    `load` is what the closed fingers carry [kg].
    """
    motion = np.repeat(np.arange(len(motions)), [len(each.knots) - 1 for each in motions])
    knots = np.vstack([*(each.knots[:-1] for each in motions), motions[-1].knots[-1:]])
    poses = np.array([scene.hand(q) for q in knots])
    grips = np.array([each.grip for each in motions])[np.append(motion, -1)]
    slower = np.ones(len(motions))
    for _ in range(ROUNDS):
        times = np.concatenate(([0.0], np.cumsum(SPACING * slower[motion]))).round(9)
        trajectory = Trajectory(times, poses[:, :3], poses[:, 3:], grips, "spline", knots)
        ticks = STEP_SIZE * np.arange(round(times[-1] / STEP_SIZE) + 1)
        at = motion[np.clip(np.searchsorted(times, ticks) - 1, 0, len(motion) - 1)]
        used = _demands(trajectory, ticks, load, scene.robot)
        factors = [_factor(used, at == i, share, each.share) for i, each in enumerate(motions)]
        slower *= factors
        if max(factors) == 1.0:
            begins = np.flatnonzero(np.diff(motion, prepend=-1)).tolist()
            names = {row: each.name for row, each in zip(begins, motions, strict=True)}
            return world_table(times, np.hstack((poses, knots)), grips, names)
    raise InputError(f"no times within {share:.0%} of the limits were found")


def _factor(
    used: Mapping[str, Array], during: NDArray[np.bool_], share: float, own: float
) -> float:
    """Return how many times slower a motion must be; it may use its `own` share, but of torques."""
    factor = 1.0
    for name, shares in used.items():
        limit = share * (1.0 if "torque" in name else own)
        excess = float(shares[during].max(initial=0.0)) / limit
        if excess > 1.0:
            factor = max(factor, SPARE * excess ** (1.0 / min(ORDERS.get(name, 1.0), 2.0)))
    return factor


def _demands(trajectory: Trajectory, ticks: Array, load: float, robot: str) -> dict[str, Array]:
    """Return the largest share of each limit at each tick (n,)."""
    q, rate = np.split(trajectory.sample(ticks)[:, 14:], 2, axis=1)
    reference = JointReference(ticks, q, rate, np.zeros(len(ticks)), robot)
    used = demands(trajectory, reference, load)
    ends = ROBOTS[robot]
    room = np.where(rate > 0.0, ends.q_max - q, q - ends.q_min)  # where the law brakes a joint
    used["joint end"] = rate / (APPROACH_RATE * room)
    return {name: np.abs(shares).max(axis=1) for name, shares in used.items()}
