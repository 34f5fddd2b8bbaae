"""Whether the robot can follow a table: its joint reference against the robot's limits.

The controller itself, with its limits disabled and an ideal arm, turns the commands into the joint
reference. Violations are reported by row and joint. Torques are those of the arm with the block in
its hand where the fingers close.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...fmus.errors import InputError
from ..run.start import Overrides, carried_mass, instants, law_gains, resolve, start_values
from ..scenario.scenario import Scenario
from ..timing.joint_reference import joint_reference
from ..timing.violations import LimitViolation, find_violations


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
        """Refuse a table that the robot cannot follow."""
        if self.violations:
            raise InputError(f"{name}: " + "; ".join(map(str, self.violations)))


def check_feasibility(
    scenario: Scenario, overrides: Overrides | None = None, share: float = 1.0
) -> Feasibility:
    """Judge a scenario's table."""
    values = start_values(scenario, overrides)
    trajectory = resolve(scenario, values)
    reference = joint_reference(trajectory, instants(scenario), law_gains(scenario, values))
    load = carried_mass(scenario, values)
    violations, shares = find_violations(trajectory, reference, load, share)
    return Feasibility(tuple(violations), shares)
