"""Judges control loops by their sensitivity: margins, bandwidth and step responses.

Each loop is opened at its input of the plant while the others stay closed; the disk margin opens
all at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .responses import Responses

Array = NDArray[np.float64]
Response = NDArray[np.complex128]

STEP_TIME = 0.5  # [s] of step responses
BALANCING = 10  # rounds
FREQUENCIES = 600  # points of a frequency response


@dataclass(frozen=True)
class Loop:
    """One loop, opened at its input with the others closed."""

    input: str  # such as plant.ctrl[1]
    joint: int  # from 1: the element of the input, or a number of its own
    gain_margin_db: float  # smallest change of gain, up or down, that makes it unstable
    phase_margin_deg: float  # the smallest
    delay_margin_ms: float  # smallest further delay that makes it unstable
    crossover_hz: float  # highest frequency at which the loop's gain is 1
    bandwidth_hz: float  # where the closed loop has fallen to -3 dB
    # Of the joint's response to a step of the input [position per unit of the input]; None: there
    # is no such position.
    peak_ratio: float | None
    settling_ms: float | None  # until 2 % of that peak for good; infinite if beyond half a second


@dataclass(frozen=True)
class Margins:
    """The loops for one period and one coupling."""

    period: float  # between updates of the controller [s]
    coupling: str  # with `jacobi`, targets and readings are one tick late
    stable: bool  # the responses to a pulse are linear, and decay or at least do not grow
    pole_modulus: float  # factor per period by which they change at last
    linear: bool  # whether twice a pulse gives almost twice the response; else there are no margins
    loops: tuple[Loop, ...]  # none where the system is not stable
    # Of all loops at once [1]: each may change, at the same time and in its own way, by any gain
    # and phase within the disk. 0: unstable.
    disk_margin: float
    disk_gain_db: float  # change of gain alone within the disk, up or down
    disk_phase_deg: float  # change of phase alone within the disk


def judge(responses: Responses, coupling: str) -> Margins:
    """Judge all loops of one measurement."""
    stable, linear = responses.stable, responses.linear
    about = (responses.period, coupling, stable, responses.growth, linear)
    if not stable:
        return Margins(*about, (), 0.0, 0.0, 0.0)
    disk = disk_margin(sensitivity(responses, frequencies(responses)))
    gain = 20.0 * math.log10((2.0 + disk) / (2.0 - disk)) if disk < 2.0 else math.inf
    phase = math.degrees(2.0 * math.atan(0.5 * disk))
    loops = tuple(_judge(responses, loop) for loop in range(len(responses.inputs)))
    return Margins(*about, loops, disk, gain, phase)


def frequencies(responses: Responses) -> Array:
    """Frequencies (m,) [rad/s] that the responses resolve: of one wave in them to Nyquist's."""
    ends = 2.0 * np.pi / responses.window, 0.999 * np.pi / responses.period
    omega: Array = np.geomspace(*ends, FREQUENCIES)
    return omega


def sensitivity(responses: Responses, omega: Array) -> Response:
    """Return S = 1 / (1 + L) of all n loops (m, n, n) at frequencies (m,) [rad/s]."""
    n, ticks = len(responses.inputs), np.arange(len(responses.pulses))
    turns = np.exp(-1j * np.outer(omega * responses.period, ticks))
    return np.asarray(np.eye(n) + np.tensordot(turns, responses.pulses[:, :n], axes=1), complex)


def open_loop(responses: Responses, loop: int, omega: Array) -> Response:
    """Return the response (m,) of one open loop, with the others closed."""
    return 1.0 / sensitivity(responses, omega)[:, loop, loop] - 1.0


def disk_margin(sensitivities: Response) -> float:
    """Size of the largest disk of simultaneous changes that leaves all loops stable [1].

    It is 1 / max |(S - T) / 2|, the largest singular value over all frequencies. Scaling rows
    against columns balances it, as each loop changes by itself: a lower bound of the margin. The
    sensitivities are those of k loops (m, k, k), which are stable when closed.

    Source: P. Seiler, A. Packard, P. Gahinet, "An Introduction to Disk Margins", IEEE Control
    Systems Magazine 40(5), 2020.
    """
    half = sensitivities - 0.5 * np.eye(sensitivities.shape[1])  # (S - T) / 2
    for _ in range(BALANCING):
        rows, columns = (np.linalg.norm(half, axis=axis) for axis in (2, 1))
        scale = np.sqrt(columns / rows)
        half = half * scale[:, :, None] / scale[:, None, :]
    return float(1.0 / np.linalg.norm(half, ord=2, axis=(1, 2)).max())


def steps(responses: Responses) -> Array:
    """How far each joint moves (ticks, n) if 1 is added to its input; (ticks, 0): not known."""
    n = len(responses.inputs)
    ticks, own = round(STEP_TIME / responses.period), range(len(responses.positions))
    moves = np.cumsum(responses.pulses[:ticks, n:][:, own, own], axis=0)
    longer: Array = np.pad(moves, ((0, ticks - len(moves)), (0, 0)), mode="edge")  # at rest
    return longer


def _judge(responses: Responses, loop: int) -> Loop:
    """Compute the margins and the step response of one loop."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import

    omega = frequencies(responses)
    answer = open_loop(responses, loop, omega)
    highest = open_loop(responses, loop, np.array([np.pi / responses.period]))[0].real
    real, imaginary, excess = (
        CubicSpline(omega, part) for part in (answer.real, answer.imag, np.abs(answer) - 1.0)
    )
    # The loop is also real at the highest frequency.
    at_180 = np.append(real(imaginary.roots(extrapolate=False)), highest)
    gains = -1.0 / at_180[at_180 < 0.0]
    crossings = excess.roots(extrapolate=False)
    phases = np.degrees(np.angle(-real(crossings) - 1j * imaginary(crossings)))
    delays = np.radians(np.where(phases > 0, phases, phases + 360.0)) / crossings
    closed = np.abs(answer / (1.0 + answer))
    above = np.flatnonzero(closed >= math.sqrt(0.5))
    peak = settling = None
    if responses.positions:
        step = np.abs(steps(responses)[:, loop])
        peak = float(step.max())
        late = np.flatnonzero(step > 0.02 * peak).max(initial=0)  # the last such sample
        at_rest = late < len(step) - 1
        settling = float(late) * responses.period * 1e3 if at_rest else math.inf
    element = responses.inputs[loop].partition("[")[2].rstrip("]")
    return Loop(
        input=responses.inputs[loop],
        joint=int(element) if element.isdigit() else loop + 1,
        gain_margin_db=float(np.abs(20.0 * np.log10(gains)).min(initial=math.inf)),
        phase_margin_deg=float(np.abs(phases).min(initial=math.inf)),
        delay_margin_ms=float(delays.min(initial=math.inf)) * 1e3,
        crossover_hz=float(crossings.max(initial=0.0)) / (2.0 * math.pi),
        bandwidth_hz=float(omega[above[-1]] / (2.0 * math.pi)) if len(above) else 0.0,
        peak_ratio=peak,
        settling_ms=settling,
    )
