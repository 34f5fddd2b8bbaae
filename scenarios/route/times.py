"""The times of a route: its motions one after the other, as fast as the robot's limits allow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import Q_MAX, Q_MIN, QD_MAX
from ...controller.limits import APPROACH_RATE
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
_ORDERS: Final = ORDERS | {"joint end": 1.0, "hand speed": 1.0, "hand acceleration": 2.0,
                           "hand turn": 1.0}  # fmt: skip
_GRAVITYS: Final = ("torque", "torque rate")  # which a load does not have to be carried slower for


class Motion(NamedTuple):
    """Knots from rest to rest, evenly spaced in time."""

    name: str  # of the place where it begins
    knots: Array  # joint positions (n, 7) [rad]
    grip: float  # opening between the fingertips [m]
    share: float = 1.0  # of what may be used of the limits [1]


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
        trajectory = Trajectory(times, poses[:, :3], _units(poses[:, 3:]), grips, "spline", knots)
        ticks = STEP_SIZE * np.arange(round(times[-1] / STEP_SIZE) + 1)
        at = motion[np.clip(np.searchsorted(times, ticks) - 1, 0, len(motion) - 1)]
        used = _demands(trajectory, ticks, load)
        factors = np.ones(len(motions))
        for number, name in ((n, name) for n in range(len(motions)) for name in used):
            limit = share * (1.0 if name in _GRAVITYS else motions[number].share)
            excess = float(used[name][at == number].max(initial=0.0)) / limit
            if excess > 1.0:
                factor = SPARE * excess ** (1.0 / min(_ORDERS[name], 2.0))
                factors[number] = max(factors[number], factor)
        if (factors == 1.0).all():
            return _table(motions, motion, trajectory)
        slower *= factors
    raise InputError(f"no times within {share:.0%} of the limits were found")


def _units(quaternions: Array) -> Array:
    units: Array = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return units


def _demands(trajectory: Trajectory, ticks: Array, load: float) -> dict[str, Array]:
    """Return the largest share of each limit at each tick (n,)."""
    commands = trajectory.sample(ticks)
    q, rate = commands[:, 14:21], commands[:, 21:]
    room = np.where(rate > 0.0, Q_MAX - q, q - Q_MIN)  # the law brakes a joint before its end
    used = demands(trajectory, JointReference(ticks, q, rate, np.zeros(len(ticks))), load)
    used["joint end"] = rate / (APPROACH_RATE * room)
    return {name: np.abs(values).max(axis=1) for name, values in used.items()}


def _table(
    motions: Sequence[Motion], motion: NDArray[np.intp], trajectory: Trajectory
) -> TrajectoryTable:
    begins = np.flatnonzero(np.diff(motion, prepend=-1))
    names = {int(row): each.name for row, each in zip(begins, motions, strict=True)}
    columns = (trajectory.times, trajectory.positions, trajectory.orientations, trajectory.grips)
    rows = zip(*(column.tolist() for column in (*columns, trajectory.postures)), strict=True)  # type: ignore[union-attr]
    return TrajectoryTable(
        tuple(
            TableRow(time, "world", tuple(position), grip, tuple(orientation),
                     posture=tuple(posture), name=names.get(row, ""))
            for row, (time, position, orientation, grip, posture) in enumerate(rows)
        )
    )  # fmt: skip
