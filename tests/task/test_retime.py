"""Time-optimal timing: paths with rounded corners, and tables within the robot's limits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim import run_scenario
from panda_cosim.cli.commands.retime import retime
from panda_cosim.fmus.errors import InputError
from panda_cosim.run.start import resolve, start_values
from panda_cosim.study.check.diagnosis import feasibility
from panda_cosim.task import rotations
from panda_cosim.task.scenario import Scenario, load_scenario
from panda_cosim.task.table import TableRow, TrajectoryTable
from panda_cosim.task.timing.path import motions
from panda_cosim.task.trajectory import Trajectory
from panda_cosim.task.writer import write_scenario
from random_tasks import run_in_memory

SHARE = 0.8
BLEND = 0.04  # [m]
DWELL = 0.2  # [s]


@pytest.fixture(scope="module")
def slow():
    """Down and aside over a rounded corner, a dwell, and up again, turning."""
    quarter = tuple(rotations.multiply(rotations.about_z(0.6), np.array([0.0, 0.5, 0.5, 0.0])))
    rows = (
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(1.0, "home", (0.0, 0.0, -0.12), 0.08, blend=BLEND),
        TableRow(2.0, "home", (0.0, 0.15, -0.12), 0.08),
        TableRow(2.0 + DWELL, "home", (0.0, 0.15, -0.12), 0.04),
        TableRow(3.2, "home", (0.0, 0.15, 0.0), 0.04, quarter),
    )
    return Scenario("corner", TrajectoryTable(rows), duration=3.2)


@pytest.fixture(scope="module")
def fast(slow):
    pytest.importorskip("toppra")
    return retime(slow, SHARE)[0]


def commands(scenario: Scenario, times: np.ndarray) -> np.ndarray:
    return resolve(scenario, start_values(scenario)).sample(times)


def test_it_is_faster_within_the_share(slow, fast):
    assert fast.duration < 0.6 * slow.duration
    violations, shares = feasibility(fast, share=SHARE + 1e-3)
    assert not violations
    assert max(shares.values()) > 0.9 * SHARE  # and uses it


def test_the_hand_stops_where_it_stopped_and_stays_as_long(slow, fast):
    there = commands(slow, np.array([2.0]))[0, :3]
    still = [row for row in fast.table.rows if np.allclose(row.position, there, 0.0, 2e-9)]
    assert still[-1].time - still[0].time == pytest.approx(DWELL, abs=0.011)
    assert next(row for row in fast.table.rows if row.grip == 0.04) == still[-1]


def test_what_is_written_reads_back_and_a_run_of_optimal_timing_is_the_same(slow, fast, tmp_path):
    write_scenario(fast, tmp_path / "fast")
    assert Scenario.read(tmp_path / "fast").table == fast.table
    times = np.arange(0.0, fast.duration, 0.001)
    optimal = replace(slow, timing="optimal", timing_share=SHARE)
    assert np.array_equal(commands(optimal, times), commands(fast, times))


def test_a_duration_that_is_too_short_is_refused(slow, fast):
    short = replace(slow, timing="optimal", timing_share=SHARE, duration=1.0)
    with pytest.raises(InputError, match=rf"duration: value 1.0; must be at least {fast.duration}"):
        commands(short, np.array([0.0]))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_rounded_path_has_no_kink(seed):
    """Position and orientation are continuous, and so is their slope."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 6))
    turns = rotations.exp(0.5 * rng.normal(size=(count, 3)))
    times, places = np.arange(count, dtype=float), rng.normal(size=(count, 3))
    trajectory = Trajectory(times, places, turns, np.zeros(count))
    (path,) = motions(trajectory, np.full(count, 0.2))
    places = np.linspace(0.0, path.length, 20_001)
    slope = np.diff(path.poses(places), axis=0) / (path.length / 20_000)
    assert np.abs(np.diff(slope, axis=0)).max() < 0.02
    assert np.allclose(path.poses(places[[0, -1]])[:, :3], trajectory.positions[[0, -1]])


