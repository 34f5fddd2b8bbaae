"""The random moves of `random_moves`, by our law and by mink's inverse kinematics.

`python .ci/studies/mink_moves.py` runs both over the same 300 moves and prints a table. mink (a
differential inverse kinematics by quadratic programming, Apache-2.0) integrates a joint reference
from the commanded pose, within the joints' ranges and velocities, as its examples do; what makes
servo targets of a reference (lag, gravity, inertia, PID) is the same for both.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import mink
import numpy as np
from numpy.typing import NDArray
from random_moves import Move, run_moves

from panda_cosim.assets import STEP_SIZE
from panda_cosim.assets.fields import Buffer
from panda_cosim.assets.franka import Q_MAX, Q_MIN, QD_MAX
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.model import ArmModel, load_arm
from panda_cosim.controller.signals import INPUTS, OUTPUTS

Array = NDArray[np.float64]
COUNT, SEED = 300, 17
POSTURE_COST, POSTURE_RATE = 1e-3, 4.0  # [1], [1/s]
LM_DAMPING = 1e-6
SOLVER = "daqp"


class MinkController:
    """Servo targets by mink; with the inputs and outputs of `controller.Controller`.

    Args:
        gains: Posture, servo lag and stiffness, PID gain; the others are not used.
    """

    def __init__(self, gains: Gains) -> None:
        x, y = Buffer(INPUTS), Buffer(OUTPUTS)
        self.input_values, self.inputs, self.outputs = x.values, x.record, y.record
        self._x, self._y, self._gains, self._arm = x.views, y.views, gains, ArmModel()
        model = load_arm()
        self._configuration = mink.Configuration(model)
        self._hand = mink.FrameTask("hand", "body", 1.0, 1.0, lm_damping=LM_DAMPING)
        self._posture = mink.PostureTask(model, POSTURE_COST, gain=POSTURE_RATE * STEP_SIZE)
        speeds = {f"joint{i}": limit for i, limit in enumerate(QD_MAX, 1)}
        self._limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        self._q, self._qd = np.zeros(9), np.zeros(7)
        self._started = False

    def _start(self) -> None:
        self._q[:7] = self._x.qpos
        self._configuration.update(self._q)
        self._posture.set_target(np.array([*self._gains.posture, 0.0, 0.0]))
        self._started = True
        self._hand.set_target(_pose_after(self._x))
        for _ in range(5):  # the start's pose is rounded; its correction is no move
            self._configuration.integrate_inplace(self._velocity(), STEP_SIZE)

    def _velocity(self) -> Array:
        tasks = [self._hand, self._posture]
        velocity: Array = mink.solve_ik(
            self._configuration, tasks, STEP_SIZE, SOLVER, limits=self._limits
        )
        return velocity

    def update(self) -> None:
        """Go to where the command is one period later."""
        x, y, gains = self._x, self._y, self._gains
        if not self._started:
            self._start()
        self._hand.set_target(_pose_after(x))
        tasks = [self._hand, self._posture]
        velocity = mink.solve_ik(self._configuration, tasks, STEP_SIZE, SOLVER, limits=self._limits)
        q_ref, qd = self._configuration.q[:7].copy(), velocity[:7]
        inertia = self._arm.inertia_force(x.qpos, (qd - self._qd) / STEP_SIZE)
        torque = (x.qfrc_bias + inertia) / np.array(gains.servo_stiffness)
        pid = np.array(gains.kp) * (q_ref - x.qpos)
        y.ctrl[:7] = np.clip(q_ref + np.array(gains.servo_lag) * qd + torque + pid, Q_MIN, Q_MAX)
        y.ctrl[7] = 255.0
        y.qpos_ref[:], y.qvel_ref[:] = q_ref, qd
        self._configuration.integrate_inplace(velocity, STEP_SIZE)
        self._qd[:] = qd


def _pose_after(x: SimpleNamespace) -> mink.SE3:
    """The commanded pose, moved on by one period of the commanded twist."""
    turn = mink.SO3.exp(STEP_SIZE * x.omega_cmd) @ mink.SO3(x.quat_cmd)
    return mink.SE3.from_rotation_and_translation(turn, x.pos_cmd + STEP_SIZE * x.vel_cmd)


def described(name: str, moves: Sequence[Move]) -> str:
    """Return a row of the table, in Markdown."""
    arrived = sum(move.end_error <= 1e-3 and move.end_turn <= 0.5 for move in moves)
    exceeded = sum(move.share > 1.0 for move in moves)
    rms = 1e3 * float(np.median([move.rms for move in moves]))
    update = float(np.median([move.update_us for move in moves]))
    ok = sum(move.ok for move in moves)
    share = max(move.share for move in moves)
    rates = sum(move.torque_rate > 1.0 for move in moves)
    cells = (name, arrived, exceeded, f"{share:.2f}", ok, rates, f"{rms:.3f}", f"{update:.0f}")
    return "| " + " | ".join(map(str, cells)) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare our law with mink on the same random moves; prints a table in Markdown."""
    parser = argparse.ArgumentParser(
        prog="python .ci/studies/mink_moves.py", description=main.__doc__
    )
    parser.add_argument("--count", type=int, default=COUNT, help="number of moves")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the drawing")
    parser.add_argument("--processes", type=int, help="how many at a time; default: one a core")
    options = parser.parse_args(arguments)
    given: dict[str, Any] = {"seed": options.seed, "processes": options.processes}
    print("| | at the goal | with a limit exceeded | largest share of a limit | both hold | "
          "torque rate exceeded | RMS median, mm | update, us |\n|" + " --- |" * 8)  # fmt: skip
    print(described("ours, in Python", run_moves(options.count, **given)), flush=True)
    print(described("mink", run_moves(options.count, **given, make=MinkController)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
