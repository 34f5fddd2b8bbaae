"""What a run's summary tells of the robot's limits."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from panda_cosim import load_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.scenarios.cli.verdict import outcome_lines
from panda_cosim.scenarios.judging.limits import exceeded, first_limit, limit_shares
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.running.summary import Summary, summarize
from random_tasks import run_plain

TICKS = 20


@dataclass
class Signals:
    """A recording of nothing that moves; its arrays may be changed."""

    arrays: dict[str, NDArray[np.float64]] = field(
        default_factory=lambda: {
            "plant.qpos": np.tile([*HOME_Q, *(0.0,) * 9], (TICKS, 1)),
            "plant.qvel": np.zeros((TICKS, 15)),
            "plant.actuator_force": np.zeros((TICKS, 8)),
            "controller.qvel_ref": np.zeros((TICKS, 7)),
            "controller.limit": np.zeros((TICKS, 7)),
        }
    )
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def time(self) -> NDArray[np.float64]:
        """Instants (n,) [s]."""
        return 1e-3 * np.arange(TICKS)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.arrays[name]

    def __contains__(self, name: str) -> bool:
        return name.split("[", maxsplit=1)[0] in self.arrays

    @property
    def recording(self) -> Recording:
        """The same, for those who want a recording."""
        return cast(Recording, self)


@cache
def near_singular(bound: float | None = None) -> Summary:
    scenario = load_scenario("near_singular")
    asked = replace(scenario.success, max_limit_share=bound)
    return summarize(cast(Recording, run_plain(scenario)), replace(scenario, success=asked))


def test_a_torque_rate_is_measured_but_for_the_servos_switching_on() -> None:
    signals = Signals()
    signals.arrays["plant.actuator_force"][1:, 1] = 30.0  # N.m, from 0 at the start
    assert limit_shares(signals.recording)["torque_rate_share"] == [0.0] * 7
    signals.arrays["plant.actuator_force"][10:, 1] += 1.5  # N.m in 1 ms, at most 1 N.m
    shares = limit_shares(signals.recording)
    assert shares["torque_rate_share"][1] == pytest.approx(1.5)
    assert exceeded(shares) == ["torque rate of joint 2 (150%)"]


def test_jerk_is_that_of_the_reference() -> None:
    signals = Signals()
    # One step of 0.0125 rad/s of joint 4: 12.5 rad/s^2, and 12,500 rad/s^3 of 6,250.
    signals.arrays["controller.qvel_ref"][10:, 3] = 0.0125
    assert exceeded(limit_shares(signals.recording)) == ["joint-reference jerk of joint 4 (200%)"]


def test_a_run_that_ends_while_the_reference_moves_has_no_jerk_at_its_last_row() -> None:
    signals = Signals()
    # 10 rad/s^2 throughout; with Gauss-Seidel coupling no update follows in the last tick.
    speeds = 0.01 * np.arange(TICKS - 1)
    signals.arrays["controller.qvel_ref"][:] = np.append(speeds, speeds[-1])[:, None]
    shares = limit_shares(signals.recording)
    assert max(shares["reference_jerk_share"]) < 1e-6
    assert shares["reference_acceleration_share"][0] == pytest.approx(10.0 / 15.0)


def test_with_jacobi_coupling_the_last_row_counts() -> None:
    signals = Signals(metadata={"coupling": "jacobi"})
    signals.arrays["controller.qvel_ref"][-1, 3] = 0.0125
    assert exceeded(limit_shares(signals.recording)) == ["joint-reference jerk of joint 4 (200%)"]


def test_a_share_that_rounds_to_the_limit_is_not_told_as_the_limit() -> None:
    assert exceeded({"velocity_share": [0.5, 1.001]}) == [
        "joint velocity of joint 2 (just above 100%)"
    ]


def test_the_first_limit_that_binds_is_named() -> None:
    signals = Signals()
    assert first_limit(signals.recording) is None
    signals.arrays["controller.limit"][7:, 4] = 2.0
    signals.arrays["controller.limit"][9:, 1] = 3.0
    assert first_limit(signals.recording) == {"time_s": 0.007, "joint": 5, "kind": "velocity"}


def test_a_servo_without_torque_left_is_the_first_limit() -> None:
    signals = Signals()
    signals.arrays["controller.limit"][7:, 4] = 4.0
    signals.arrays["plant.actuator_force"][5:, 1] = -43.5  # N.m of 87
    assert first_limit(signals.recording)["kind"] == "jerk"
    signals.metadata["parameters"] = {"plant": {"torque_limit_scale[2]": 0.5}}
    assert first_limit(signals.recording) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del signals.arrays["controller.limit"]  # a law that has no limits
    assert first_limit(signals.recording) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del signals.arrays["plant.actuator_force"]
    assert first_limit(signals.recording) is None


def test_a_run_tells_that_a_servo_had_no_torque_left() -> None:
    scenario = load_scenario("worn_joints")
    weak = replace(scenario.mismatch, torque_limit_scale=(0.25,) * 7)
    scenario = replace(scenario, mismatch=weak)
    summary = summarize(cast(Recording, run_plain(scenario)), scenario)
    said = "\n".join(line for line, _ in outcome_lines(summary, realtime=False))
    assert f"The torque limit of joint {summary.first_limit['joint']} first held the arm" in said
    assert "carry less" in said


def test_a_run_says_what_it_exceeded_even_where_its_criteria_hold() -> None:
    summary = near_singular()
    assert summary.success
    said = "\n".join(line for line, _ in outcome_lines(summary, realtime=False))
    assert "Beyond the robot's limits: " in said
    assert "torque rate" in said
    assert "reference jerk" not in said  # which is kept
    assert "limit of joint" in said
    assert "give that row more time" in said


@pytest.mark.parametrize(("bound", "success"), [(1.0, False), (100.0, True)])
def test_limits_can_be_criteria(bound: float, success: bool) -> None:
    summary = near_singular(bound)
    assert summary.success is success
    criterion = next(c for c in summary.criteria if c.name == "max_limit_share")
    assert criterion.ok is success
