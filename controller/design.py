"""Linear analysis of the control law: margins, bandwidth and step responses of its loops.

Plant and controller are linearised about the keyframe `home`, at rest: the plant by MuJoCo's
finite differences (`mjd_transitionFD`), the controller by central differences of
`Controller.update` itself, with its reference and its PIDs as state. The plant's states are those
of arm and fingers; the block touches neither. Each loop is broken at one servo target while the
other six stay closed; the disk margin breaks all seven at once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assets import STEP_SIZE, asset_files
from .controller import STATE, Controller
from .gains import DEFAULT, Gains
from .signals import Buffer

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Response = NDArray[np.complex128]

PERIODS = (0.001, 0.002, 0.005, 0.010)  # [s]
STEP_TIME = 0.5  # [s] of step responses
NOISE = 1e-6  # [rad, rad/s] step of finite differences, far inside all limits
BALANCING = 10  # rounds
NEUTRAL = 1e-9  # beyond 1 [1]: `ki` has a pole at 1 that nothing excites, in the null space
FREQUENCIES = 600  # points of a frequency response


@dataclass(frozen=True)
class Loop:
    """One loop, broken at one servo target with the others closed.

    Attributes:
        joint: Number of the joint, from 1.
        gain_margin_db: Smallest change of gain, up or down, that makes it unstable [dB].
        phase_margin_deg: Smallest phase margin [deg].
        delay_margin_ms: Smallest further delay that makes it unstable [ms].
        crossover_hz: Highest frequency at which the loop's gain is 1 [Hz].
        bandwidth_hz: Frequency at which the closed loop has fallen to -3 dB [Hz].
        peak_ratio: Peak of the joint's response to a step of its servo target [1].
        settling_ms: When the response has fallen below 2 % of that peak for good [ms]; infinite
            if that takes longer than half a second.
    """

    joint: int
    gain_margin_db: float
    phase_margin_deg: float
    delay_margin_ms: float
    crossover_hz: float
    bandwidth_hz: float
    peak_ratio: float
    settling_ms: float


@dataclass(frozen=True)
class Variant:
    """The seven loops for one period and one coupling.

    Attributes:
        period: Between updates of the controller [s].
        coupling: `gauss-seidel`, or `jacobi`: a servo target acts one tick later.
        stable: Whether no pole of the closed system is outside the unit circle.
        pole_modulus: Largest modulus of these poles [1].
        loops: One per joint; none where the system is unstable, as margins mean nothing then.
        disk_margin: Of all seven loops at once [1]: each may change, at the same time and in its
            own way, by any gain and phase within the disk. 0: unstable.
        disk_gain_db: Change of gain alone that is within the disk, up or down [dB].
        disk_phase_deg: Change of phase alone that is within the disk [deg].
    """

    period: float
    coupling: str
    stable: bool
    pole_modulus: float
    loops: tuple[Loop, ...]
    disk_margin: float
    disk_gain_db: float
    disk_phase_deg: float


@dataclass(frozen=True)
class Analysis:
    """All variants; the first is the default."""

    variants: tuple[Variant, ...]
    systems: tuple[LinearLoop, ...] = field(repr=False, compare=False)

    def to_json(self) -> str:
        """Return all numbers as JSON; infinite ones as null."""
        plain = {"variants": [asdict(variant) for variant in self.variants]}
        return json.dumps(_without_infinity(plain), indent=2, allow_nan=False)


def _without_infinity(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_infinity(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_infinity(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """Plant and controller, sampled once per period, with the loops open.

    state+ = transition state + entry u, ctrl = feedback state; closed: u = ctrl, `late` periods
    ago.

    Attributes:
        period: [s].
        transition: Shape (n, n); the plant's 18 states come first: 9 positions, 9 speeds.
        entry: Shape (n, 7).
        feedback: Shape (7, n).
        late: By how many periods the servo targets act late.
    """

    period: float
    transition: Matrix
    entry: Matrix
    feedback: Matrix
    late: int = 0

    @cached_property
    def _delayed(self) -> tuple[Matrix, Matrix]:
        """Closed system and its entry, with 7 states for each period of delay."""
        n, m = len(self.transition), 7 * self.late
        chain = np.eye(n + m, k=7)
        chain[:n] = 0.0
        chain[:n, :n] = self.transition
        chain[:n, n : n + 7] = self.entry if m else 0.0
        targets = np.hstack((self.feedback, np.zeros((7, m))))
        entry = np.eye(n + m)[:, -7:] if m else self.entry
        return chain + entry @ targets, entry

    @property
    def closed(self) -> Matrix:
        """State transition with all loops closed (n + 7 late, n + 7 late)."""
        return self._delayed[0]

    def response(self, joint: int, omega: Vector) -> Response:
        """Return the open loop's frequency response at servo target `joint` (from 0).

        Args:
            joint: Index of the joint.
            omega: Frequencies (m,) [rad/s].

        Returns:
            Shape (m,).
        """
        loops = self.matrix_response(omega)
        others = np.arange(7) != joint
        rest = np.eye(6) + loops[:, others][:, :, others]
        closed = np.linalg.solve(rest, loops[:, others, joint][:, :, None])
        through_them = loops[:, [joint]][:, :, others] @ closed
        answer: Response = loops[:, joint, joint] - through_them[:, 0, 0]
        return answer

    def matrix_response(self, omega: Vector) -> Response:
        """Return the frequency response of all seven open loops (m, 7, 7).

        Args:
            omega: Frequencies (m,) [rad/s].
        """
        z = np.exp(1j * omega * self.period)[:, None, None]
        states = np.linalg.solve(z * np.eye(len(self.transition)) - self.transition, self.entry)
        answer: Response = -self.feedback @ states * z**-self.late
        return answer

    def step(self, joint: int, ticks: int) -> Vector:
        """Return how far the joint moves (ticks,) when 1 is added to its servo target."""
        closed, entry = self._delayed
        state, path = np.zeros(len(closed)), np.empty(ticks)
        for tick in range(ticks):
            path[tick] = state[joint]
            state = closed @ state + entry[:, joint]
        return path


def analyze(
    gains: Gains = DEFAULT,
    periods: Sequence[float] = PERIODS,
    servo_scale: Sequence[float] = (1.0,) * 7,
    delay: float = 0.0,
) -> Analysis:
    """Linearise, close and judge the loops.

    Args:
        gains: Of the controller.
        periods: Of the controller [s], whole multiples of 1 ms; the first also with Jacobi
            coupling.
        servo_scale: Stiffness and damping of each servo, as a share of the model's (7,) [1].
        delay: How late the measurements are [s]; rounded up to whole periods.

    Returns:
        Margins and responses of all variants.
    """
    wanted = [(period, "gauss-seidel") for period in periods] + [(periods[0], "jacobi")]
    systems = tuple(linear_loop(gains, *each, servo_scale, delay) for each in wanted)
    pairs = zip(systems, wanted, strict=True)
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
    against columns balances it, as each loop changes by itself: a lower bound of the margin.

    Args:
        loops: Frequency response of the k open loops, which are stable when closed (m, k, k).

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


def linear_loop(
    gains: Gains,
    period: float,
    coupling: str = "gauss-seidel",
    servo_scale: Sequence[float] = (1.0,) * 7,
    delay: float = 0.0,
) -> LinearLoop:
    """Linearise plant and controller at `home`.

    Args:
        gains: Of the controller.
        period: Of the controller [s], a whole multiple of 1 ms.
        coupling: `gauss-seidel` or `jacobi`.
        servo_scale: Stiffness and damping of each servo, as a share of the model's (7,) [1].
        delay: How late the measurements are [s]; rounded up to whole periods.
    """
    scene = _Scene(servo_scale)
    a, b = scene.transition(round(period / STEP_SIZE))
    output, dynamics = scene.controller(gains, period)
    n, m = len(a), len(dynamics)
    transition = np.zeros((n + m, n + m))
    transition[:n, :n], transition[n:] = a, dynamics
    entry = np.vstack((b, np.zeros((m, 7))))
    # To a loop, measurements that come late are targets that act late.
    late = delay + STEP_SIZE * (coupling == "jacobi")
    return LinearLoop(period, transition, entry, output, math.ceil(late / period - 1e-9))


class _Scene:
    """The arm of the scene `tabletop` at rest at `home`, and what a controller reads there."""

    def __init__(self, servo_scale: Sequence[float]) -> None:
        files = asset_files()
        self._model: Any = mujoco.MjModel.from_xml_string(
            files["tabletop.xml"].decode(), assets=files
        )
        scale = np.array(servo_scale)
        self._model.actuator_gainprm[:7, 0] *= scale
        self._model.actuator_biasprm[:7, 1:3] *= scale[:, None]
        self._data: Any = mujoco.MjData(self._model)
        self._hand = self._model.body("hand").id
        self._jac = np.zeros((6, self._model.nv))
        self._rest(np.zeros(18))

    def _rest(self, deviation: Vector) -> None:
        """Go to `home`, with the arm and the fingers deviating by (18,) [rad, m, rad/s, m/s]."""
        model, data = self._model, self._data
        mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
        data.qpos[:9] += deviation[:9]
        data.qvel[:9] = deviation[9:]
        mujoco.mj_forward(model, data)
        mujoco.mj_jacBody(model, data, self._jac[:3], self._jac[3:], self._hand)

    def transition(self, ticks: int) -> tuple[Matrix, Matrix]:
        """Return A (18, 18) and B (18, 7) of a number of ticks with the servo targets held."""
        model, data = self._model, self._data
        self._rest(np.zeros(18))
        stiffness = model.actuator_gainprm[:7, 0]
        data.ctrl[:7] = data.qpos[:7] + data.qfrc_bias[:7] / stiffness  # an equilibrium
        n = 2 * model.nv
        a, b = np.zeros((n, n)), np.zeros((n, model.nu))
        mujoco.mjd_transitionFD(model, data, NOISE, True, a, b, None, None)
        kept = np.r_[0:9, model.nv : model.nv + 9]
        a1, b1 = a[np.ix_(kept, kept)], b[kept, :7]
        powers = [np.linalg.matrix_power(a1, tick) for tick in range(ticks + 1)]
        return powers[-1], sum((p @ b1 for p in powers[:-1]), np.zeros((18, 7)))

    def controller(self, gains: Gains, period: float) -> tuple[Matrix, Matrix]:
        """Linearise a controller that holds `home`.

        Returns:
            From the plant's 18 states and the controller's own m: the servo targets
            (7, 18 + m), and the controller's next states (m, 18 + m).
        """
        controller = Controller(gains, period)
        self._rest(np.zeros(18))
        controller.inputs["pos_cmd"] = self._data.xpos[self._hand]
        controller.inputs["quat_cmd"] = self._data.xquat[self._hand]
        self._measure(controller)
        controller.update()  # starts the law
        start, own = controller.get_state(), _own_states(controller)
        columns = [
            self._answer(controller, start, own, NOISE * direction)
            - self._answer(controller, start, own, -NOISE * direction)
            for direction in np.eye(18 + own.size)
        ]
        matrix = np.array(columns).T / (2.0 * NOISE)
        return matrix[:7], matrix[7:]

    def _measure(self, controller: Controller) -> None:
        data, inputs = self._data, controller.inputs
        inputs["hand_xpos"], inputs["hand_xquat"] = data.xpos[self._hand], data.xquat[self._hand]
        inputs["jac"] = self._jac[:, :7]
        inputs["qpos"], inputs["qvel"] = data.qpos[:7], data.qvel[:7]
        inputs["qfrc_bias"] = data.qfrc_bias[:7]

    def _answer(
        self,
        controller: Controller,
        start: Vector,
        own: NDArray[np.intp],
        deviation: Vector,
    ) -> Vector:
        """Return servo targets and controller states one update after a deviation (18 + m,)."""
        self._rest(deviation[:18])
        self._measure(controller)
        controller.set_state(start)
        controller.state_values[own] += deviation[18:]
        controller.update()
        return np.concatenate((controller.outputs["ctrl"][:7], controller.state_values[own]))


def _own_states(controller: Controller) -> NDArray[np.intp]:
    """Indices of the states that matter near rest: the reference, and the PIDs' used parts."""
    gains = controller.gains
    chosen = Buffer(STATE)
    law = getattr(chosen.views, gains.law)
    if gains.use_reference:
        law.q_ref[:] = law.qd_before[:] = 1.0
    law.pid.integral[:] = np.array(gains.ki) > 0.0
    law.pid.derivative[:] = law.pid.error_before[:] = np.array(gains.kd) > 0.0
    return np.flatnonzero(chosen.values)


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
