"""Analyses the control loops of a scenario at an instant of its run, by their sensitivity.

Each loop is opened at its input of the plant while the others stay closed; the disk margin opens
all at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.interface.parameters import grouped
from ...fmus.interface.variables import Value
from ..judging.signals import time_of
from ..run.options import Options
from ..run.prepare import Prepared, prepare
from ..run.run import Execution
from ..run.stopping import StopRequest
from ..scenario.criteria import check_instant, check_within
from ..scenario.scenario import Scenario, load_scenario
from .responses import DECAYED, LINEAR, Responses, measure

if TYPE_CHECKING:
    import control

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


ORDER: Final = 40  # largest of a model
HANKEL: Final = 80  # rows and columns of Hankel's matrix; more are slow, and seldom better
MOTION: Final = 0.05  # [rad] of a joint meanwhile, by which its loops hardly change
FIT: Final = 1e-3  # of the peak, by which a model's response may differ from the measured one


@dataclass(frozen=True, eq=False)
class Analysis:
    """The control loops of a scenario at an instant of its run, measured with its FMUs.

    Attributes:
        scenario: Name of the scenario.
        at: The instant [s].
        margins: Margins of each loop and of all at once; see `Margins`.
        responses: What was measured, n loops; see `Responses`.
        parameters: Those of the FMU that feeds the loops' inputs, by name.
    """

    scenario: str
    at: float
    margins: Margins
    responses: Responses = field(repr=False)
    parameters: Mapping[str, Value] = field(repr=False)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Where the n loops are opened, such as `plant.ctrl[1]` (n,)."""
        return self.responses.inputs

    @property
    def positions(self) -> tuple[str, ...]:
        """Positions of the joints that these inputs move (n,), or () if the plant has none."""
        return self.responses.positions

    @property
    def period(self) -> float:
        """Time between two updates of the controller, at which the models are sampled [s]."""
        return self.responses.period

    @property
    def model(self) -> control.StateSpace:
        """`control.StateSpace` of the closed loops.

        Inputs (n): what is added to `inputs`, in their units: rad for servo targets, N.m for
        torques. Outputs: `inputs` (n), then `positions` (n) in rad or m, both as differences to
        what they are if nothing is added. Signals have `_` for the point in their names.
        """
        return self._realised[0]

    @property
    def model_error(self) -> float:
        """Largest difference of the model's response to a pulse, as a share of its peak."""
        return self._realised[1]

    @property
    def sensitivity(self) -> control.StateSpace:
        """S = 1 / (1 + L) as a `control.StateSpace` of n inputs and n outputs."""
        return self.model[: len(self.inputs), :]

    @property
    def loop(self) -> control.StateSpace:
        """The open loops L as a `control.StateSpace`: from `inputs` to what feeds them, negated."""
        system, n = self.model, len(self.inputs)
        b, c = system.B, system.C[:n]
        zero = np.zeros((n, n))
        return _system(system.A - b @ c, b, -c, zero, self.period, self.inputs, self.inputs)

    @property
    def matrices(self) -> dict[str, Any]:
        """A, B, C and D of `model`, the names of its inputs and outputs, and its period [s]."""
        names = {"inputs": self.inputs, "outputs": (*self.inputs, *self.positions)}
        return {n: getattr(self.model, n) for n in "ABCD"} | names | {"period": self.period}

    @property
    def remarks(self) -> list[str]:
        """What makes the numbers less certain: one sentence each."""
        is_, window = self.responses, f"the {self.responses.window:g} s that were measured"
        texts = {
            f"{is_.remaining:.1%} of the responses is left after {window}": is_.remaining > DECAYED,
            f"a doubled pulse gives a response that is off by {is_.linearity:.1%}":
                is_.linearity > LINEAR,
            f"the arm moves by up to {is_.motion:.2g} rad within {window}, and its loops change "
            "with it; an instant at rest says more": is_.motion > MOTION,
            f"the state-space model's response differs by up to {self.model_error:.1%} of its peak":
                self.model_error > 10 * FIT,
        }  # fmt: skip
        return [text for text, holds in texts.items() if holds]

    @cached_property
    def _realised(self) -> tuple[Any, float]:
        return _realised(self.responses)


