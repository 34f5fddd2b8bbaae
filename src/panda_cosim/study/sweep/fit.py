"""Fits what a sweep varies to a log: the values that bring a run closest to what was measured.

Least squares over the signals that log and run have in common, each weighted by the noise that is
left in it. Intervals follow from the slopes of all signals at the solution; values whose errors go
together cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from ...assets.fields import Array
from ...fmus.errors import InputError, located
from ...result.recording import Recording
from ...result.recording.logs import open_log
from ...run.execution import Execution
from ...run.prepare import prepare
from ...task.scenario import Scenario, load_scenario
from .definition import Sweep
from .design import check_keys
from .results import Z

STEP: Final = 1e-3  # of a range, by which slopes are measured
ROUNDS: Final = 3  # in which the signals' noise is estimated anew
ALIKE: Final = 0.99  # correlation from which two values cannot be told apart
EXACT: Final = 1e-9  # of a signal's reach: less is no noise


@dataclass(frozen=True)
class Estimate:
    """The value of a key, and the ends of its interval within its range."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Fit:
    """What a log says of a scenario's values; `fit` makes it."""

    scenario: Scenario  # with the values
    estimates: Mapping[str, Estimate]
    alike: tuple[str, ...]  # what the log does not tell, a line each
    noise: Mapping[str, float]  # RMS that is left, by signal, in its unit


def fit(definition: Sweep, log: Path, names: Path | None = None) -> Fit:
    """Fit the values that a sweep varies, within their ranges; `names` is a file of `LogNames`.

    Raises:
        InputError: A value is no number, or run and log have nothing in common.
    """
    if len(definition.scenario) > 1:
        raise InputError(f"scenario: {len(definition.scenario)} of them; a fit has one")
    keys, scenario = list(definition.vary), load_scenario(definition.scenario[0])
    check_keys(keys)
    with located("vary: must be ranges of numbers, KEY=LOW:HIGH:STEPS, for a fit"):
        ends = np.array([np.sort(each.extremes())[[0, -1]] for each in definition.vary.values()])
        low, high = ends.T.astype(float)

    def run(places: Array) -> Recording:
        with Execution(prepare(changed(places)), writes=False) as execution:
            execution.advance()
            return execution.close().recording

    def changed(places: Array) -> Scenario:
        """Return the scenario with values at places in their ranges, from 0 to 1."""
        values = low + places * (high - low)
        return scenario.changed(dict(zip(keys, values.tolist(), strict=True)))

    def apart(places: Array) -> Array:
        """Return how far a run is from the log, by instant and signal."""
        found = run(places)
        return np.column_stack([np.interp(time, found.time, found[n]) - target[n] for n in target])

    middle = np.full(len(keys), 0.5)
    first = run(middle)
    measured = open_log(log, names, first)
    within = (measured.time >= first.time[0]) & (measured.time <= first.time[-1])
    time = measured.time[within]
    target = {name: measured[name][within] for name in measured.columns if name != "time"}
    if not (len(time) and target):
        raise InputError(f"{log}: nothing to fit to: no signal or instant in common with the run")
    places, covariance, left = _closest(apart, middle, np.ptp([*target.values()], axis=1))
    spread = np.sqrt(np.diag(covariance))
    half = np.where(spread > 0.0, Z * spread, 1.0)  # a value without effect may be any
    marks = low + np.clip([places, places - half, places + half], 0.0, 1.0) * (high - low)
    idle = [f"{k} changes no signal of the log" for k, s in zip(keys, spread, strict=True) if not s]
    errors = covariance / np.outer(half, half) * Z**2
    alike = [
        f"{keys[i]} and {keys[j]} cannot be told apart: their errors go together"
        for i, j in combinations(np.flatnonzero(spread), 2)
        if abs(errors[i, j]) > ALIKE
    ]
    estimates = dict(zip(keys, map(Estimate, *marks.tolist()), strict=True))
    noise = dict(zip(target, left.tolist(), strict=True))
    return Fit(changed(places), estimates, (*idle, *alike), noise)


def _closest(
    apart: Callable[[Array], Array], places: Array, reach: Array
) -> tuple[Array, Array, Array]:
    """Return the places of the least weighted squares, their covariance, and the noise left.

    `reach` is how far each signal goes in the log; one that never moves has no say.
    """
    first = apart(places)
    reach = np.maximum(reach, np.abs(first).max(axis=0))
    noise, exact = reach, np.where(reach > 0.0, EXACT * reach, np.inf)
    for _ in range(ROUNDS):
        sigma = np.tile(np.maximum(noise, exact), len(first))
        places, covariance = scipy.optimize.curve_fit(
            lambda _, *at: apart(np.array(at)).ravel(), None, np.zeros(first.size), places, sigma,
            absolute_sigma=True, bounds=(0.0, 1.0), diff_step=STEP,
        )  # fmt: skip
        noise = np.sqrt(np.mean(apart(places) ** 2, axis=0))
    return places, covariance, noise
