"""Postures in a table: the arm takes the commanded joint positions, not only the hand's pose."""

from dataclasses import replace

import numpy as np
import pytest

from forked import command
from panda_cosim import Scenario, Trajectory, run_scenario
from panda_cosim.assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.model import ArmModel
from panda_cosim.fmus.errors import InputError
from panda_cosim.task.table import TableRow, TrajectoryTable, read_tables
from panda_cosim.task.timing.joint_reference import joint_reference
from panda_cosim.task.trajectory import StartPose
from panda_cosim.task.writer import write_scenario

END = np.array([1.2, -0.3, 0.9, -1.8, 0.7, 1.9, -0.5])  # rad: the elbow leaves the vertical plane
DURATION = 2.0  # s
FOLLOWED = 2e-4  # rad by which the joint reference may miss the posture
THROUGH = 2e-3  # rad, the same where hand and posture ask for the same in a singularity
COMMANDED = [f"posture{rate}_cmd[{joint}]" for rate in ("", "_vel") for joint in range(1, 8)]


def planned(time: float, end: np.ndarray = END) -> np.ndarray:
    """Joint positions (7,) [rad] of a move from `home` that no pose of the hand determines."""
    u = min(time / DURATION, 1.0)
    return np.array(HOME_Q) + u**3 * (10.0 - 15.0 * u + 6.0 * u * u) * (end - HOME_Q)


def rows(end: np.ndarray = END) -> tuple[TableRow, ...]:
    """A row every 20 ms."""
    arm, made = ArmModel(), []
    for time in np.linspace(0.0, DURATION, round(DURATION / 0.02) + 1).round(3).tolist():
        q = planned(time, end)
        hand = arm.hand(q, np.zeros(7))
        pose = tuple(hand.position), 0.08, tuple(hand.orientation)
        made.append(TableRow(time, "world", *pose, posture=q))
    return tuple(made)


def scenario(**keys: object) -> Scenario:
    values = {"duration": DURATION + 0.2, "interpolation": "spline", **keys}
    return Scenario(name="posture", table=TrajectoryTable(rows()), **values)  # type: ignore[arg-type]


@pytest.mark.own_process
def test_the_arm_takes_the_postures_between_the_rows_too(tmp_path):
    recording = run_scenario(scenario(), tmp_path / "run").recording
    plan = np.array([planned(time) for time in recording["time"]])
    assert np.abs(recording["controller.qpos_ref"] - plan).max() < FOLLOWED
    assert np.abs(plan[-1] - HOME_Q)[2] > 0.5  # rad: far from where the pull to home leads
    shared = [f"controller.{name}" for name in COMMANDED]
    assert [name for name in recording.columns if "posture" in name] == shared


@pytest.mark.parametrize("joints", [{4: -0.1}, {2: 0.5, 4: -0.12, 6: 0.2}])
def test_a_followed_posture_leads_through_singularities(joints):
    """The hand's command alone is damped there; what the posture asks for moves it, too."""
    end = np.array([joints.get(joint + 1, q) for joint, q in enumerate(HOME_Q)])
    postures = np.array([row.posture for row in rows(end)])
    smallest = min(np.linalg.svd(ArmModel().hand(q, np.zeros(7)).jacobian)[1][-1] for q in postures)
    assert smallest < Gains().singular_value
    table, start = TrajectoryTable(rows(end)), StartPose(HOME_XPOS, HOME_XQUAT, HOME_XPOS)
    trajectory = Trajectory.from_table(table, start, interpolation="spline")
    ticks = 0.001 * np.arange(int(DURATION / 0.001))
    reference = joint_reference(trajectory, ticks, Gains(follow_posture=True), limited=True)
    plan = np.array([planned(time, end) for time in ticks])
    assert np.abs(reference.position - plan).max() < THROUGH


@pytest.mark.parametrize("interpolation", ["linear", "quintic", "spline"])
def test_postures_go_from_row_to_row_and_their_rates_are_the_derivative(interpolation):
    random, step = np.random.default_rng(1), 1e-6  # s
    postures, times = random.normal(size=(6, 7)), np.arange(6.0)
    hand = np.zeros((6, 3)), np.tile([1.0, 0, 0, 0], (6, 1))
    trajectory = Trajectory(times, *hand, np.zeros(6), interpolation, postures)
    np.testing.assert_allclose(trajectory.sample(times)[:, 14:21], postures, atol=1e-12)
    t = np.linspace(-0.3, 5.3, 401)
    before, now, after = (trajectory.sample(t + shift)[:, 14:] for shift in (-step, 0.0, step))
    rates = (after - before)[:, :7] / (2.0 * step)
    expected = 0.0 if interpolation == "linear" else rates  # as of the hand's velocity
    np.testing.assert_allclose(now[:, 7:], np.broadcast_to(expected, rates.shape), atol=1e-4)


def test_a_table_reads_back_as_it_was_written_and_slower_rows_keep_their_postures(tmp_path):
    write_scenario(scenario(), tmp_path / "new")
    assert Scenario.read(tmp_path / "new").table == scenario().table
    command("inputs", tmp_path / "new", tmp_path / "inputs.csv")
    header, first = (tmp_path / "inputs.csv").read_text().splitlines()[:2]
    assert header.split(",")[15:] == COMMANDED
    numbers = [float(text) for text in first.split(",")]
    np.testing.assert_allclose(numbers[15:], [*HOME_Q, *[0.0] * 7], atol=1e-12)
    slower = ("--keep-times", "--share", "0.4", "--out", tmp_path / "slow", tmp_path / "new")
    command("retime", *slower, code=0)
    slow = Scenario.read(tmp_path / "slow").table
    assert slow.rows[-1].time > DURATION
    assert [row.posture for row in slow.rows] == [row.posture for row in scenario().table.rows]


HEAD = "time,frame,x,y,z,grip,q1,q2,q3,q4,q5,q6,q7\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace(",q7", "") + "0,home,0,0,0,0,0,0,0,-1,0,1", "posture: .*; must be 7 numbers"),
        (HEAD + "0,home,0,0,0,0,0,0,0,-1,0,1,", "line 2: column q7: value ''; must be a number"),
        (HEAD + "0,home,0,0,0,0,0,0,0,0.5,0,1,0", "line 2: column q4: value 0.5; must be a .*rad"),
    ],
)
def test_columns_that_are_no_posture_are_refused(tmp_path, text, message):
    (tmp_path / "trajectory.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_tables(tmp_path / "trajectory.csv")


def test_what_postures_do_not_go_with_is_refused(tmp_path):
    first, second, *others = rows()
    with pytest.raises(InputError, match="row 2: q1 to q7; must be set in all rows or in none"):
        TrajectoryTable((first, replace(second, posture=None), *others))
    for keys in ({"gains": "tutorial"}, {"timing": "optimal"}):
        with pytest.raises(InputError, match="q1 to q7: must be left out of the table with"):
            scenario(**keys)
    write_scenario(scenario(), tmp_path / "new")
    refused = command("retime", "--out", tmp_path / "fast", tmp_path / "new", code=2)
    assert "q1 to q7" in refused.stderr
    assert not (tmp_path / "fast").exists()