def analyze(
    scenario: Scenario | str | Path,
    at: float | str = "start",
    options: Options | None = None,
    *,
    loop: str = "",
) -> Analysis:
    """Measure the control loops of any scenario at an instant of its run.

    Small pulses are added to each input of the plant that is controlled, one after the other, and
    the FMUs go back to the same state before each. Commands and pushes stay as they are at that
    instant.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        at: Time [s], or an event of the run such as "grasp" or "release + 0.5".
        options: How it is run: other FMUs, parameters or coupling.
        loop: Input at which the loops are opened, such as "plant.ctrl"; "": all inputs of the
            instance `plant` that an FMU feeds.

    Returns:
        Margins and state-space models.

    Raises:
        InputError: Something given cannot be used, or an FMU cannot go back to a state.
        SimulationError: An FMU failed.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    prepared = prepare(scenario, options)
    tick = _tick(prepared, at)
    responses = measure(prepared, tick, loop)
    connections = prepared.assembly.system.connections
    fed_by = {".".join(c.target): c.source[0] for c in connections}[responses.inputs[0]]
    return Analysis(
        scenario.name,
        prepared.assembly.start_time + tick * prepared.scenario.step,
        judge(responses, prepared.scenario.coupling),
        responses,
        grouped(prepared.assembly.interfaces[fed_by], prepared.values[fed_by]),
    )


def _tick(prepared: Prepared, at: float | str) -> int:
    """Tick of a time, or of an event, for which the scenario is run first, in memory."""
    start, scenario = prepared.assembly.start_time, prepared.scenario
    span = start, start + scenario.duration
    with suppress(ValueError):
        at = float(at) if isinstance(at, str) else at
    try:
        instant = check_instant(at)
        time = check_within("at", instant, *span)
        if time is None:
            with Execution(prepared, writes=False) as execution:
                execution.advance(execution.ticks, StopRequest())
                events = execution.close().summary.events
            time = check_within("at", time_of(instant, events), *span)
    except ValueError as error:
        raise InputError(f"at: {str(error).removeprefix('at: ')}") from None
    return round(((time or 0.0) - start) / scenario.step)


def _realised(responses: Responses) -> tuple[Any, float]:
    """Return the smallest `control.StateSpace` that gives the responses, and its error."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    n, peaks = len(responses.inputs), np.abs(responses.pulses).max(axis=(0, 2))
    peaks[peaks == 0.0] = 1.0
    pulses = responses.pulses / peaks[:, None]
    rows = max(min(HANKEL, len(pulses) // 2 - 1), 1)
    order = min(ORDER, rows)
    with np.errstate(divide="ignore", invalid="ignore"):  # of states that are left out below
        # Its own sampling time would scale B: it is for responses to pulses of area 1.
        whole, _ = control.eigensys_realization(pulses.transpose(1, 2, 0), order, rows, rows)
    best, error = 0, math.inf
    for size in range(order + 1):
        misfit = _misfit(whole.A[:size, :size], whole.B[:size], whole.C[:, :size], pulses)
        if misfit < error:
            best, error = size, misfit
        if error <= FIT:
            break
    parts = whole.A[:best, :best], whole.B[:best], whole.C[:, :best] * peaks[:, None]
    inputs, outputs = responses.inputs, (*responses.inputs, *responses.positions)
    direct = responses.pulses[0] + np.eye(len(outputs), n)  # what is added, itself
    return _system(*parts, direct, responses.period, inputs, outputs), error


def _misfit(a: Array, b: Array, c: Array, pulses: Array) -> float:
    """Largest difference between a model's response to a pulse and the measured one."""
    state, error = b, 0.0
    for answer in pulses[1:]:
        error = float(np.maximum(error, np.abs(c @ state - answer).max()))
        state = a @ state
        if not error < 1.0:  # a model that diverges
            break
    return error


def _system(*parts: Any) -> Any:
    """Return a `control.StateSpace` of A, B, C, D, period, and names of inputs and outputs."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    *matrices, inputs, outputs = parts
    ends = [[name.replace(".", "_") for name in names] for names in (inputs, outputs)]
    return control.StateSpace(*matrices, inputs=ends[0], outputs=ends[1])
