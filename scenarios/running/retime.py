"""A scenario with the times of its table made anew, as one with a plain table."""

from __future__ import annotations

import math
from dataclasses import replace

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ..definition.scenario import Scenario
from ..timing.optimal import Timing
from .start import optimal_timing, start_values


def retime(scenario: Scenario, share: float | None = None) -> tuple[Scenario, Timing]:
    """Make the times of a scenario's table, for the block where the scenario puts it.

    Args:
        scenario: Whose rows, dwells and blends are kept.
        share: Of the robot's limits that may be used [1]; None: the scenario's own.

    Returns:
        The scenario with a table of rows in the world, and what it takes of the limits.

    Raises:
        InputError: It has no table, the arm cannot go that way, or toppra is missing.
    """
    if scenario.is_foreign:
        raise InputError(
            f"{scenario.name}: has FMUs of its own; must have our plant and controller"
        )
    share = scenario.timing_share if share is None else share
    wanted = replace(scenario, timing="optimal", timing_share=share, duration=60.0)
    timing = optimal_timing(wanted, start_values(scenario))
    duration = math.ceil(timing.cycle / STEP_SIZE - 1e-6) * STEP_SIZE
    made = replace(
        scenario,
        table=timing.table,
        timing="table",
        interpolation="spline",
        duration=round(duration, 9),
    )
    return made, timing


__all__ = ["retime"]
