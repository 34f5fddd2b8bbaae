"""What the robot could not follow is named, and stretched until it can."""

from dataclasses import replace

import numpy as np
import pytest

from panda_cosim import load_scenario
from panda_cosim.cli.commands.retime import retime
from panda_cosim.fmus.errors import InputError
from panda_cosim.run.start import start_values
from panda_cosim.study.check.diagnosis import feasibility
from panda_cosim.task.scenario import Scenario
from panda_cosim.task.table import TableRow, TrajectoryTable
from random_tasks import run_in_memory

SHARE = 0.95
NOMINAL = load_scenario("pick_and_place")


def scenario(*rows: tuple[float, str, tuple[float, float, float]]) -> Scenario:
    """Return a scenario with these rows and nothing else to judge."""
    table = TrajectoryTable(tuple(TableRow(*row, 0.08) for row in rows))
    return replace(NOMINAL, name="mine", table=table, duration=rows[-1][0] + 0.2)


def hasty() -> Scenario:
    """Return a scenario with one segment that is too fast, between two that are not."""
    return scenario(
        (0.0, "home", (0, 0, 0)),
        (1.0, "home", (0, 0, 0.05)),
        (1.3, "home", (-0.1, -0.3, 0.05)),
        (2.5, "home", (0, 0, 0)),
    )


def stretch(scenario: Scenario) -> Scenario:
    return retime(scenario, SHARE, keep_times=True)[0]


def test_the_shares_are_those_of_a_run():
    violations, shares = feasibility(NOMINAL, share=SHARE)
    assert not violations  # so it is left alone, see below
    limits = run_in_memory(NOMINAL).summary.limits
    for quantity in ("velocity", "acceleration"):
        measured = max(limits[f"reference_{quantity}_share"])
        assert shares[quantity] == pytest.approx(measured, abs=0.02)
    # Of the plant's torques, with the part that the servos' damping adds.
    assert shares["torque rate"] == pytest.approx(max(limits["torque_rate_share"]), 0.03)


def test_a_block_far_from_nominal_can_be_had_too():
    block = {"plant.block_pos": (0.3, -0.1), "plant.block_yaw": 0.78}
    assert not feasibility(NOMINAL, start_values(NOMINAL.changed(block)))[0]


def test_too_fast_a_segment_is_named_with_joint_and_amount():
    violations, _ = feasibility(hasty())
    assert {violation.row for violation in violations} == {3}
    worst = violations[0]
    assert worst.joint in range(1, 8)
    assert worst.share > 1.0
    assert 1.0 < worst.time <= 1.3


@pytest.mark.long
def test_a_stretched_table_fits_when_run_and_keeps_what_was_slow_enough():
    before, after = hasty(), stretch(hasty())
    violations, shares = feasibility(after, share=SHARE)
    assert not violations
    assert max(shares.values()) > SHARE - 0.05  # it is stretched no further than needed
    old = np.diff([row.time for row in before.table.rows])
    new = np.diff([row.time for row in after.table.rows])
    assert new[[0, 2]] == pytest.approx(old[[0, 2]], abs=1e-9)
    assert 1.2 * old[1] < new[1] < 5 * old[1]
    assert after.duration - before.duration == pytest.approx(new.sum() - old.sum(), abs=2e-3)
    course = run_in_memory(after).signals
    assert not course["controller.limit"].any()
    error = np.linalg.norm(course["plant.hand_xpos"] - course["controller.pos_cmd"], axis=1)
    assert error.max() <= 1.5e-4  # m


def test_what_fits_is_left_alone():
    calm = scenario((0.0, "home", (0, 0, 0)), (1.0, "home", (0, 0, 0.05)))
    assert stretch(calm) == calm


def test_what_is_out_of_reach_is_named_and_cannot_be_stretched():
    far = scenario((0.0, "home", (0, 0, 0)), (1.2, "world", (1.0, 0, 0.5)))
    violations, _ = feasibility(far)
    assert any(violation.quantity == "reach" and violation.row == 2 for violation in violations)
    with pytest.raises(InputError, match=r"^mine: row 2: the hand is .* m off the command"):
        stretch(far)


def test_a_jump_between_rows_can_be_stretched():
    jump = scenario((0.0, "home", (0, 0, 0)), (0.001, "home", (0.0, 0.0, -0.2)))
    assert not feasibility(stretch(jump), share=SHARE)[0]


@pytest.mark.long
def test_near_the_stretched_arm_more_time_keeps_the_torque_rate_that_is_measured():
    near = scenario((0.0, "home", (0, 0, 0)), (0.6, "world", (0.68, 0.0, 0.62)))
    assert feasibility(near)[1]["torque rate"] > 2.0
    slower = stretch(near)
    run = run_in_memory(slower)
    limits = run.summary.limits
    assert 0.5 < max(limits["torque_rate_share"]) <= 1.0
    assert max(limits["reference_jerk_share"]) <= 1.0
    assert not run.signals["controller.limit"].any()