def test_rows_that_exceed_nothing_keep_their_time_and_place(slow):
    timed = zip(slow.table.rows, (0.0, 1.0, 1.3, 1.5, 2.7), strict=True)
    table = TrajectoryTable(tuple(replace(row, time=time) for row, time in timed))
    hasty = replace(slow, table=table, duration=3.0)
    made, shares = retime(hasty, SHARE, keep_times=True)
    assert 0.9 * SHARE < max(shares.values()) <= SHARE
    old, new = (np.diff([row.time for row in s.table.rows]) for s in (hasty, made))
    assert new[[0, 2, 3]] == pytest.approx(old[[0, 2, 3]], abs=1e-9)
    assert new[1] > 1.1 * old[1]
    assert made.duration - made.table.rows[-1].time == pytest.approx(0.3, abs=1e-3)
    untimed = [replace(row, time=0.0) for row in made.table.rows]
    assert untimed == [replace(row, time=0.0) for row in slow.table.rows]
    feasible = replace(hasty, timing="feasible", timing_share=SHARE, duration=made.duration)
    times = np.arange(0.0, made.duration, 0.1)
    assert np.array_equal(commands(feasible, times), commands(made, times))


@pytest.mark.long
def test_a_recording_has_the_times_of_its_rows_as_they_are_played(slow, fast, tmp_path):
    optimal = replace(slow, timing="optimal", timing_share=SHARE)
    run = run_scenario(optimal, tmp_path / "run")
    assert run.recording.metadata["row_times"] == [row.time for row in fast.table.rows]


@pytest.mark.long
def test_near_the_stretched_arm_the_shortest_times_keep_the_torque_rate(slow):
    pytest.importorskip("toppra")
    rows = (
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(2.0, "world", (0.68, 0.0, 0.62), 0.08),
    )
    near = replace(slow, table=TrajectoryTable(rows), duration=2.0)
    made, shares = retime(near, SHARE)
    assert 0.5 * SHARE < shares["torque rate"] <= SHARE
    assert made.duration < 2.0


def test_shortest_times_along_a_stretched_arm_are_refused_soon():
    """Motions follow each other there without a dwell."""
    pytest.importorskip("toppra")
    with pytest.raises(InputError, match=r"^near_singular: row 3: no timing .* stretched arm"):
        retime(load_scenario("near_singular"))


@pytest.mark.parametrize(
    ("keep_times", "said"),
    [(False, r"no timing .*joint 2 stays at \d\d\.\d% of its limit; gravity alone needs it"),
     (True, r"torque of joint 2 is .* 12 times slower; gravity alone needs it")],
    ids=["shortest", "feasible"],
)  # fmt: skip
def test_a_torque_that_rest_takes_already_is_told_as_weight(slow, keep_times, said):
    if not keep_times:
        pytest.importorskip("toppra")
    out = replace(slow, table=TrajectoryTable((
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(0.3, "home", (0.15, 0.0, -0.05), 0.08),
    )), duration=0.3)  # fmt: skip
    with pytest.raises(InputError, match=rf"^corner: row 2: {said}.*a lighter load"):
        retime(out, 0.4, keep_times=keep_times)


# What the robot could not follow is named, and stretched until it can.


STRETCHED = 0.95
NOMINAL = load_scenario("pick_and_place")


def scenario(*rows: tuple[float, str, tuple[float, float, float]]) -> Scenario:
    """Return a scenario with these rows and nothing else to judge."""
    table = TrajectoryTable(tuple(TableRow(*row, 0.08) for row in rows))
    return replace(NOMINAL, name="mine", table=table, duration=rows[-1][0] + 0.2)


def stretch(scenario: Scenario) -> Scenario:
    return retime(scenario, STRETCHED, keep_times=True)[0]


def test_the_shares_are_those_of_a_run():
    violations, shares = feasibility(NOMINAL, share=STRETCHED)
    assert not violations
    calm = scenario((0.0, "home", (0, 0, 0)), (1.0, "home", (0, 0, 0.05)))
    assert stretch(calm) == calm
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
    rows = ((0.0, (0, 0, 0)), (1.0, (0, 0, 0.05)), (1.3, (-0.1, -0.3, 0.05)), (2.5, (0, 0, 0)))
    violations, _ = feasibility(scenario(*((time, "home", place) for time, place in rows)))
    assert {violation.row for violation in violations} == {3}
    worst = violations[0]
    assert worst.joint in range(1, 8)
    assert worst.share > 1.0
    assert 1.0 < worst.time <= 1.3


def test_what_is_out_of_reach_is_named_and_cannot_be_stretched_but_a_jump_can():
    far = scenario((0.0, "home", (0, 0, 0)), (1.2, "world", (1.0, 0, 0.5)))
    violations, _ = feasibility(far)
    assert any(violation.quantity == "reach" and violation.row == 2 for violation in violations)
    with pytest.raises(InputError, match=r"^mine: row 2: the hand is .* m off the command"):
        stretch(far)
    jump = scenario((0.0, "home", (0, 0, 0)), (0.001, "home", (0.0, 0.0, -0.2)))
    assert not feasibility(stretch(jump), share=STRETCHED)[0]
