"""Computes the times of a table that the robot's limits allow: the shortest, or stretched ones.

The shortest: dwells keep their length. The path between two stops gets a time-optimal law (toppra),
averaged over a window to limit jerk and torque rate. The joint reference that the controller
computes from it is then measured against the limits, and the law's bounds are corrected, a few
times.

Stretched: each row gets as much more time as the limits ask for. A segment is slowed down as a
whole, so the path stays as it is. A spline passes its rows without a stop and is therefore slowed
down from end to end. Rows that keep the limits keep their duration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_XPOS, HOME_XQUAT, ROBOTS
from ...controller.gains import Gains
from ...fmus.errors import InputError
from ..table import TableRow, TrajectoryTable
from ..trajectory import StartPose, Trajectory
from .demand import (
    REACH_TOLERANCE,
    WAY_TOLERANCE,
    ArmDynamics,
    JointReference,
    LimitViolation,
    Shares,
    Timing,
    demands,
    find_violations,
    joint_reference,
    largest,
)
from .time_law import (
    NODES,
    STILL,
    Bounds,
    Motion,
    NoTimingError,
    is_spiky,
    lowered,
    motions,
    segment_lengths,
    time_law,
    without_spikes,
)

Array = NDArray[np.float64]

# Order in which a quantity falls with a segment's duration: v ~ 1/T, a ~ 1/T^2, j ~ 1/T^3. Near
# singularities the hand's lag falls more slowly than its speed, and of the torque gravity's part
# does not fall at all: those take a few more rounds.
ORDERS: Final = {
    "velocity": 1.0,
    "acceleration": 2.0,
    "jerk": 3.0,
    "torque": 1.0,
    "torque rate": 3.0,
    "reach": 0.7,
}
# What is still there after a round comes from a kink of the joint path, as where damping sets in:
# the acceleration jumps there, so that jerk and torque rate fall with 1/T^2 only.
KINK_ORDER: Final = 2.0
STRETCHING_ROUNDS: Final = 20  # each brings a segment close to its limit
MOST_AT_ONCE: Final = 3.0  # times a segment's duration
SPARE: Final = 1.005  # a little more than needed, so that few rounds suffice
SPEED: Final = 0.5  # [m/s] a segment's mean speed, unless the table is slower
SLOWEST: Final = 12.0  # times slower than that: what takes more is no matter of time
STARTING: Final = 0.2  # [s] besides, to start and to stop
MUCH_SLOWER: Final = 3.0  # times, from which a joint that is at its end is there for good
HELPED: Final = 0.9  # a hand that misses more of what it did before does not come closer in time
SLOWLY_CORRECTED: Final = 0.0008  # [m] 2 linear_braking / ik_gain^2
SETTLING: Final = 0.5  # [s] after the last row
AT_END: Final = 0.002  # [rad] from a joint's end
AWAY: Final = "the path must stay away from singularities, such as the stretched arm"
CLOSE: Final = 0.2  # [rad] from it, within which a joint brakes; it takes as much from full speed


def stretched(trajectory: Trajectory, gains: Gains, load: float, share: float) -> Timing:
    """Slow down what is too fast for the robot; the rest keeps its duration.

    The closed fingers carry `load` [kg], and `share` is what may be used of each limit [1]. Where
    no time helps, the message names row, joint and what to change.
    """
    spans, lengths = np.diff(trajectory.times), segment_lengths(trajectory)
    moving, usual = np.flatnonzero(lengths > STILL), np.maximum(spans, lengths / SPEED)
    slowed, missed = trajectory, dict[int, float]()
    for number in range(STRETCHING_ROUNDS):
        reference, violations, shares = _rehearsed(slowed, gains, load, share)
        if not violations:
            return Timing(slowed, shares)
        times = np.diff(slowed.times)
        needed = np.ones(len(spans))
        for violation in violations:
            before = moving[moving <= violation.row - 2]  # the violation's segment, or a dwell's
            if not len(before):
                text = "no row moves the hand before, so more time does not help"
                raise InputError(f"{violation}; {text}")
            at = int(before[-1])
            _refuse_if_hopeless(violation, times[at] / usual[at], reference, missed)
            order = min(ORDERS[violation.quantity], KINK_ORDER if number else math.inf)
            factor = violation.share ** (1.0 / order) * SPARE
            needed[at] = max(needed[at], min(factor, MOST_AT_ONCE))
        longer = np.minimum(times * needed, np.maximum(SLOWEST * usual, times))
        slowed = _with_factors(trajectory, longer / spans)
    raise InputError(f"no duration keeps all limits: {violations[0]}")


def _rehearsed(
    trajectory: Trajectory, gains: Gains, load: float, share: float
) -> tuple[JointReference, list[LimitViolation], Shares]:
    """Compute the joint reference and its violations.

    The controller brakes its joints before their ends, and corrects large errors slowly, where the
    reference without limits does not. Such a reference is computed anew with the limits.
    """
    instants = STEP_SIZE * np.arange(np.ceil((trajectory.times[-1] + SETTLING) / STEP_SIZE) + 1.0)
    for limited in (False, True):
        reference = joint_reference(trajectory, instants, gains, limited=limited)
        violations, shares = find_violations(trajectory, reference, load, share, WAY_TOLERANCE)
        left = float(reference.miss[-1])
        if left > REACH_TOLERANCE:
            row, time = len(trajectory.times), float(reference.time[-1])
            violations.append(LimitViolation(row, time, 0, "reach", left, REACH_TOLERANCE))
        if violations or (
            room_of(reference).min() > CLOSE and reference.miss.max() < SLOWLY_CORRECTED
        ):
            break
    return reference, violations, shares


def _refuse_if_hopeless(
    violation: LimitViolation, slower: float, reference: JointReference, missed: dict[int, float]
) -> None:
    """Refuse a violation that more time does not mend.

    Its segment is `slower` times as slow as usual; `missed` is by how much the hand missed each
    row's segment in the round before, and is changed.
    """
    tick = round((violation.time - reference.time[0]) / STEP_SIZE)
    if slower >= MUCH_SLOWER and (ended := end_reached(reference, tick)):
        raise InputError(f"row {violation.row}: {ended} (t = {violation.time:.3f} s)")
    if violation.quantity == "reach":
        before = missed.get(violation.row, math.inf)
        missed[violation.row] = violation.value
        if violation.value > HELPED * before and slower >= MUCH_SLOWER:
            raise InputError(str(violation))
    if slower >= SLOWEST:
        raise InputError(f"{violation}, {slower:.0f} times slower; {remedy(violation.quantity)}")


def room_of(reference: JointReference) -> Array:
    """Return the distance of the joints from the ends of their ranges (n, 7) [rad]."""
    robot, q = ROBOTS[reference.robot], reference.position
    return np.minimum(q - robot.q_min, robot.q_max - q)


def end_reached(reference: JointReference, tick: int) -> str:
    """Return which joint is at its end and what helps, or nothing."""
    room = room_of(reference)[tick]
    if room.min() >= AT_END:
        return ""
    return (
        f"joint {room.argmin() + 1} reaches the end of its range, however slowly it moves; "
        "turn the hand or choose another path, as `panda-cosim route` does"
    )


def remedy(quantity: str) -> str:
    """Return what helps where time does not."""
    if quantity != "torque":  # so slowly, that is gravity's
        return AWAY
    return (
        "gravity alone needs it; allow a larger share, carry a lighter load, or keep closer to the "
        "base"
    )


def _with_factors(trajectory: Trajectory, factors: Array) -> Trajectory:
    """Return a trajectory with each segment longer by a factor (n - 1,)."""
    spans = np.diff(trajectory.times)
    if trajectory.interpolation == "spline":
        longer = factors.max() * spans
    else:
        longer = np.where(
            factors > 1.0, np.ceil(factors * spans / STEP_SIZE - 1e-6) * STEP_SIZE, spans
        )
    times = trajectory.times[0] + np.concatenate(([0.0], np.cumsum(longer)))
    return replace(trajectory, times=times.round(9))


SPACING: Final = 10  # [ticks] between rows of the new table, at most
SLOW: Final = 0.25  # [m/s] mean speed in the first round
ROUNDS: Final = 8  # of correction; later ones gain less than 10 ms
MOST_ROUNDS: Final = 20  # where the limits are not kept by then
AIM: Final = 0.98  # of the given share, so that the rounds end below it
ROUNDING: Final = 1e-6  # of a share
DIGITS: Final = 9  # decimals of a row's numbers
NOWHERE: Final = StartPose(HOME_XPOS, HOME_XQUAT, (0.0, 0.0, 0.0))  # all rows are in the world


@dataclass(frozen=True, eq=False)
class _Course:
    """The hand's pose at each tick from the first row on."""

    poses: Array  # position and orientation (n, 7)
    rows: NDArray[np.intp]  # the row passed last (n,)
    stops: list[int]  # ticks at which motions start and end, the first and last one included
    starts: list[int]  # tick at which each motion starts


