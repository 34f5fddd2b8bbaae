"""The shortest times of a table that the robot's limits allow.

Dwells keep their length. The path between two stops gets a time-optimal law (toppra), averaged over
a window to limit jerk and torque rate. The joint reference that the controller computes from it is
then measured against the limits, and the law's bounds are corrected, a few times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, repeat
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...assets.franka import HOME_XPOS, HOME_XQUAT
from ...controller.gains import Gains
from ...fmus.errors import InputError
from ..table import TrajectoryTable, world_table
from ..trajectory import StartPose, Trajectory
from .demand import (
    AWAY,
    REACH_TOLERANCE,
    SLOWEST,
    SPEED,
    WAY_TOLERANCE,
    ArmDynamics,
    Timing,
    demands,
    largest,
    remedy,
)
from .joint_reference import JointReference, joint_reference
from .path import Motion, motions
from .time_law import (
    BOUNDED,
    NODES,
    SPIKY,
    Bounds,
    NoTimingError,
    lowered,
    time_law,
    without_spikes,
)

SPACING: Final = 10  # [ticks] between rows of the new table, at most
SLOW: Final = 0.25  # [m/s] mean speed in the first round
STARTING: Final = 0.2  # [s] besides, to start and to stop
ROUNDS: Final = 8  # of correction; later ones gain less than 10 ms
MOST_ROUNDS: Final = 20  # where the limits are not kept by then
AIM: Final = 0.98  # of the given share, so that the rounds end below it
ROUNDING: Final = 1e-6  # of a share
DIGITS: Final = 9  # decimals of a row's numbers
NOWHERE: Final = StartPose(HOME_XPOS, HOME_XQUAT, (0.0, 0.0, 0.0))  # all rows are in the world


@dataclass(frozen=True, eq=False)
class _Course:
    """The hand's pose at each tick from the first row on: dwells and motions in turn."""

    poses: Array  # position and orientation (n, 7)
    rows: NDArray[np.intp]  # the row passed last (n,)
    stops: list[int]  # ticks at which dwells and motions start, and the last one


def retimed(
    trajectory: Trajectory, blends: Array, gains: Gains, load: float, share: float
) -> Timing:
    """Compute new times for a trajectory with rows in the world; its dwells are kept.

    `blends` are the distances from the rows within which corners may be rounded (n,) [m], `load`
    is what the fingers carry [kg], and `share` what may be used of each limit [1].
    """
    parts, dynamics = motions(trajectory, blends), ArmDynamics(load, gains.robot)
    bounds = [Bounds(dict.fromkeys(BOUNDED, share))] * len(parts)
    laws = [_slow(part) for part in parts]
    slowest = SLOWEST * sum(part.length / SPEED + STARTING for part in parts)
    within: list[Timing] = []
    for number in range(MOST_ROUNDS):
        course = _course(trajectory, parts, laws)
        starts = course.stops[1:-1:2]
        table = _table(trajectory, course)
        path = Trajectory.from_table(table, NOWHERE, interpolation="spline")
        instants = path.times[0] + STEP_SIZE * np.arange(len(course.poses))
        reference = joint_reference(path, instants, gains)
        demanded = demands(path, reference, load)
        if number:  # the first round only finds the joint motion along the path
            shares, miss = largest(demanded), reference.miss
            is_reached = miss.max() <= WAY_TOLERANCE and miss[-1] <= REACH_TOLERANCE
            if is_reached and max(shares.values()) <= share + ROUNDING:
                within.append(Timing(path, shares, table))
            if number >= ROUNDS - 1 and within:
                break
            measured = _by_motion({"miss": miss, **demanded}, starts)
            bounds = [*map(_corrected, bounds, laws, measured, repeat(share))]
        joints = map(partial(_joints, reference), parts, laws, starts)
        each = zip(parts, joints, bounds, strict=True)
        try:
            laws = [time_law(*motion, dynamics) for motion in each]
        except NoTimingError:
            break
        if sum(map(len, laws)) * STEP_SIZE > slowest:
            break
    if not within:
        raise InputError(_refusal(course, demanded, reference, share))
    return min(within, key=lambda timing: timing.cycle)


def _by_motion(values: dict[str, Array], starts: list[int]) -> Iterator[dict[str, Array]]:
    """Yield the values during each motion, and the dwell that follows it."""
    for first, after in zip(starts, [*starts[1:], None], strict=True):
        yield {name: each[first:after] for name, each in values.items()}


