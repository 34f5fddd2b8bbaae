"""The tube in which a run's column must lie: how wide it is, its edges, and distances from it."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...fmus.errors import InputError, excerpt
from ...result.recording import Recording
from ...task.tolerances import (
    EQUAL,
    LEAST_SIZE,
    OF_RANGE,
    OF_SIZE,
    Tolerances,
    of_ours,
    signal_of,
)

Rows = NDArray[np.int64]
Widths = dict[str, float]  # by column, in its unit

MARGIN: Final = 10.0  # of a tube by noise: other machines round in another way
NARROWEST: Final = 0.01  # of a default width
TIME_SLACK: Final = 1e-6  # of a step: rounding of k * dt


def widths(run: Recording, tolerances: Tolerances, noise: Widths | None = None) -> Widths:
    """Return the half-width of the tube around each column of a reference, in its unit.

    `noise` has some that stand in place of the defaults, see `widths_of_noise`.
    """
    extents = _extents(run)
    ours, values = of_ours(run.units), tolerances.values
    addresses = {column: address for address, column in run.addresses.items()}
    found = dict.fromkeys(run.texts, EQUAL)
    for name in run.columns:
        unit, signal = run.units[name], signal_of(name)
        names = (name, addresses.get(name, name), signal)
        given = next((values[each] for each in names if each in values), None)
        if given is not None:
            found[name] = given
        elif noise and name in noise:
            found[name] = noise[name]
        elif signal in ours:
            found[name] = tolerances.scale * ours[signal][unit]
        elif run.is_real(name):
            extent, size = extents[signal, unit]
            found[name] = tolerances.scale * float(max(OF_RANGE * extent, OF_SIZE * size))
        else:
            found[name] = EQUAL
    found.pop("time", None)
    return found


def widths_of_noise(run: Recording, noisy: Recording, tolerances: Tolerances) -> Widths:
    """Return half-widths of Reals by how far noise takes them out of a tube of no height.

    Raises:
        InputError: It changes nothing, or ends the run at another tick.
    """
    plain, ticks = widths(run, Tolerances()), tolerances.ticks(run.metadata["step_size"])
    names = filter(run.is_real, plain if run.rows == noisy.rows else ())
    apart = {n: float(distances(noisy[n], slice(None), run[n], 0.0, ticks).max()) for n in names}
    if not 0.0 < sum(apart.values()) < math.inf:
        raise InputError(
            "--noise: rounded inputs change nothing, or the run's end; must be left out"
        )
    return {name: max(MARGIN * far, NARROWEST * plain[name]) for name, far in apart.items()}


def _extents(run: Recording) -> dict[tuple[str, str], Any]:
    """Return the largest range and size among each signal's elements of one unit."""
    extents = defaultdict[tuple[str, str], Any](lambda: np.array([0.0, LEAST_SIZE]))
    for name in filter(run.is_real, run.columns):
        values = run[name]
        finite = values[np.isfinite(values)]
        low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
        size = max(abs(low), abs(high), abs(run.nominals.get(name, 0.0)))
        key = signal_of(name), run.units[name]
        extents[key] = np.maximum(extents[key], (high - low, size))
    return extents


def tube(values: Array, tolerance: float, ticks: int) -> tuple[Array, Array]:
    """Return the edges of the tube around a signal (n,), with its half-widths in value and time."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # noqa: PLC0415 - slow to import

    size = 2 * ticks + 1
    lower: Array = minimum_filter1d(values, size, mode="nearest")
    upper: Array = maximum_filter1d(values, size, mode="nearest")
    lower -= tolerance  # in place, as a long run's are large
    upper += tolerance
    return lower, upper


def distances(
    values: Array, rows: Rows | slice, reference: Array, half: float, ticks: int
) -> Array:
    """Return how far values are from their rows of a reference, or those within some ticks."""
    # Beyond `half`, the reference's rounding; the distance of texts is 0 or infinite.
    if reference.dtype == object:
        last, shifts = len(reference) - 1, range(-ticks, ticks + 1)
        own = np.arange(len(reference))[rows]
        apart = [values != reference[np.clip(own + shift, 0, last)] for shift in shifts]
        return np.asarray(np.where(np.all(apart, axis=0), np.inf, 0.0))
    numbers = _numbers(values, reference)
    lower, upper = (edge[rows] for edge in tube(_numbers(reference, reference), half, ticks))
    np.subtract(numbers, upper, out=upper)  # in place, as above
    np.subtract(lower, numbers, out=lower)
    distance: Array = np.maximum(upper, lower, out=upper).clip(0.0, out=upper)
    distance[~np.isfinite(numbers)] = np.inf
    return distance


def shown_at(values: Array, row: int) -> str:
    """Return a value or text for a message."""
    return excerpt(values[[row]].tolist()[0])


def holds_constant(reference: Array, tolerance: float, ticks: int) -> bool:
    """Whether some constant stays in the tube around a reference."""
    if reference.dtype != object:
        lower, upper = tube(_numbers(reference, reference), tolerance, ticks)
        return bool(lower.max() <= upper.min())
    rows = np.arange(len(reference))
    texts = (np.full(len(rows), text, object) for text in set(reference[: ticks + 1]))
    return any(not distances(text, rows, reference, 0.0, ticks).any() for text in texts)


def extent_of(reference: Array) -> float:
    """Return the range of numbers; of texts, whether they change."""
    if reference.dtype == object:
        return float((reference != reference[0]).any())
    return float(np.ptp(_numbers(reference, reference)))


def _numbers(values: Array, reference: Array) -> Array:
    """Return numbers as float64; integers that it may not hold are counted from the first one."""
    if reference.dtype.kind not in "iu":
        return values.astype(float, copy=False)
    apart = values.astype("u8") - reference[:1].astype("u8")
    return np.asarray(apart.view("i8"), dtype=float)
