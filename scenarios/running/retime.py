"""Makes new times for a scenario's table, and returns a scenario with an ordinary table."""

from __future__ import annotations

import math
from dataclasses import replace

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ..definition.scenario import Scenario
from ..timing.optimal import Timing
from .start import optimal_timing, start_values


def retime(scenario: Scenario, share: float | None = None) -> tuple[Scenario, Timing]:
    """Make new times for a scenario's table and the block's start pose.

    Args:
        scenario: The scenario; its rows, dwells and blends are kept.
        share: Share of the robot's limits to use [1]; None: the scenario's own.

    Returns:
        The scenario with a table of rows in the world frame, and the shares of the limits it uses.

    Raises:
        InputError: It has no table, the arm cannot follow it, or toppra is missing.
    """
    if scenario.has_own_parts:
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
