"""Scenarios on several versions of MuJoCo: where they differ, and whether rounding explains it.

Two engines that round differently are never equal to the last bit, and a small difference may grow
without anything having changed. So each scenario runs once more with all inputs of its plant times
1 + 1e-14: an engine has changed a signal where it is further off than `GROWTH` times what this
noise has made of it so far.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ..recording import Recording
from ..scenario.scenario import Scenario
from ..scenario.tolerances import Tolerances, is_compared
from .regress import Outcome, Unusable

NOISE: Final = 1.0 + 1e-14
NOISY: Final = "-noise"  # end of the noisy run's name
GROWTH: Final = 1000.0  # times the noise's largest effect so far
FLOOR: Final = 1e-5  # of a tolerance: less is rounding, also where the noise has no effect yet
Difference = Literal["equal", "rounding", "changed"]


@dataclass(frozen=True)
class EngineRow:
    """A scenario on one version of MuJoCo."""

    scenario: str
    mujoco: str  # "": the scenario's own
    verdict: str  # against the reference, as in an `Outcome`
    difference: Difference  # from the run with the scenario's own
    tick: int | None  # first one that differs or, of a change, that rounding does not explain
    signal: str = ""  # the first that leaves its tube
    time: float | None = None  # when it does [s]
    reason: str = ""  # of a failed run, and of a bad verdict


def variants(scenario: Scenario | Unusable, engines: Iterable[str]) -> list[Scenario | Unusable]:
    """Return a scenario as it is, with noise, and with each engine."""
    if isinstance(scenario, Unusable):
        return [scenario]
    name = scenario.name
    try:
        noisy = replace(scenario, name=name + NOISY, input_scale=NOISE)
        others = [replace(scenario, name=f"{name}-{each}", mujoco=each) for each in engines]
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    return [scenario, noisy, *others]


def is_noisy(member: object) -> bool:
    """Tell whether a member of a suite is a scenario with noise."""
    return isinstance(member, Scenario) and member.input_scale == NOISE


def engine_rows(
    scenarios: Iterable[Scenario | Unusable], engines: Sequence[str], outcomes: Iterable[Outcome]
) -> list[EngineRow]:
    """Compare the runs of each scenario with that of its own engine."""
    by_name = {outcome.name: outcome for outcome in outcomes}
    usable = [scenario for scenario in scenarios if isinstance(scenario, Scenario)]
    return [_row(scenario, each, by_name) for scenario in usable for each in ("", *engines)]


def _row(scenario: Scenario, engine: str, outcomes: Mapping[str, Outcome]) -> EngineRow:
    name = scenario.name
    outcome = outcomes[f"{name}-{engine}" if engine else name]
    involved = (outcomes[name], outcomes[name + NOISY], outcome)
    difference: tuple[Difference, int | None] = ("changed", None)
    if all(each.verdict != "failed" for each in involved):
        own, noisy, run = (Recording.open(each.run) for each in involved)
        difference = difference_of(own, noisy, run, scenario.regression)
    deviations = outcome.comparison.deviations if outcome.comparison else ()
    left = [(each.first, each.name) for each in deviations if each.first is not None]
    time, signal = min(left, default=(None, ""))
    return EngineRow(name, engine, outcome.verdict, *difference, signal, time, outcome.reason)


def difference_of(
    own: Recording, noisy: Recording, run: Recording, tolerances: Tolerances
) -> tuple[Difference, int | None]:
    """Tell whether rounding explains how a run differs from another, and the first such tick."""
    rows = min(each.rows for each in (own, noisy, run))
    apart, beyond = np.zeros((2, rows), bool)
    for name in own.columns:
        first, other = own[name][:rows], run[name][:rows]
        apart |= first != other
        if is_compared(name) and (first != other).any():
            tolerance = tolerances.value(name, own.units[name])
            beyond |= _beyond(first, noisy[name][:rows], other, tolerance)
    if beyond.any() or own.rows != run.rows:
        return "changed", int(np.argmax(beyond)) if beyond.any() else rows
    return ("rounding", int(np.argmax(apart))) if apart.any() else ("equal", None)


def _beyond(
    own: NDArray[np.float64], noisy: NDArray[np.float64], run: NDArray[np.float64], tolerance: float
) -> NDArray[np.bool_]:
    """Return the ticks at which a run is further off than rounding explains."""
    own, noisy, run = (each.astype(float) for each in (own, noisy, run))
    effect = np.maximum.accumulate(np.abs(noisy - own))
    near = np.abs(run - own) <= np.maximum(GROWTH * effect, FLOOR * tolerance)
    beyond: NDArray[np.bool_] = ~near & (run != own)
    return beyond
