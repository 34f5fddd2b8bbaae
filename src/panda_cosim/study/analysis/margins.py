"""Margins of control loops, by their sensitivity, as `definitions.toml` defines them.

Each loop is opened at its input of the plant while the others stay closed; the disk margin opens
all at once.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from ...fmus.master.wiring import Array
from ...run.finished import html
from .responses import ENOUGH, Responses
from .sensitivity import Limits, disk_margin, limits

SETTLED: Final = 0.02  # of a position's largest distance from its end
RESTING: Final = 0.002  # likewise, by which it moves at most in the last quarter of the responses
FREQUENCIES: Final = 600  # points of a frequency response
TABLES: Final = tomllib.loads(Path(__file__).with_name("loops.toml").read_text(encoding="utf-8"))
HEADS: Final[Mapping[str, str]] = TABLES["columns"]  # attribute by heading and unit


@dataclass(frozen=True, kw_only=True)
class Loop(Limits):
    """One loop, opened at its input with the others closed; definitions.toml says what each is."""

    input: str  # such as plant.ctrl[1]
    joint: int  # from 1: the element of the input, or a number of its own
    # Of the joint's response to a step of the input; None: it is not known, or drifts.
    peak_ratio: float | None = None  # position per unit of the input
    settling_ms: float | None = None


@dataclass(frozen=True, kw_only=True)
class Margins(Limits):
    """The loops for one period and one coupling; definitions.toml says what each is.

    Without margins, all numbers but the first are 0.
    """

    period: float  # [s]
    coupling: str  # with `jacobi`, targets and readings are one tick late
    stable: bool
    reason: str  # why there are no margins, or empty
    pole_modulus: float
    linear: bool
    loops: tuple[Loop, ...] = ()
    # Of all loops at once, each in its own way.
    disk_margin: float = 0.0
    disk_gain_db: float = 0.0
    disk_phase_deg: float = 0.0

    @property
    def lines(self) -> list[str]:
        """What the loops bear: all alike, and each in its own way."""
        head = f"period {self.period * 1e3:g} ms, {self.coupling}"
        if self.reason:
            return [f"{head}: {self.reason}"]
        gains = f"{shown(self.gain_up_db)} dB up, {shown(self.gain_down_db)} dB down"
        within = f"any gains within {self.disk_gain_db:.1f} dB"
        return [
            f"{head}: stable",
            f"Delay margin, common to all loops: {self.delay_margin_ms:.2f} ms",
            f"Gain margin, common to all loops: {gains}",
            f"Each in its own way, at once: disk margin {self.disk_margin:.2f}, {within}",
            f"or any phases within {self.disk_phase_deg:.0f} deg",
        ]

    @property
    def rows(self) -> list[list[str]]:
        """What one loop bears while the others stay as they are; the heads are `HEADS`."""
        return [[shown(getattr(loop, key)) for key in HEADS.values()] for loop in self.loops]

    def _repr_html_(self) -> str:
        return html(self.lines, [head.replace("\n", " ") for head in HEADS], self.rows)


def judge(responses: Responses, coupling: str) -> Margins:
    """Judge all loops of one measurement."""
    reason, sensitivity = _reason(responses), responses.sensitivity
    margins = Margins(
        period=responses.period, coupling=coupling, stable=not reason, reason=reason,
        pole_modulus=responses.growth, linear=responses.linear,
    )  # fmt: skip
    if reason:
        return margins
    disk = disk_margin(sensitivity)[0]
    return replace(
        margins, **vars(limits(sensitivity)), disk_margin=disk,
        loops=tuple(_judge(responses, loop) for loop in range(len(responses.inputs))),
        disk_gain_db=20.0 * math.log10((2.0 + disk) / (2.0 - disk)) if disk < 2.0 else math.inf,
        disk_phase_deg=math.degrees(2.0 * math.atan(0.5 * disk)),
    )  # fmt: skip


def _reason(responses: Responses) -> str:
    """Why there are no margins, or nothing."""
    if not responses.linear:
        return "NOT LINEAR, a doubled pulse does not double the response; no margins"
    if responses.unstable:
        return f"UNSTABLE, a pole of modulus {responses.growth:.4f}"
    if responses.remaining <= ENOUGH:
        return ""
    left = f"NO MARGINS: {responses.remaining:.0%} of the responses is left"
    if not responses.changed:
        return f"{left} after {responses.window * 1e3:g} ms"
    return (
        f"{left} when a contact or limit changes them, {responses.window * 1e3:g} ms after "
        f"{responses.at:g} s; choose an instant at rest"
    )


def shown(value: float | None) -> str:
    """Return a number of a table, or a dash if it is not known."""
    return "-" if value is None else f"{value:.4g}"


def frequencies(responses: Responses) -> Array:
    """Frequencies (m,) [rad/s] of a picture: of one wave in the responses to Nyquist's."""
    ends = 2.0 * np.pi / responses.window, 0.999 * np.pi / responses.period
    return np.geomspace(*ends, FREQUENCIES)


def steps(responses: Responses) -> Array:
    """How far each joint moves (ticks, n) if 1 is added to its input, or what is fed back there."""
    n = len(responses.inputs)
    own, first = range(n), n if responses.positions else 0
    return np.cumsum(responses.pulses[:, first:][:, own, own], axis=0)


def _judge(responses: Responses, index: int) -> Loop:
    """Compute the margins and the step response of one loop."""
    found = vars(limits(responses.sensitivity.loop(index)))
    element = responses.inputs[index].partition("[")[2].rstrip("]")
    joint = int(element) if element.isdigit() else index + 1
    loop = Loop(**found, input=responses.inputs[index], joint=joint)
    moves = steps(responses)[:, index]
    away = np.abs(moves - moves[-1])
    drifts = not away.max() or away[3 * len(away) // 4 :].max() > RESTING * away.max()
    if drifts or not responses.positions:
        return loop
    settled = np.flatnonzero(away > SETTLED * away.max())[-1] + 1
    settling_ms = float(settled * responses.period * 1e3)
    return replace(loop, peak_ratio=float(np.abs(moves).max()), settling_ms=settling_ms)


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of a scenario's loops, and their margins; `Analysis` says what each is."""

    scenario: str
    at: float
    inputs: tuple[str, ...]
    positions: tuple[str, ...]
    period: float
    margins: Margins
    responses: Responses = field(repr=False)
