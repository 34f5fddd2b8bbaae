"""Plant and controller as a linear system, about the keyframe `home`, at rest.

The plant is linearised by MuJoCo's finite differences (`mjd_transitionFD`), the controller by
central differences of `Controller.update` itself, with its reference and its PIDs as state. The
plant's states are those of arm and fingers; the block touches neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from panda_cosim.assets import STEP_SIZE, asset_files
from panda_cosim.controller.controller import STATE, Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.signals import Buffer

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Response = NDArray[np.complex128]

DIFFERENCE = 1e-6  # [rad, rad/s] step of finite differences, far inside all limits


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """Plant and controller, sampled once per period, with the loops open.

    state+ = transition state + entry u, ctrl = feedback state; closed: u = ctrl, `late` periods
    ago.
    """

    period: float  # [s]
    transition: Matrix  # (n, n); the plant's 9 positions and 9 speeds come first
    entry: Matrix  # (n, 7)
    feedback: Matrix  # (7, n)
    late: int = 0  # periods by which the servo targets act late

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
        """Return the open loop's response (m,) at joint `joint` (from 0) to omega (m,) [rad/s]."""
        loops = self.matrix_response(omega)
        others = np.arange(7) != joint
        rest = np.eye(6) + loops[:, others][:, :, others]
        closed = np.linalg.solve(rest, loops[:, others, joint][:, :, None])
        through_them = loops[:, [joint]][:, :, others] @ closed
        answer: Response = loops[:, joint, joint] - through_them[:, 0, 0]
        return answer

    def matrix_response(self, omega: Vector) -> Response:
        """Return the response of all seven open loops (m, 7, 7) to frequencies (m,) [rad/s]."""
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


def linear_loop(
    gains: Gains,
    period: float,
    coupling: str = "gauss-seidel",
    servo_scale: Sequence[float] = (1.0,) * 7,
    delay: float | None = None,
) -> LinearLoop:
    """Linearise plant and controller at `home`.

    The period [s] is a whole multiple of 1 ms. `servo_scale` (7,) scales stiffness and damping of
    each servo [1]. `delay` is how late the sensors' readings are [s], rounded up to whole periods;
    None: there are no sensors. With `jacobi` they take a tick of their own.
    """
    scene = _Scene(servo_scale)
    a, b = scene.transition(round(period / STEP_SIZE))
    output, dynamics = scene.controller(gains, period)
    n, m = len(a), len(dynamics)
    transition = np.zeros((n + m, n + m))
    transition[:n, :n], transition[n:] = a, dynamics
    entry = np.vstack((b, np.zeros((m, 7))))
    # To a loop, measurements that come late are targets that act late.
    passed_on = 0 if coupling == "gauss-seidel" else 1 if delay is None else 2  # [tick]
    late = (delay or 0.0) + STEP_SIZE * passed_on
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
        mujoco.mjd_transitionFD(model, data, DIFFERENCE, True, a, b, None, None)
        kept = np.r_[0:9, model.nv : model.nv + 9]
        a1, b1 = a[np.ix_(kept, kept)], b[kept, :7]
        powers = [np.linalg.matrix_power(a1, tick) for tick in range(ticks + 1)]
        return powers[-1], sum((p @ b1 for p in powers[:-1]), np.zeros((18, 7)))

    def controller(self, gains: Gains, period: float) -> tuple[Matrix, Matrix]:
        """Linearise a controller that holds `home`.

        From the plant's 18 states and the controller's own m: the servo targets (7, 18 + m), and
        the controller's next states (m, 18 + m).
        """
        controller = Controller(gains, period)
        self._rest(np.zeros(18))
        controller.inputs["pos_cmd"] = self._data.xpos[self._hand]
        controller.inputs["quat_cmd"] = self._data.xquat[self._hand]
        controller.inputs["posture_cmd"] = self._data.qpos[:7]
        self._measure(controller)
        controller.update()  # starts the law
        start, own = controller.get_state(), _own_states(controller)
        columns = [
            self._answer(controller, start, own, DIFFERENCE * direction)
            - self._answer(controller, start, own, -DIFFERENCE * direction)
            for direction in np.eye(18 + own.size)
        ]
        matrix = np.array(columns).T / (2.0 * DIFFERENCE)
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
        law.error[:] = gains.error_filter > 0.0
        law.q_refs[: round(gains.reading_delay / controller.period)] = 1.0
    law.pid.integral[:] = np.array(gains.ki) > 0.0
    law.pid.derivative[:] = law.pid.error_before[:] = np.array(gains.kd) > 0.0
    return np.flatnonzero(chosen.values)