def retimed(
    trajectory: Trajectory, blends: Array, gains: Gains, load: float, share: float
) -> Timing:
    """Compute new times for a trajectory with rows in the world; its dwells are kept.

    `blends` are the distances from the rows within which corners may be rounded (n,) [m], `load`
    is what the fingers carry [kg], and `share` what may be used of each limit [1].
    """
    parts, dynamics = motions(trajectory, blends), ArmDynamics(load, gains.robot)
    bounds = [Bounds(share, share, share, share, share, share)] * len(parts)
    laws = [_slow(part) for part in parts]
    slowest = SLOWEST * sum(part.length / SPEED + STARTING for part in parts)
    within: list[Timing] = []
    for number in range(MOST_ROUNDS):
        course = _course(trajectory, parts, laws)
        table = _table(trajectory, course)
        path = Trajectory.from_table(table, NOWHERE, interpolation="spline")
        instants = path.times[0] + STEP_SIZE * np.arange(len(course.poses))
        reference = joint_reference(path, instants, gains)
        demanded = demands(path, reference, load)
        if number:  # the first round only finds the joint motion along the path
            shares = largest(demanded)
            reached = reference.miss.max() <= WAY_TOLERANCE
            reached &= reference.miss[-1] <= REACH_TOLERANCE
            if reached and max(shares.values()) <= share + ROUNDING:
                within.append(Timing(path, shares, table))
            if number >= ROUNDS - 1 and within:
                break
            ends = [*course.starts[1:], len(course.poses)]  # each with the dwell that follows it
            for part, span in enumerate(map(slice, course.starts, ends)):
                during = {name: shares[span] for name, shares in demanded.items()}
                bounds[part] = _corrected(
                    bounds[part], laws[part], during, reference.miss[span], share
                )
        joints = _joints(parts, laws, course, reference)
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


