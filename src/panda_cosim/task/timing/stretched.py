"""Stretched times of a table: each row gets as much more time as the robot's limits ask for.

A segment is slowed down as a whole, so the path stays as it is. A spline passes its rows without a
stop and is therefore slowed down from end to end. Rows that keep the limits keep their duration.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...controller.gains import Gains
from ...fmus.errors import InputError
from ..trajectory import Trajectory
from .demand import (
    REACH_TOLERANCE,
    SLOWEST,
    SPEED,
    WAY_TOLERANCE,
    LimitViolation,
    Shares,
    Timing,
    find_violations,
    remedy,
)
from .joint_reference import JointReference, joint_reference
from .path import STILL, segment_lengths

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ORDERS: Final[Mapping[str, float]] = _TABLES["orders"]
# What is still there after a round comes from a kink of the joint path, as where damping sets in:
# the acceleration jumps there, so that jerk and torque rate fall with 1/T^2 only.
KINK_ORDER: Final = 2.0
STRETCHING_ROUNDS: Final = 20  # each brings a segment close to its limit
MOST_AT_ONCE: Final = 3.0  # times a segment's duration
SPARE: Final = 1.005  # a little more than needed, so that few rounds suffice
MUCH_SLOWER: Final = 3.0  # times, from which a joint that is at its end is there for good
SLOWLY_CORRECTED: Final = 0.0008  # [m] 2 linear_braking / ik_gain^2
SETTLING: Final = 0.5  # [s] after the last row
CLOSE: Final = 0.2  # [rad] from it, within which a joint brakes; it takes as much from full speed


def stretched(trajectory: Trajectory, gains: Gains, load: float, share: float) -> Timing:
    """Slow down what is too fast for the robot; the rest keeps its duration.

    The closed fingers carry `load` [kg], and `share` is what may be used of each limit [1]. Where
    no time helps, the message names row, joint and what to change.
    """
    spans, lengths = np.diff(trajectory.times), segment_lengths(trajectory)
    moving, usual = np.flatnonzero(lengths > STILL), np.maximum(spans, lengths / SPEED)
    slowed = trajectory
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
            _refuse_if_hopeless(violation, times[at] / usual[at], reference)
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
        if violations or (reference.room.min() > CLOSE and reference.miss.max() < SLOWLY_CORRECTED):
            break
    return reference, violations, shares


def _refuse_if_hopeless(
    violation: LimitViolation, slower: float, reference: JointReference
) -> None:
    """Refuse a violation that more time does not mend: its segment is so many times slower."""
    tick = round((violation.time - reference.time[0]) / STEP_SIZE)
    if slower >= MUCH_SLOWER and (ended := reference.end_reached(tick)):
        raise InputError(f"row {violation.row}: {ended} (t = {violation.time:.3f} s)")
    if slower >= SLOWEST:
        raise InputError(f"{violation}, {slower:.0f} times slower; {remedy(violation.quantity)}")


def _with_factors(trajectory: Trajectory, factors: Array) -> Trajectory:
    """Return a trajectory with each segment longer by a factor (n - 1,)."""
    spans = np.diff(trajectory.times)
    whole = np.ceil(factors * spans / STEP_SIZE - 1e-6) * STEP_SIZE  # ticks
    is_spline = trajectory.interpolation == "spline"
    longer = factors.max() * spans if is_spline else np.where(factors > 1.0, whole, spans)
    times = trajectory.times[0] + np.concatenate(([0.0], np.cumsum(longer)))
    return replace(trajectory, times=times.round(9))
