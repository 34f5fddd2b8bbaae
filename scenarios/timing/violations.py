"""What a trajectory asks of the robot beyond its limits, by row and joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..scenario.limits import LIMITS, LIMITS_OF
from ..scenario.trajectory import TIME_TOLERANCE, Trajectory
from .demand import Shares, joint_demands, largest
from .joint_reference import JointReference

Array = NDArray[np.float64]

REACH_TOLERANCE: Final = 0.001  # [m] by which the hand may miss the command
# [m] The same on the way, where new times are made: near singularities the damping makes the hand
# lag, and more time does not always help.
WAY_TOLERANCE: Final = 0.005


@dataclass(frozen=True)
class LimitViolation:
    """One limit that one segment exceeds."""

    row: int  # that the segment leads to, from 1
    time: float  # when it is exceeded most [s]
    joint: int  # from 1; 0 for the hand as a whole
    quantity: str  # one of `LIMITS`, or `reach`: the hand misses the command
    value: float  # largest magnitude, in the limit's unit; [m] for `reach`
    limit: float  # what is allowed

    @property
    def share(self) -> float:
        """Value over limit [1]."""
        return self.value / self.limit

    def __str__(self) -> str:
        """Describe it in one line."""
        if self.quantity == "reach":
            return (
                f"row {self.row}: the hand is {self.value:.3g} m off the command at "
                f"t = {self.time:.3f} s; it must be within the arm's reach and joint ranges"
            )
        unit = LIMITS[self.quantity].unit
        return (
            f"row {self.row}: {self.quantity} of joint {self.joint} is {self.value:.3g} {unit} "
            f"at t = {self.time:.3f} s; must be at most {self.limit:.3g} {unit} "
            f"({100 * self.share:.0f} %)"
        )


def find_violations(
    trajectory: Trajectory,
    reference: JointReference,
    load: float,
    share: float,
    reach: float = REACH_TOLERANCE,
) -> tuple[list[LimitViolation], Shares]:
    """Return the worst violation of each kind in each row, and the largest share of each limit.

    The closed fingers carry `load` [kg], `share` is what may be used of each limit [1], and the
    hand may miss the command by `reach` [m].
    """
    segment = np.searchsorted(trajectory.times, reference.time - TIME_TOLERANCE) + 1
    demanded = joint_demands(trajectory, reference, load)
    violations = []
    for row in np.unique(segment):
        ticks = np.flatnonzero(segment == row)
        for quantity, shares in demanded.items():
            part = np.abs(shares[ticks])
            tick, joint = np.unravel_index(part.argmax(), part.shape)
            if part[tick, joint] > share:
                bound = float(LIMITS_OF[reference.robot][quantity].bound[joint])
                if quantity == "velocity":  # it may depend on the position
                    bound = abs(float(reference.velocity[ticks[tick], joint]) / part[tick, joint])
                limit, value = share * bound, float(part[tick, joint] * bound)
                time = float(reference.time[ticks[tick]])
                violations.append(
                    LimitViolation(int(row), time, int(joint) + 1, quantity, value, limit)
                )
        worst = ticks[reference.miss[ticks].argmax()]
        if reference.miss[worst] > reach:
            miss, time = float(reference.miss[worst]), float(reference.time[worst])
            violations.append(LimitViolation(int(row), time, 0, "reach", miss, reach))
    # What is out of reach makes the joints jump: the cause comes first.
    violations.sort(key=lambda v: (v.row, v.quantity != "reach", -v.share))
    return violations, largest(demanded)
