"""The gains "robust": noise, elastic joints, and the line that proposes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panda_cosim.assets.franka import HOME_Q, TORQUE_RATE_MAX
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import preset
from panda_cosim.run.execution import run_scenario
from panda_cosim.run.prepare import prepare
from panda_cosim.task.scenario import load_scenario

APPROACH = load_scenario("pick_and_place").changed({"duration": 1.4})  # s, before the grasp
NOISE = {"mismatch.joint_noise": 1e-5, "mismatch.hand_pose_source": "model"}  # [rad]
SETTLED = 100  # ticks, after which the servos carry the arm


def torque_rate(out: Path, **values: Any) -> float:
    """Largest torque rate of the approach, as a share of the robot's limit."""
    run = run_scenario(APPROACH.changed({**NOISE, **values}), out)
    torques = run.recording["plant.actuator_force"][SETTLED:, :7]
    return float((np.abs(np.diff(torques, axis=0)) / (TORQUE_RATE_MAX * 1e-3)).max())


@pytest.mark.own_process
def test_noise_of_1e_5_rad_keeps_the_torque_rate(tmp_path):
    assert torque_rate(tmp_path / "default") > 5.0
    assert torque_rate(tmp_path / "robust", gains="robust") < 1.0


@pytest.mark.own_process
def test_elastic_joints_do_not_swing(tmp_path):
    elastic = APPROACH.changed({"scene": "elastic"})
    gains = ("default", "robust")
    runs = [run_scenario(elastic.changed({"gains": g}), tmp_path / g) for g in gains]
    rms = [run.summary.tracking["rms_mm"] for run in runs]
    assert rms[0] > 5.0
    assert rms[1] < 1.0


def test_the_pose_error_passes_a_low_pass():
    """A step of the error e gives the velocity ik_gain e (1 - decay^n) in the n-th update."""
    gains = preset("robust", error_filter=0.009, posture_gain=(0.0,) * 7, ik_gain=1.0)
    controller = Controller(gains)
    x = controller.inputs
    x["qpos"], x["jac"] = HOME_Q, np.eye(6, 7)  # its last joint moves nothing
    x["quat_cmd"] = x["hand_xquat"] = (1.0, 0.0, 0.0, 0.0)
    controller.update()
    for update in range(1, 6):
        x["pos_cmd"] = (1e-6, 0.0, 0.0)
        controller.update()
        expected = 1e-6 * (1.0 - 0.9**update)
        assert controller.outputs["qvel_ref"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("values", "cause"),
    [
        (NOISE, "mismatch.joint_noise"),
        ({"scene": "elastic"}, 'scene "elastic"'),
        ({"mismatch.preset": "worn"}, "mismatch.joint_noise"),
        ({"mismatch.payload": 1.0}, ""),
        (NOISE | {"gains": "robust"}, ""),
        (NOISE | {"controller.kp": 1.0, "controller.ik_gain": 2.0}, ""),
    ],
)
def test_default_gains_that_meet_mismatch_are_said(values, cause):
    notes = prepare(APPROACH.changed(values)).notes
    assert len(notes) == bool(cause)
    assert all(cause in note and 'gains = "robust"' in note for note in notes)
