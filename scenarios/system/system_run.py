"""A coupled system from an .ssp file as a scenario, whatever its FMUs are."""

from __future__ import annotations

from pathlib import Path

from ...fmus.errors import InputError
from ...fmus.master.ssp_reader import system_from_ssp
from ..scenario.scenario import MAX_STEPS, NO_TABLE, Scenario


def system_scenario(path: Path, duration: float | None = None) -> Scenario:
    """Return the scenario that runs a system as its file says, without a verdict."""
    coupled = system_from_ssp(path)
    if duration is None:
        duration = coupled.stop_time - coupled.start_time
    _check_steps(path, duration, coupled.step_size)
    name = "".join(c if c.isprintable() else "_" for c in coupled.name) or "system"
    return Scenario(
        name=name[:80],
        table=NO_TABLE,
        duration=duration,
        step=coupled.step_size,
        system=path.name,
        folder=path.parent.resolve(),
    )


def _check_steps(path: Path, duration: float, step: float) -> None:
    steps = duration / step
    count = round(steps) if 0 < steps <= 2 * MAX_STEPS else 0
    if not 1 <= count <= MAX_STEPS or abs(count * step - duration) > 1e-9 * max(duration, 1.0):
        raise InputError(
            f"{path}: {duration!r} s from start to stop; must be a whole number of steps of "
            f"{step:g} s, between {step:g} and {MAX_STEPS * step:g} s"
        )
