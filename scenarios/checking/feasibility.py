"""Whether the robot can follow a table: its joint reference against the robot's limits.

The controller itself, with its limits disabled and an ideal arm, turns the commands into the joint
reference. Violations are reported by row and joint, and `stretch` gives each such segment the time
that it needs. Torques are those of the arm with the block in its hand where the fingers close.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...controller.gains import preset
from ...fmus.errors import InputError
from ..definition.limits import LIMITS
from ..definition.scenario import Scenario
from ..definition.table import TrajectoryTable
from ..definition.trajectory import TIME_TOLERANCE
from ..running.start import Overrides, carried_mass, instants, resolve, start_values
from ..timing.demand import joint_demands, largest
from ..timing.joint_reference import JointReference, joint_reference

Array = NDArray[np.float64]

# Order in which a quantity falls with a segment's duration: v ~ 1/T, a ~ 1/T^2, j ~ 1/T^3.
# Of the torque, gravity's part does not fall at all.
ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3, "torque": 1, "torque rate": 3}
REACH_TOLERANCE = 0.001  # [m] by which the hand may miss the command
ROUNDS = 15  # of stretching; each brings a segment close to its limit
MOST_AT_ONCE = 3.0  # times a segment's length
SPARE = 1.005  # a little more than needed, so that few rounds suffice


@dataclass(frozen=True)
class LimitViolation:
    """One limit that one segment exceeds.

    Attributes:
        row: Row that the segment leads to, counted from 1.
        time: When it is exceeded most [s].
        joint: Number of the joint, from 1; 0 for the hand as a whole.
        quantity: One of `LIMITS`, or `reach`: the hand misses the command.
        value: Largest magnitude, in the limit's unit; [m] for `reach`.
        limit: What is allowed.
    """

    row: int
    time: float
    joint: int
    quantity: str
    value: float
    limit: float

    @property
    def share(self) -> float:
        """Value over limit [1]."""
        return self.value / self.limit

    def __str__(self) -> str:
        """Describe it in one line."""
        if self.quantity == "reach":
            return (
                f"row {self.row}: the hand misses the command by {self.value:.3g} m at "
                f"t = {self.time:.3f} s; must be within the arm's reach and its joints' ranges"
            )
        unit = LIMITS[self.quantity].unit
        return (
            f"row {self.row}: {self.quantity} of joint {self.joint} is {self.value:.3g} {unit} "
            f"at t = {self.time:.3f} s; must be at most {self.limit:.3g} {unit} "
            f"({100 * self.share:.0f} %)"
        )


@dataclass(frozen=True)
class Feasibility:
    """The demands of a table on the robot.

    Attributes:
        violations: The worst one of each kind in each row, in the rows' order.
        shares: Largest share of each limit over all joints and rows.
    """

    violations: tuple[LimitViolation, ...]
    shares: dict[str, float]

    @property
    def ok(self) -> bool:
        """Nothing is exceeded."""
        return not self.violations

    def refuse(self, name: str) -> None:
        """Refuse a table that the robot cannot follow.

        Args:
            name: Of the table, for the message.

        Raises:
            InputError: A limit is exceeded; names all rows and joints.
        """
        if self.violations:
            raise InputError(f"{name}: " + "; ".join(map(str, self.violations)))


def check_feasibility(
    scenario: Scenario, overrides: Overrides | None = None, share: float = 1.0
) -> Feasibility:
    """Judge a scenario's table.

    Args:
        scenario: The scenario to check. A scenario whose controller has no joint reference (the
            tutorial's) is judged by the default one.
        overrides: Parameters by instance and name, as for a run.
        share: Share of the robot's limits that may be used [1].

    Raises:
        InputError: A parameter is unknown or out of its bounds.
    """
    values = start_values(scenario, overrides)
    trajectory = resolve(scenario, values)
    gains = preset(scenario.gains)
    gains = gains if gains.use_reference else preset("default")
    reference = joint_reference(trajectory, instants(scenario), gains)
    segment = np.searchsorted(trajectory.times, reference.time - TIME_TOLERANCE) + 1
    demanded = joint_demands(trajectory, reference, carried_mass(scenario, values))
    violations = _violations(reference, demanded, segment, share)
    # What is out of reach makes the joints jump: the cause comes first.
    ordered = sorted(violations, key=lambda v: (v.row, v.quantity != "reach", -v.share))
    return Feasibility(tuple(ordered), largest(demanded))


def _violations(
    reference: JointReference, demanded: dict[str, Array], segment: NDArray[np.int_], share: float
) -> Iterator[LimitViolation]:
    """Yield the worst violation of each kind in each segment."""
    for row in np.unique(segment):
        ticks = np.flatnonzero(segment == row)
        for quantity, shares in demanded.items():
            part = np.abs(shares[ticks])
            tick, joint = np.unravel_index(part.argmax(), part.shape)
            if part[tick, joint] > share:
                limit = share * float(LIMITS[quantity].bound[joint])
                value = float(part[tick, joint] * LIMITS[quantity].bound[joint])
                time = float(reference.time[ticks[tick]])
                yield LimitViolation(int(row), time, int(joint) + 1, quantity, value, limit)
        worst = ticks[reference.miss[ticks].argmax()]
        if reference.miss[worst] > REACH_TOLERANCE:
            miss, time = float(reference.miss[worst]), float(reference.time[worst])
            yield LimitViolation(int(row), time, 0, "reach", miss, REACH_TOLERANCE)


def stretch(
    scenario: Scenario, overrides: Overrides | None = None, share: float = 0.95
) -> Scenario:
    """Lengthen the segments that are too fast for the robot; the others keep their duration.

    Args:
        scenario: The scenario to check.
        overrides: Parameters by instance and name, as for a run.
        share: Share of the robot's limits that may be used [1].

    Returns:
        The scenario, with the times after a longer segment and the duration moved on.

    Raises:
        InputError: No duration helps: the arm does not reach, or a row jumps.
    """
    for _ in range(ROUNDS):
        found = check_feasibility(scenario, overrides, share)
        factors: dict[int, float] = {}
        for violation in found.violations:
            if violation.quantity != "reach":
                needed = violation.share ** (1.0 / ORDERS[violation.quantity]) * SPARE
                needed = min(needed, MOST_AT_ONCE)
                factors[violation.row] = max(needed, factors.get(violation.row, 1.0))
        if not factors or _is_out_of_reach(found, len(scenario.table.rows)):
            found.refuse(scenario.name)
            return scenario
        scenario = _with_times(scenario, factors)
    found.refuse(scenario.name)
    return scenario


def _is_out_of_reach(found: Feasibility, rows: int) -> bool:
    """Whether the hand misses a row's segment although no joint hurries there."""
    kinds = {(violation.row, violation.quantity) for violation in found.violations}
    return any(
        kind == "reach" and row <= rows and (row, "velocity") not in kinds for row, kind in kinds
    )


def _with_times(scenario: Scenario, factors: dict[int, float]) -> Scenario:
    """Return the scenario with the segments that lead to some rows made longer."""
    rows, shift, moved = scenario.table.rows, 0.0, []
    for number, row in enumerate(rows, 1):
        if number > 1 and number in factors:
            length = row.time - rows[number - 2].time
            longer = math.ceil(length * factors[number] / STEP_SIZE) * STEP_SIZE
            shift += longer - length
        moved.append(replace(row, time=round(row.time + shift, 9)))
    duration = math.ceil((scenario.duration + shift) / STEP_SIZE - 1e-6) * STEP_SIZE
    table = TrajectoryTable(tuple(moved))
    return replace(scenario, table=table, duration=round(duration, 9))
