"""Linear analysis of the control law: margins, bandwidth and step responses of its loops.

Each loop is broken at one servo target while the other six stay closed; the disk margin breaks all
seven at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

from .gains import DEFAULT, Gains
from .linear import LinearLoop, Response, Vector, linear_loop

PERIODS = (0.001, 0.002, 0.005, 0.010)  # [s]
STEP_TIME = 0.5  # [s] of step responses
BALANCING = 10  # rounds
NEUTRAL = 1e-9  # beyond 1 [1]: `ki` has a pole at 1 that nothing excites, in the null space
FREQUENCIES = 600  # points of a frequency response


@dataclass(frozen=True)
class Loop:
    """One loop, broken at one servo target with the others closed."""

    joint: int  # from 1
    gain_margin_db: float  # smallest change of gain, up or down, that makes it unstable
    phase_margin_deg: float  # the smallest
    delay_margin_ms: float  # smallest further delay that makes it unstable
    crossover_hz: float  # highest frequency at which the loop's gain is 1
    bandwidth_hz: float  # where the closed loop has fallen to -3 dB
    peak_ratio: float  # of the joint's response to a step of its servo target [1]
    settling_ms: float  # until 2 % of that peak for good; infinite if beyond half a second


@dataclass(frozen=True)
class Variant:
    """The seven loops for one period and one coupling."""

    period: float  # between updates of the controller [s]
    coupling: str  # with `jacobi`, targets and readings are one tick late
    stable: bool  # no pole of the closed system is outside the unit circle
    pole_modulus: float  # the largest [1]
    loops: tuple[Loop, ...]  # none where the system is unstable
    # Of all loops at once [1]: each may change, at the same time and in its own way, by any gain
    # and phase within the disk. 0: unstable.
    disk_margin: float
    disk_gain_db: float  # change of gain alone within the disk, up or down
    disk_phase_deg: float  # change of phase alone within the disk


@dataclass(frozen=True)
class Analysis:
    """All variants; the first is the default."""

    variants: tuple[Variant, ...]
    systems: tuple[LinearLoop, ...] = field(repr=False, compare=False)

    def to_json(self) -> str:
        """Return all numbers as JSON; infinite ones as null."""
        return to_json({"variants": self.variants}, inf_nan_mode="null").decode()


def analyze(
    gains: Gains = DEFAULT,
    periods: Sequence[float] = PERIODS,
    servo_scale: Sequence[float] = (1.0,) * 7,
    delay: float | None = None,
) -> Analysis:
    """Linearise, close and judge the loops: of each period, and of the first with Jacobi coupling.

    The periods are whole multiples of 1 ms; `servo_scale` and `delay` are those of `linear_loop`.
    """
    setups = [(period, "gauss-seidel") for period in periods] + [(periods[0], "jacobi")]
    systems = tuple(linear_loop(gains, *setup, servo_scale, delay) for setup in setups)
    pairs = zip(systems, setups, strict=True)
    return Analysis(tuple(_variant(system, coupling) for system, (_, coupling) in pairs), systems)


def _variant(system: LinearLoop, coupling: str) -> Variant:
    """Judge all loops of one period and coupling."""
    modulus = float(np.abs(np.linalg.eigvals(system.closed)).max())
    if modulus > 1.0 + NEUTRAL:
        return Variant(system.period, coupling, False, modulus, (), 0.0, 0.0, 0.0)
    disk = disk_margin(system.matrix_response(frequencies(system.period)))
    gain = 20.0 * math.log10((2.0 + disk) / (2.0 - disk)) if disk < 2.0 else math.inf
    phase = math.degrees(2.0 * math.atan(0.5 * disk))
    loops = tuple(_judge(system, joint) for joint in range(7))
    return Variant(system.period, coupling, True, modulus, loops, disk, gain, phase)


def disk_margin(loops: Response) -> float:
    """Size of the largest disk of simultaneous changes that leaves all loops stable [1].

    It is 1 / max |(S - T) / 2|, the largest singular value over all frequencies. Scaling rows
    against columns balances it, as each loop changes by itself: a lower bound of the margin. The
    response is that of the k open loops, which are stable when closed (m, k, k).

    Source: P. Seiler, A. Packard, P. Gahinet, "An Introduction to Disk Margins", IEEE Control
    Systems Magazine 40(5), 2020.
    """
    one = np.eye(loops.shape[1])
    half = np.linalg.inv(one + loops) - 0.5 * one  # (S - T) / 2
    for _ in range(BALANCING):
        rows, columns = (np.linalg.norm(half, axis=axis) for axis in (2, 1))
        scale = np.sqrt(columns / rows)
        half = half * scale[:, :, None] / scale[:, None, :]
    return float(1.0 / np.linalg.norm(half, ord=2, axis=(1, 2)).max())


def frequencies(period: float) -> Vector:
    """Frequencies at which a loop is evaluated, up to half the sampling rate (m,) [rad/s]."""
    omega: Vector = np.geomspace(0.5, 0.999 * np.pi / period, FREQUENCIES)
    return omega


def _judge(system: LinearLoop, joint: int) -> Loop:
    """Compute the margins and the step response of one loop."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    omega = frequencies(system.period)
    answer = system.response(joint, omega)
    highest = system.response(joint, np.array([np.pi / system.period]))[0].real
    data = control.FrequencyResponseData(answer, omega, smooth=True)
    gains, phases, _, _, crossings, _ = control.stability_margins(data, returnall=True)
    if highest < 0.0:  # the loop gain is also real at the highest frequency
        gains = np.append(gains, -1.0 / highest)
    delays = np.radians(np.where(phases > 0, phases, phases + 360.0)) / crossings
    closed = np.abs(answer / (1.0 + answer))
    above = np.flatnonzero(closed >= math.sqrt(0.5))
    step = system.step(joint, round(STEP_TIME / system.period))
    peak = np.abs(step).max()
    return Loop(
        joint=joint + 1,
        gain_margin_db=float(np.abs(20.0 * np.log10(gains)).min(initial=math.inf)),
        phase_margin_deg=float(np.abs(phases).min(initial=math.inf)),
        delay_margin_ms=float(delays.min(initial=math.inf)) * 1e3,
        crossover_hz=float(crossings.max(initial=0.0)) / (2.0 * math.pi),
        bandwidth_hz=float(omega[above[-1]] / (2.0 * math.pi)) if len(above) else 0.0,
        peak_ratio=float(peak),
        settling_ms=_settling(np.abs(step) > 0.02 * peak) * system.period * 1e3,
    )


def _settling(late: NDArray[np.bool_]) -> float:
    """Return the number of samples after which none is late."""
    if late[-1]:
        return math.inf
    return float(np.flatnonzero(late)[-1]) if late.any() else 0.0
