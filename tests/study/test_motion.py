"""`check motion.csv --robot`: what the real robot would refuse of a motion of joints."""

import numpy as np
import pytest

from panda_cosim.assets.franka import HOME_Q, Q_MAX
from panda_cosim.assets.limits import robot_limits
from panda_cosim.result.judging.preflight import preflight
from panda_cosim.result.recording import Recording
from panda_cosim.run.execution import run_scenario
from panda_cosim.study.check.motion import check_motion, followed, motion_text, motions, retimed
from refusals import refused

NAMES = [f"q{joint}" for joint in range(1, 8)]
SECONDS = 3.0


def smooth(times):
    """From 0 to 1 within `SECONDS`, its rate, and where that is largest: at the middle."""
    s = times / SECONDS
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / SECONDS


def write(path, times, joints, speeds=None):
    columns, names = [times, *joints.T], ["time", *NAMES]
    if speeds is not None:
        columns, names = [*columns, *speeds.T], [*names, *(f"qd{joint}" for joint in range(1, 8))]
    text = ",".join(names)
    np.savetxt(path, np.transpose(columns), delimiter=",", header=text, comments="", fmt="%.17g")
    return path


def moved(path, amplitude, rows=31, *, speeds=False):
    """A smooth motion of joint 1 [rad] from the home pose."""
    times = np.linspace(0.0, SECONDS, rows)
    place, rate = smooth(times)
    change = np.eye(7)[0] * amplitude
    return write(path, times, np.array(HOME_Q) + np.outer(place, change),
                 np.outer(rate, change) if speeds else None)  # fmt: skip


@pytest.mark.parametrize(
    ("robot", "arm", "rows", "speeds"),
    [("fer", "panda", 31, False), ("fr3", "fr3", 31, True), ("fr3", "fr3", 3001, False)],
)
def test_speeds_are_refused_from_the_robots_limit_on(tmp_path, robot, arm, rows, speeds):
    faster = []
    for amplitude in (0.5, 5.0):
        path = moved(tmp_path / "m.csv", amplitude, rows, speeds=speeds)
        motion = followed(motion_in(path), arm)
        found = preflight(motion, robot)
        joints = motion_of(motion)
        rates = np.diff(joints, axis=0, prepend=joints[:1]) * 1000
        share = np.abs(rates / robot_limits(robot).speed(joints, rates)).max(axis=0)[0]
        assert found["joint_velocity_share"][0] == pytest.approx(share, rel=1e-9)
        names = {each["name"] for each in found["findings"]}
        assert ("joint_velocity" in names) == (share >= 1.0)
        faster.append(share >= 1.0)
    assert faster == [False, True]


def motion_in(path):
    (motion,) = motions(path)
    return motion


def motion_of(recording):
    return np.stack([recording[f"controller.qpos_ref[{joint}]"] for joint in range(1, 8)], axis=1)


def test_the_splines_follow_the_motion_between_its_rows(tmp_path):
    """Quintic in time, which cubic pieces of 100 ms follow within 2e-6 of the way."""
    for speeds, near in ((False, 1e-4), (True, 2e-5)):
        motion = motion_in(moved(tmp_path / "m.csv", 1.0, speeds=speeds))
        times, joints = motion.sent()
        assert len(times) == 3001
        assert np.abs(joints[:, 0] - smooth(times)[0]).max() < near
        assert joints[::100] == pytest.approx(motion.joints, abs=1e-12)
        assert np.abs(np.diff(joints, axis=0)[[0, -1]]).max() < 1e-6  # rad: at rest, 1 mrad/s


def test_a_run_and_its_reference_as_a_file_are_refused_the_same(tmp_path):
    recording = run_scenario("pick_and_place", tmp_path / "run").recording
    path = write(tmp_path / "m.csv", recording.time, motion_of(recording))
    arms = [Recording.open(tmp_path / "run"), followed(motion_in(path), "panda")]
    ours, theirs = (preflight(each, "fer") for each in arms)
    for key in ("joint_velocity_share", "joint_acceleration_share", "joint_jerk_share"):
        assert theirs[key] == pytest.approx(ours[key], rel=1e-6)
    assert theirs["lost_packets"] == ours["lost_packets"]


def test_a_motion_beyond_a_joints_range_names_the_row_and_the_joint(tmp_path):
    path = moved(tmp_path / "m.csv", Q_MAX[0] + 0.2, speeds=True)
    found = next(it.text for it in check_motion(path, "fer") if "position_limits" in it.text)
    row = int(np.argmax(motion_in(path).joints[:, 0] > Q_MAX[0])) + 1
    assert found.startswith("fer refuses: joint_motion_generator_position_limits_violation")
    assert f"(row {row})" in found
    assert "joint 1" in found


GOOD = "time," + ",".join(NAMES)
ROW = "0,0,0,-1.5,0,1.5,0"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "columns ''; must be time"),
        ("time,q1\n0,1\n", "columns 'time,q1'; must be time and q1 to q7, and may be qd1 to qd7"),
        (f"{GOOD},qd1\n", "must be time and q1 to q7"),
        (f"{GOOD}\n0,{ROW}\n", "1 rows; must be at least two"),
        (f"{GOOD}\n0,{ROW}\n0,{ROW}\n", "row 2: time: must be after the row above"),
        (f"{GOOD}\n0,{ROW}\n1e9,{ROW}\n", "row 2: time: must be after"),
        (f"{GOOD}\n0,{ROW}\n1,nan{ROW[1:]}\n", "row 2: q1: value 'nan'; must be a finite number"),
        (f"{GOOD}\n0,{ROW}\n1,{ROW},2\n", "line 3: 9 values; must be 8"),
    ],
)
def test_a_file_that_is_no_motion_is_refused_with_its_place(tmp_path, text, said):
    (tmp_path / "m.csv").write_text(text)
    told = refused(motions, tmp_path / "m.csv")
    assert told.startswith(str(tmp_path / "m.csv"))
    assert said in told


@pytest.mark.parametrize(("amplitude", "speeds"), [(0.1, True), (2.0, False)])
def test_a_motion_at_new_times_is_refused_nothing_and_hardly_faster_it_would_be(
    tmp_path, amplitude, speeds
):
    path = moved(tmp_path / "m.csv", amplitude, rows=7, speeds=speeds)
    motion, factor = retimed(path, "fer", 0.9, keep_times=False)
    (tmp_path / "n.csv").write_text(motion_text(motion))
    assert "refused" not in {each.level for each in check_motion(tmp_path / "n.csv", "fer")}
    found = [preflight(followed(each, "panda"), "fer") for each in (motion, motion.stretched(0.95))]
    keys = ("joint_velocity", "joint_acceleration", "joint_jerk", "elbow_jerk", "torque")
    used = [max(max(it[f"{key}_share"]) for key in keys) for it in found]
    assert used[0] < 0.9 <= used[1]
    old = motion_in(path)
    assert np.allclose(motion.times, factor * old.times, rtol=1e-12)
    assert np.array_equal(motion.joints, old.joints)
    assert retimed(path, "fer", 0.9, keep_times=True)[1] == max(factor, 1.0)


def test_a_motion_that_no_time_mends_is_refused_with_what_is_beyond(tmp_path):
    path = moved(tmp_path / "m.csv", Q_MAX[0] + 0.2)
    told = refused(retimed, path, "fer", 0.9, keep_times=False)
    assert "joint_position: is beyond its limit at any speed" in told
