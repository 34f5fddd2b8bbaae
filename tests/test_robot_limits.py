"""What a run's summary tells of the robot's limits."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fake_recording import FakeRecording
from panda_cosim import load_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.result.judging.advice import advise
from panda_cosim.result.judging.limits import (
    exceeded,
    first_limit,
    largest_share,
    limit_shares,
)
from panda_cosim.run.summary import summarize
from panda_cosim.task.criteria import Success
from panda_cosim.task.limits import torque_rates
from random_tasks import run_plain

TICKS = 20
JERK = ("joint-reference jerk of joint 4", "200%")
NO_REFERENCE = np.zeros(51, [("ctrl", float, 8)])  # outputs of a law of one's own, for 0.05 s


def still(**metadata: Any) -> FakeRecording:
    """A recording of nothing that moves; its signals may be changed."""
    signals = {
        "plant.qpos": np.tile([*HOME_Q, *(0.0,) * 9], (TICKS, 1)),
        "plant.qvel": np.zeros((TICKS, 15)),
        "plant.actuator_force": np.zeros((TICKS, 8)),
        "plant.hand_xpos": np.zeros((TICKS, 3)),
        "controller.qpos_ref": np.tile(HOME_Q, (TICKS, 1)),
        "controller.qvel_ref": np.zeros((TICKS, 7)),
        "controller.limit": np.zeros((TICKS, 7)),
    }
    return FakeRecording(1e-3 * np.arange(TICKS), signals, metadata)


def test_another_arm_is_not_held_against_this_robots_limits():
    run = still()
    del run.signals["plant.hand_xpos"]
    shares = limit_shares(run)
    assert {key for key in shares if not key.startswith("reference_")} == {"not_measured"}
    assert set(shares["not_measured"].values()) == {"plant.hand_xpos is not recorded"}


def test_a_torque_rate_is_measured_but_for_the_servos_switching_on():
    run = still()
    run.signals["plant.actuator_force"][1:, 1] = 30.0  # N.m, from 0 at the start
    assert limit_shares(run)["torque_rate_share"] == [0.0] * 7
    run.signals["plant.actuator_force"][10:, 1] += 1.5  # N.m in 1 ms, at most 1 N.m
    shares = limit_shares(run)
    assert shares["torque_rate_share"][1] == pytest.approx(1.5)
    assert list(exceeded(run, shares)) == [("torque rate of joint 2", "150%", 0.01)]


def test_jerk_is_that_of_the_reference():
    run = still()
    # One step of 0.0125 rad/s of joint 4: 12.5 rad/s^2, and 12,500 rad/s^3 of 6,250.
    run.signals["controller.qvel_ref"][10:, 3] = 0.0125
    assert [each[:2] for each in exceeded(run, limit_shares(run))] == [JERK]


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_the_last_row_counts(coupling):
    run = still(coupling=coupling)
    run.signals["controller.qvel_ref"][-1, 3] = 0.0125
    assert [each[:2] for each in exceeded(run, limit_shares(run))] == [JERK]


@pytest.mark.parametrize("on", [0, 1, 2, 10])
def test_however_late_the_servos_are_switched_on_it_is_no_torque_rate(on):
    torque = np.zeros((TICKS, 7))
    torque[on:, 1], torque[on + 1 :, 1] = 30.0, 32.0  # N.m
    assert not torque_rates(torque).any()
    torque[on + 2 :, 4] = 1.5
    assert torque_rates(torque)[on + 2, 4] == 1500.0  # N.m/s
    assert not torque_rates(np.zeros((1, 7))).any()


def test_with_jacobi_the_reference_begins_with_the_first_update():
    """Row 0 has the start values, and the first update stands in row 1."""
    run = still(coupling="jacobi")
    run.signals["controller.qvel_ref"][1:, 6] = -0.005  # rad/s
    shares = limit_shares(run)
    assert shares["reference_jerk_share"] == shares["reference_acceleration_share"] == [0.0] * 7


def test_a_law_without_a_joint_reference_is_judged_by_the_plants_limits():
    scenario = load_scenario("pick_and_place")
    run = still()
    del run.signals["controller.qvel_ref"]
    run.signals["plant.actuator_force"][10:, 1] = 5.0  # N.m
    run.signals["plant.actuator_force"][12:, 1] = 10.22
    course = replace(run_plain(replace(scenario, duration=0.05)), controller=NO_REFERENCE)
    shares = limit_shares(run)
    assert list(exceeded(run, shares)) == [("torque rate of joint 2", "522%", 0.012)]
    assert shares["not_measured"] == dict.fromkeys(
        [f"reference_{kind}_share" for kind in ("velocity", "acceleration", "jerk")],
        "controller.qvel_ref is not recorded",
    )
    asked = replace(scenario, success=Success(max_limit_share=1.0))
    (criterion,) = summarize(course, asked).criteria
    assert criterion.ok
    assert criterion.value == largest_share(limit_shares(course))


def test_the_first_limit_that_binds_is_named():
    run = still()
    assert first_limit(run) is None
    run.signals["controller.limit"][7:, 4] = 2.0
    run.signals["controller.limit"][9:, 1] = 3.0
    assert first_limit(run) == {"time_s": 0.007, "joint": 5, "kind": "velocity"}


def test_a_servo_without_torque_left_is_the_first_limit():
    run = still()
    run.signals["controller.limit"][7:, 4] = 4.0
    run.signals["plant.actuator_force"][5:, 1] = -43.5  # N.m of 87
    first = first_limit(run)
    assert first is not None
    assert first["kind"] == "jerk"
    run.metadata["parameters"] = {"plant": {"torque_limit_scale[2]": 0.5}}
    assert first_limit(run) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del run.signals["controller.limit"]  # a law that has no limits
    assert first_limit(run) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del run.signals["plant.actuator_force"]
    assert first_limit(run) is None


def test_limits_are_told_where_all_criteria_hold_and_can_be_criteria():
    scenario = load_scenario("near_singular")
    run = run_plain(scenario)
    unbounded = replace(scenario.success, max_limit_share=None)
    summary = summarize(run, replace(scenario, success=unbounded))
    assert summary.success
    text = "\n".join(advise(run, summary))
    assert re.search(r"torque rate of joint \d is \d+% of its limit", text)
    assert "reference jerk" not in text  # which is kept
    assert "limit of joint" in text
    assert "more time does not help" in text
    early = replace(summary, first_limit={**(summary.first_limit or {}), "time_s": 0.1})
    for ours in (True, False):  # it refuses FMUs of one's own
        told = "\n".join(advise(run, early, ours=ours))
        assert ("give that row more time (`panda-cosim retime" in told) == ours
    for bound, ok in ((1.0, False), (100.0, True)):
        bounded = replace(scenario.success, max_limit_share=bound)
        summary = summarize(run, replace(scenario, success=bounded))
        assert summary.success is ok
        assert next(c for c in summary.criteria if c.name == "max_limit_share").ok is ok