def _corrected(bounds: Bounds, law: Array, measured: dict[str, Array], share: float) -> Bounds:
    """Correct the bounds of one motion by what was measured during it and the dwell after it.

    `law` is the place on the path at each tick of the motion (m,) [m]. Measured are shares of the
    limits and, as `miss`, the distance of hand and command, the dwell's included (n,) [m].
    """
    demanded = measured.copy()
    miss = demanded.pop("miss")
    used = largest(demanded)
    rates = np.hstack((demanded["jerk"], demanded["torque rate"]))
    smooth = float(without_spikes(rates).max())
    is_spiky = np.abs(rates).max() > SPIKY * smooth
    if is_spiky:  # the window is for the rest
        used |= {"jerk": smooth, "torque rate": 0.0}
    if is_spiky or miss.max() > WAY_TOLERANCE:
        ticks = min(len(law), len(rates))  # the last one is the next motion's if that follows
        aim = AIM * share
        ceiling = lowered(bounds.ceiling, law[:ticks], rates[:ticks], miss[:ticks], aim)
        bounds = replace(bounds, ceiling=ceiling)
    return bounds.corrected(used, AIM * share)


def _refusal(
    course: _Course, demanded: dict[str, Array], reference: JointReference, share: float
) -> str:
    """Say in one line where no timing was found, and what would help."""
    used = {name: np.abs(values).max(axis=1) / share for name, values in demanded.items()}
    used["reach"] = reference.miss / WAY_TOLERANCE
    used["reach"][-1] = reference.miss[-1] / REACH_TOLERANCE
    name = max(used, key=lambda each: float(used[each].max()))
    tick = int(used[name].argmax())
    row = min(int(course.rows[tick]) + 2, int(course.rows[-1]) + 1)
    what = f"row {row}: no timing within {share:.0%} of the limits was found"
    if ended := reference.end_reached(tick):
        return f"{what}: {ended}"
    if name == "reach":
        return f"{what}: the hand misses the command by {reference.miss[tick]:.3g} m; {AWAY}"
    values = np.abs(demanded[name][tick])
    of = f" of joint {values.argmax() + 1}" if len(values) == 7 else ""
    return f"{what}: {name}{of} stays at {values.max():.1%} of its limit; {remedy(name)}"


def _slow(part: Motion) -> Array:
    """Law of the first round, which only finds the joint motion along the path."""
    ticks = int(np.ceil(part.length / SLOW / STEP_SIZE)) + 500
    u = np.linspace(0.0, 1.0, ticks + 1)
    return np.asarray(part.length * u**3 * (10.0 + u * (6.0 * u - 15.0)))


def _course(trajectory: Trajectory, parts: list[Motion], laws: list[Array]) -> _Course:
    """Join the motions, with the dwells between them."""
    corners = np.hstack((trajectory.positions, trajectory.orientations))
    last = len(trajectory.times) - 1
    pieces, row = list[tuple[NDArray[np.intp], Array]](), 0
    for part, law in zip(parts, laws, strict=True):
        dwell = _dwell(trajectory, row, int(part.rows[0]))
        pieces += [(dwell, corners[dwell]), (part.passed(law[:-1]), part.poses(law[:-1]))]
        row = int(part.rows[-1])
    pieces += [(at, corners[at]) for at in (_dwell(trajectory, row, last), np.array([last]))]
    rows, poses = zip(*pieces, strict=True)
    stops = np.cumsum([0, *map(len, rows[:-1])]).tolist()
    return _Course(np.vstack(poses), np.concatenate(rows), stops)


def _dwell(trajectory: Trajectory, row: int, until: int) -> NDArray[np.intp]:
    """Return the row passed last at each tick of a dwell up to `until`."""
    length = trajectory.times[until] - trajectory.times[row]
    times = trajectory.times[row] + STEP_SIZE * np.arange(round(length / STEP_SIZE))
    return np.asarray(np.searchsorted(trajectory.times, times + 0.5 * STEP_SIZE, "right") - 1)


def _table(trajectory: Trajectory, course: _Course) -> TrajectoryTable:
    """Write a course as rows, one at each stop and at most `SPACING` ticks between them."""
    ticks = {len(course.poses) - 1}
    for first, last in pairwise(course.stops):
        count = -(-(last - first) // SPACING)
        ticks |= set(np.linspace(first, last, count + 1).round().astype(int).tolist())
    at = sorted(ticks)
    times = [round(float(trajectory.times[0]) + tick * STEP_SIZE, DIGITS) for tick in at]
    return world_table(times, course.poses[at].round(DIGITS), trajectory.grips[course.rows[at]])


def _joints(reference: JointReference, part: Motion, law: Array, start: int) -> Array:
    """Return a motion's joint positions at `NODES` points (n, 7) [rad]; it starts at a tick."""
    q = reference.position[start : start + len(law)]
    at = np.interp(np.linspace(0.0, part.length, NODES), law, np.arange(len(law)))
    return np.column_stack([np.interp(at, np.arange(len(q)), joint) for joint in q.T])
