"""Computes the shortest times of a table that the robot's limits allow; dwells keep their length.

The path between two stops gets a time-optimal law (toppra), averaged over a window to limit jerk
and torque rate. The joint reference that the controller computes from it is then measured against
the limits, and the law's bounds are corrected, a few times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_XPOS, HOME_XQUAT
from ...controller.gains import Gains
from ...fmus.errors import InputError
from ..definition.table import TableRow, TrajectoryTable
from ..definition.trajectory import StartPose, Trajectory
from .demand import ArmDynamics, Shares, demands, largest
from .joint_reference import JointReference, joint_reference
from .path import Motion, motions
from .time_law import NODES, Bounds, time_law

Array = NDArray[np.float64]

SPACING: Final = 10  # [ticks] between rows of the new table, at most
SLOW: Final = 0.25  # [m/s] mean speed in the first round
ROUNDS: Final = 8  # of correction; later ones gain less than 10 ms
AIM: Final = 0.98  # of the given share, so that the rounds end below it
ROUNDING: Final = 1e-6  # of a share
DIGITS: Final = 9  # decimals of a row's numbers


@dataclass(frozen=True)
class Timing:
    """A table with new times.

    Attributes:
        table: Rows in the world, to be interpolated by `spline`.
        shares: The largest share of each limit that it uses [1].
    """

    table: TrajectoryTable
    shares: Shares

    @property
    def trajectory(self) -> Trajectory:
        """Commands that follow the table."""
        nowhere = StartPose(HOME_XPOS, HOME_XQUAT, (0.0, 0.0, 0.0))  # all rows are in the world
        return Trajectory.from_table(self.table, nowhere, interpolation="spline")

    @property
    def cycle(self) -> float:
        """Time of the last row [s]."""
        return float(self.table.rows[-1].time)


@dataclass(frozen=True, eq=False)
class _Course:
    """The hand's pose at each tick from the first row on.

    Attributes:
        poses: Position and orientation (n, 7).
        rows: The row passed last (n,).
        stops: Ticks at which motions start and end, the first and last tick included.
        starts: Tick at which each motion starts.
    """

    poses: Array
    rows: NDArray[np.intp]
    stops: list[int]
    starts: list[int]


def retimed(
    trajectory: Trajectory, blends: Array, gains: Gains, load: float, share: float
) -> Timing:
    """Compute new times for a trajectory.

    Args:
        trajectory: Rows in the world; its dwells are kept.
        blends: Distance from each row within which its corner may be rounded (n,) [m].
        gains: The controller's gains.
        load: Mass that the fingers carry [kg].
        share: Share of each limit that may be used [1].

    Raises:
        InputError: The arm cannot follow the path, or toppra is missing.
    """
    parts, dynamics = motions(trajectory, blends), ArmDynamics(load)
    bounds = [Bounds.of(share)] * len(parts)
    laws = [_slow(part) for part in parts]
    found: list[Timing] = []
    for number in range(ROUNDS):
        course = _course(trajectory, parts, laws)
        made = Timing(_table(trajectory, course), {})
        reference = _reference(made.trajectory, gains)
        demanded = demands(made.trajectory, reference, load)
        if number:  # the first round only finds the joint motion along the path
            found.append(replace(made, shares=largest(demanded)))
            spans = zip(course.starts, [*course.starts[1:], None], strict=True)
            used = [largest(demanded, *span) for span in spans]
            bounds = [b.corrected(each, AIM * share) for b, each in zip(bounds, used, strict=True)]
        joints = _joints(parts, laws, course, reference)
        laws = [time_law(*each, dynamics) for each in zip(parts, joints, bounds, strict=True)]
    within = [timing for timing in found if max(timing.shares.values()) <= share + ROUNDING]
    if not within:
        most, at = max((value, name) for name, value in found[-1].shares.items())
        raise InputError(
            f"no timing within {share:.0%} of the limits was found: {at} stays at {most:.0%}; the "
            "path must stay away from singularities, such as the stretched arm; "
            "`panda-cosim check` names the rows"
        )
    return min(within, key=lambda timing: timing.cycle)


def _slow(part: Motion) -> Array:
    """Law of the first round, which only finds the joint motion along the path."""
    ticks = int(np.ceil(part.length / SLOW / STEP_SIZE)) + 500
    u = np.linspace(0.0, 1.0, ticks + 1)
    law: Array = part.length * u**3 * (10.0 + u * (6.0 * u - 15.0))
    return law


def _course(trajectory: Trajectory, parts: list[Motion], laws: list[Array]) -> _Course:
    """Join the motions, with the dwells between them."""
    corners = np.hstack((trajectory.positions, trajectory.orientations))
    passed: list[NDArray[np.intp]] = []
    poses: list[Array] = []
    stops, starts, now, row = [0], [], 0, 0
    for part, law in [*zip(parts, laws, strict=True), (None, None)]:
        until = int(part.rows[0]) if part else len(trajectory.times) - 1
        passed.append(_dwell(trajectory, row, until))
        poses.append(corners[passed[-1]])
        now += len(passed[-1])
        if part is None or law is None:
            break
        passed.append(part.passed(law[:-1]))
        poses.append(part.poses(law[:-1]))
        starts.append(now)
        stops.append(now)
        now += len(law) - 1
        stops.append(now)
        row = int(part.rows[-1])
    last = np.array([len(trajectory.times) - 1])
    return _Course(
        np.vstack((*poses, corners[last])), np.concatenate((*passed, last)), [*stops, now], starts
    )


def _dwell(trajectory: Trajectory, row: int, until: int) -> NDArray[np.intp]:
    """Return the row passed last at each tick of a dwell up to `until`."""
    length = trajectory.times[until] - trajectory.times[row]
    times = trajectory.times[row] + STEP_SIZE * np.arange(round(length / STEP_SIZE))
    last: NDArray[np.intp] = np.searchsorted(trajectory.times, times + 0.5 * STEP_SIZE, "right") - 1
    return last


def _table(trajectory: Trajectory, course: _Course) -> TrajectoryTable:
    """Write a course as rows, one at each stop and at most `SPACING` ticks between them."""
    ticks = {len(course.poses) - 1}
    for first, last in pairwise(course.stops):
        count = -(-(last - first) // SPACING)
        ticks |= set(np.linspace(first, last, count + 1).round().astype(int).tolist())
    start = float(trajectory.times[0])
    return TrajectoryTable(
        tuple(
            TableRow(
                time=round(start + tick * STEP_SIZE, DIGITS),
                frame="world",
                position=tuple(course.poses[tick, :3].round(DIGITS).tolist()),
                grip=float(trajectory.grips[course.rows[tick]]),
                orientation=tuple(course.poses[tick, 3:].round(DIGITS).tolist()),
            )
            for tick in sorted(ticks)
        )
    )


def _reference(path: Trajectory, gains: Gains) -> JointReference:
    first, last = path.times[0], path.times[-1]
    times = first + STEP_SIZE * np.arange(round((last - first) / STEP_SIZE) + 1)
    return joint_reference(path, times, gains)


def _joints(
    parts: list[Motion], laws: list[Array], course: _Course, reference: JointReference
) -> list[Array]:
    """Return each motion's joint positions at `NODES` points (n, 7) [rad]."""
    found = []
    for part, law, start in zip(parts, laws, course.starts, strict=True):
        q = reference.position[start : start + len(law)]
        at = np.interp(np.linspace(0.0, part.length, NODES), law, np.arange(len(law)))
        found.append(np.column_stack([np.interp(at, np.arange(len(q)), joint) for joint in q.T]))
    return found
