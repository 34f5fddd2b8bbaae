"""Computes new times for a scenario's table, and returns a scenario with an ordinary table."""

from __future__ import annotations

import math
from dataclasses import replace

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ..scenario.scenario import MAX_DURATION, Scenario
from ..scenario.table import TrajectoryTable
from ..timing.demand import Shares, Timing
from .start import new_timing, start_values


def retime(
    scenario: Scenario, share: float | None = None, *, keep_times: bool = False
) -> tuple[Scenario, Shares]:
    """Compute new times for a scenario's table and the block's start pose."""
    if scenario.has_own_parts:
        raise InputError(
            f"{scenario.name}: has FMUs of its own; must have our plant and controller"
        )
    share = scenario.timing_share if share is None else share
    word = "feasible" if keep_times else "optimal"
    wanted = replace(scenario, timing=word, timing_share=share, duration=MAX_DURATION)
    try:
        timing = new_timing(wanted, start_values(scenario))
    except InputError as error:
        raise InputError(f"{scenario.name}: {error}") from None
    made = _slowed(scenario, timing) if timing.table is None else _optimal(scenario, timing.table)
    return made, timing.shares


def _slowed(scenario: Scenario, timing: Timing) -> Scenario:
    """Return the scenario with its rows at new times, and as much time after the last one."""
    rows = scenario.table.rows
    moved = zip(rows, timing.trajectory.times.tolist(), strict=True)
    table = TrajectoryTable(tuple(replace(row, time=time) for row, time in moved))
    duration = _whole_ticks(scenario.duration + timing.cycle - rows[-1].time)
    return replace(scenario, table=table, timing="table", duration=duration)


def _optimal(scenario: Scenario, table: TrajectoryTable) -> Scenario:
    """Return the scenario with new rows, which end with the last one."""
    return replace(
        scenario,
        table=table,
        timing="table",
        interpolation="spline",
        duration=_whole_ticks(table.rows[-1].time),
    )


def _whole_ticks(time: float) -> float:
    return round(math.ceil(time / STEP_SIZE - 1e-6) * STEP_SIZE, 9)
