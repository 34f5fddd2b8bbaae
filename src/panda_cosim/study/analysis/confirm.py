"""Margins confirmed by runs of the coupled FMUs, with a change just within each and just beyond.

Each change is a filter in the loops, of what they carry beside the run: a gain, a delay of whole
periods, an all-pass with the phase at the crossover, or that filter within a disk which reaches its
edge at the worst frequency. Nothing here assumes that the loops are linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.master.wiring import Array
from .margins import Margins
from .responses import Filters
from .sensitivity import Limits, Sensitivity, crossings, disk_margin

NEAR: Final = (0.05, 0.2, 0.4)  # shares of a margin: the first at which a run is decided
LONGEST: Final = 400  # periods of a delay that is run
REFUTED: Final = "refuted"
WHOLE: Final = 1.4  # size of a disk; from 2 on, gains of 0 and infinity are within it
REAL: Final = 1e-6  # sine of a phase that is 0 or 180 deg

Which = NDArray[np.bool_]  # of the loops change
Bears = Callable[[Filters], bool | None]  # whether the loops are stable; None: not decided
# A margin, its value, whole steps of what is run or 0, and the filters of a change.
Side = tuple[str, float, float, Callable[[float], Filters]]


@dataclass(frozen=True)
class Confirmation:
    """A margin, and what runs on both sides of it came to."""

    margin: str  # its key
    value: float  # as in the margins
    input: str  # of the loop that changes alone; "": all
    within: float  # the change that was run, in the same unit
    stable_within: bool | None  # None: not decided
    beyond: float
    stable_beyond: bool | None

    @property
    def verdict(self) -> str:
        """Whether both are as the margin says; beyond the disk, a bound, loops may be stable."""
        if self.stable_within is False or (self.stable_beyond and self.margin != "disk_margin"):
            return REFUTED
        return "confirmed" if self.stable_within and self.stable_beyond is not None else "open"


def confirm(margins: Margins, sensitivity: Sensitivity, bears: Bears) -> tuple[Confirmation, ...]:
    """Run with changes on both sides of each margin.

    Args:
        margins: Of all loops, and of each.
        sensitivity: Of all loops.
        bears: Runs with a filter in each loop, and tells whether they are stable.
    """
    numbers = np.arange(len(margins.loops))
    alone = margins.loops if len(numbers) > 1 else ()
    parts: list[tuple[str, Limits, Sensitivity, Which]] = [
        ("", margins, sensitivity, numbers >= 0),
        *((e.input, e, sensitivity.loop(i), numbers == i) for i, e in enumerate(alone)),
    ]
    return tuple(
        Confirmation(*side[:2], name, *_run(bears, which, side, -1), *_run(bears, which, side, 1))
        for name, limits, part, which in parts
        for side in _sides(limits, part)
    )


def _run(bears: Bears, changed: Which, side: Side, sign: float) -> tuple[float, bool | None]:
    """Run with less or more than a margin: as near to it as this is decided; returns the change."""
    _, value, step, filters = side
    for near in NEAR:
        change = _share(value, step, 1.0 + sign * near)
        stable = bears(_only(filters(change), changed))
        if stable is not None:
            break
    return change, stable


def _sides(limits: Limits, sensitivity: Sensitivity) -> Iterator[Side]:
    """The margins of loops that change alike, as far as a filter can reach them."""
    period, (omega, angles) = 1e3 * sensitivity.period, crossings(sensitivity)
    for key, sign in (("gain_up_db", 1.0), ("gain_down_db", -1.0)):
        if math.isfinite(getattr(limits, key)):
            yield key, getattr(limits, key), 0.0, partial(_gain, sign)
    is_bound = (sensitivity.eigenvalues[-1].real > 0.5).all()  # a gain below 1 at Nyquist's
    if is_bound and limits.delay_margin_ms <= LONGEST * period:
        yield "delay_margin_ms", limits.delay_margin_ms, period, partial(_delay, period)
    if angles.size == 1 and angles[0] > 0.0:  # an all-pass lags, and more at higher frequencies
        all_pass = partial(_phase, float(omega[0]) * sensitivity.period)
        yield "phase_margin_deg", limits.phase_margin_deg, 0.0, all_pass
    if getattr(limits, "disk_margin", math.inf) < WHOLE:  # that of all loops
        size, worst, phases = disk_margin(sensitivity)
        yield "disk_margin", size, 0.0, partial(_disk, worst * sensitivity.period, phases)


def _share(value: float, step: float, share: float) -> float:
    """Return a share of a value, or the next whole number of steps that is farther away."""
    if not step:
        return share * value
    return step * (math.floor if share < 1.0 else math.ceil)(share * value / step)


def _only(filters: Filters, changed: Which) -> Filters:
    """Return filters (taps, n) in the loops that change, and none in the others."""
    b, a = (np.where(changed, each, 0.0) for each in filters)
    b[0], a[0] = (np.where(changed, each[0], 1.0) for each in filters)
    return b, a


def _gain(sign: float, decibels: float) -> Filters:
    return np.array([[10.0 ** (sign * decibels / 20.0)]]), np.ones((1, 1))


def _delay(period: float, milliseconds: float) -> Filters:
    ticks = round(milliseconds / period)
    return np.eye(ticks + 1)[:, [ticks]], np.eye(ticks + 1)[:, [0]]


def _phase(angle: float, degrees: float) -> Filters:
    """All-pass that lags by some degrees at a frequency, as an angle per period."""
    c = _all_pass(angle, np.array([math.radians(degrees)]))
    return np.array([c, np.ones(1)]), np.array([np.ones(1), c])


def _disk(angle: float, phases: Array, size: float) -> Filters:
    """Gains (2 + d) / (2 - d), with |d| as the disk's size and its phases at a frequency."""
    lags = np.maximum(np.mod(REAL - phases, 2.0 * math.pi) - REAL, 0.0)
    turned = lags > math.pi - REAL  # beyond what an all-pass lags: by its sign
    c = _all_pass(angle, np.maximum(lags - math.pi * turned, 0.0))
    d = np.where(turned, -size, size) * np.array([c, np.ones_like(c)])
    whole = 2.0 * np.array([np.ones_like(c), c])
    first = whole[0] - d[0]
    return (whole + d) / first, (whole - d) / first


def _all_pass(angle: float, lags: Array) -> Array:
    """Coefficient c of (c + 1 / z) / (1 + c / z), which lags so far at a frequency."""
    angle = max(angle, REAL)  # at 0, there is no lag
    return np.asarray(np.sin(0.5 * (angle - lags)) / np.sin(0.5 * (angle + lags)))