def _corrected(
    bounds: Bounds, law: Array, demanded: dict[str, Array], miss: Array, share: float
) -> Bounds:
    """Correct the bounds of one motion by what was measured during it and the dwell after it.

    `law` is the place on the path at each tick of the motion (m,) [m], and `miss` the distance of
    hand and command at each tick, the dwell's included (n,) [m].
    """
    used = largest(demanded)
    rates = np.hstack((demanded["jerk"], demanded["torque rate"]))
    missed = float(miss.max()) > WAY_TOLERANCE
    spiky = is_spiky(rates)
    if spiky:  # the window is for the rest
        used |= {"jerk": float(without_spikes(rates).max()), "torque rate": 0.0}
    if spiky or missed:
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
    if ended := end_reached(reference, tick):
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


def _joints(
    parts: list[Motion], laws: list[Array], course: _Course, reference: JointReference
) -> list[Array]:
    """Return each motion's joint positions at `NODES` points (n, 7) [rad]."""
    positions = []
    for part, law, start in zip(parts, laws, course.starts, strict=True):
        q = reference.position[start : start + len(law)]
        at = np.interp(np.linspace(0.0, part.length, NODES), law, np.arange(len(law)))
        positions.append(
            np.column_stack([np.interp(at, np.arange(len(q)), joint) for joint in q.T])
        )
    return positions
