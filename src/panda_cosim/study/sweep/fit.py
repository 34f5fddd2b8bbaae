"""Fits what a sweep varies to a log: the values that bring a run closest to what was measured.

Least squares over the signals that log and run have in common, each weighted by the noise that is
left in it. Intervals follow from the slopes of all signals at the solution; values that move the
signals alike cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...result.recording import Recording
from ...result.recording.logs import open_log
from ...run.execution import Execution
from ...run.prepare import prepare
from ...task.scenario import Scenario, load_scenario
from .definition import Sweep
from .design import check_keys

Array = NDArray[np.float64]

WIDE: Final = 1.959963984540054  # standard deviations on either side: 95 %
STEP: Final = 1e-3  # of a range, by which slopes are measured
ROUNDS: Final = 3  # in which the signals' noise is estimated anew
ALIKE: Final = 0.99  # correlation from which two values cannot be told apart
EXACT: Final = 1e-9  # of a signal's range: less is no noise


@dataclass(frozen=True)
class Estimate:
    """The value of one key."""

    key: str
    value: float
    low: float  # of its interval
    high: float


@dataclass(frozen=True)
class Fit:
    """What a log says of a scenario's values; `fit` makes it."""

    scenario: Scenario  # with the values
    estimates: tuple[Estimate, ...]
    alike: tuple[str, ...]  # what cannot be told apart, a line each
    noise: Mapping[str, float]  # RMS that is left, by signal, in its unit


def fit(definition: Sweep, log: Path, names: Path | None = None) -> Fit:
    """Fit the values that a sweep varies, within their ranges; `names` is a file of `LogNames`.

    Raises:
        InputError: A value is no number, or it changes nothing that run and log have in common.
    """
    scenario, ranges = _asked(definition)
    low, high = np.array(list(ranges.values())).T

    def changed(places: Array) -> Scenario:
        """Return the scenario with values at places in their ranges, from 0 to 1."""
        values = low + places * (high - low)
        return scenario.changed(dict(zip(ranges, values.tolist(), strict=True)))

    middle = np.full(len(ranges), 0.5)
    run = _run(changed(middle))
    measured = open_log(log, names, run)
    within = (measured.time >= run.time[0]) & (measured.time <= run.time[-1])
    time = measured.time[within]
    target = {name: measured[name][within] for name in measured.columns if name in run}
    del target["time"]
    if not (len(time) and target):
        raise InputError(f"{log}: nothing to fit to: no signal or instant in common with the run")

    def apart(places: Array) -> Array:
        """Return how far a run is from the log, by instant and signal."""
        run = _run(changed(places))
        return np.column_stack([np.interp(time, run.time, run[n]) - target[n] for n in target])

    reach = np.maximum(
        np.abs(apart(middle)).max(axis=0), [np.ptp(each) for each in target.values()]
    )
    places, covariance, left = _closest(apart, middle, reach)
    spread = np.sqrt(np.diag(covariance))
    half = np.where(spread > 0.0, WIDE * spread, 1.0)  # a value without effect may be any
    marks = np.clip([places, places - half, places + half], 0.0, 1.0)
    estimates = map(Estimate, ranges, *(low + marks * (high - low)).tolist())
    noise = dict(zip(target, left.tolist(), strict=True))
    return Fit(changed(places), tuple(estimates), tuple(_alike(covariance, [*ranges])), noise)


def _closest(
    apart: Callable[[Array], Array], places: Array, reach: Array
) -> tuple[Array, Array, Array]:
    """Return the places of the least weighted squares, their covariance, and the noise left.

    `reach` is how far each signal goes; one that never moves has no say.
    """
    noise, exact = reach, np.where(reach > 0.0, EXACT * reach, np.inf)
    for _ in range(ROUNDS):
        weights = np.maximum(noise, exact)
        goal = np.zeros_like(apart(places))
        places, covariance = scipy.optimize.curve_fit(
            lambda _, *at: apart(np.array(at)).ravel(), None, goal.ravel(), places,
            sigma=(goal + weights).ravel(), absolute_sigma=True, bounds=(0.0, 1.0), diff_step=STEP,
        )  # fmt: skip
        noise = np.sqrt(np.mean(apart(places) ** 2, axis=0))
    return places, covariance, noise


def _asked(definition: Sweep) -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """Return the scenario of a sweep, and the ranges of its values."""
    name, *others = definition.scenario
    if others:
        raise InputError("scenario: a fit has one")
    ranges = {}
    for key, each in definition.vary.items():
        ends = each.extremes()
        if any(isinstance(end, str | bool) for end in ends) or not min(ends) < max(ends):
            raise InputError(f"vary: {key}: must be a range of numbers, LOW:HIGH:STEPS, for a fit")
        ranges[key] = float(min(ends)), float(max(ends))
    check_keys(ranges)
    return load_scenario(name), ranges


def _run(scenario: Scenario) -> Recording:
    with Execution(prepare(scenario), writes=False) as execution:
        execution.advance()
        return execution.close().recording


def _alike(covariance: Array, keys: Sequence[str]) -> Iterator[str]:
    """Say which values the log does not tell apart."""
    spread = np.sqrt(np.diag(covariance))
    for key, size in zip(keys, spread, strict=True):
        if not size:
            yield f"{key} changes no signal of the log"
    for first, second in combinations(np.flatnonzero(spread).tolist(), 2):
        both = covariance[first, second] / (spread[first] * spread[second])
        if abs(both) > ALIKE:
            names = f"{keys[first]} and {keys[second]}"
            yield f"{names} cannot be told apart: their errors have a correlation of {both:.4f}"
