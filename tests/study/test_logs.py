"""Logs of robots and other programs: compared with runs, and checked as motions."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fault_support import write_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.cli.commands.render import export
from panda_cosim.fmus.errors import InputError
from panda_cosim.result.recording import Recording
from panda_cosim.result.recording.logs import is_log, open_log
from panda_cosim.run.execution import run_scenario
from panda_cosim.study.check.motion import motions
from panda_cosim.study.compare.between_runs import compare
from refusals import refused

JOINTS = range(1, 8)
TRAJECTORY = """string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points
===
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
builtin_interfaces/Duration time_from_start
===
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return run_scenario(write_scenario(folder / "short", 0.2), folder / "run")


def libfranka_log(run, path, begin=12_345):
    """Joints as libfranka's log has them: milliseconds of the robot's clock, indices from 0."""
    names = [f"state.{word}[{joint - 1}]" for word in ("q", "dq") for joint in JOINTS]
    joints = [run.recording[f"plant.{word}[{j}]"] for word in ("qpos", "qvel") for j in JOINTS]
    rows = np.column_stack([begin + 1e3 * run.recording.time, *joints])
    head = ",".join(("time", *names))
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.17g")
    columns = {f'"plant.{own}[{j}]" = ["state.{word}[{j - 1}]"]'
               for own, word in (("qpos", "q"), ("qvel", "dq")) for j in JOINTS}  # fmt: skip
    lines = ["seconds = 0.001", "start = 0", "[names]", *sorted(columns)]
    path.with_suffix(".toml").write_text("\n".join(lines))
    return path.with_suffix(".toml")


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_what_a_run_exports_is_the_run(run, tmp_path, suffix):
    if suffix == ".mcap":
        pytest.importorskip("mcap_ros2")
        pytest.importorskip("foxglove")
    log = tmp_path / f"x{suffix}"
    export(run.folder, log, rate=1000.0, overwrite=False)
    found = compare(run, log)
    assert is_log(log)
    assert not is_log(run.folder / "recording.parquet")
    assert found.signals == ()
    assert found.rows == run.recording.rows
    numbers = [name for name in run.recording.columns if name != "time"]
    assert found.columns == len(numbers)
    assert (found.parameters, found.metrics) == ((), ())


def test_a_difference_in_a_log_is_found_where_it_is(run, tmp_path):
    names = libfranka_log(run, tmp_path / "robot.csv")
    assert compare(run, tmp_path / "robot.csv", names=names).signals == ()
    shifted = Recording.open(run.folder)
    joints = {name: shifted[name].copy() for name in ("plant.qpos[2]", "plant.qpos[3]")}
    joints["plant.qpos[3]"][40] += 0.25
    table = pa.table({"time": shifted.time, **joints})
    pq.write_table(table, tmp_path / "robot.parquet")
    (row,) = compare(run, tmp_path / "robot.parquet").signals
    assert (row.name, row.unit) == ("plant.qpos[3]", "rad")
    assert row.largest[0] == pytest.approx(0.25)
    assert row.times[0] == pytest.approx(0.040)


def test_a_signal_takes_a_list_of_columns_and_what_it_lacks_is_refused(run, tmp_path):
    libfranka_log(run, tmp_path / "robot.csv")
    columns = json.dumps([f"state.q[{joint}]" for joint in range(7)])
    for text, said in (
        (f'[names]\n"plant.qpos" = {columns}', "[names] plant.qpos: 7 columns; must be 16"),
        ('[names]\n"plant.qpos[1]" = ["q[0]"]', "column: value 'q[0]'; must be one of its col"),
        ('[names]\n"plant.qpo[1]" = ["state.q[0]"]', "no signal 'plant.qpo[1]'"),
        ('[names]\n"plant.qpos[1]" = "state.q[0]"', "must be a list of texts"),
        ("second = 0.001", "key 'second' is unknown; valid: time, seconds, start, names"),
    ):
        (tmp_path / "names.toml").write_text(text)
        places = tmp_path / "robot.csv", tmp_path / "names.toml"
        assert said in refused(open_log, *places, run.recording)


def test_times_must_increase_and_cells_that_are_used_must_be_numbers(run, tmp_path):
    for rows, said in (
        ("0,1\n0,1\n", "time: value 0.0 in row 2; must increase"),
        ("0,1\n1,x\n", "row 2: plant.qpos[1]: value 'x'; must be a finite"),
    ):
        (tmp_path / "log.csv").write_text(f"time,plant.qpos[1]\n{rows}")
        told = refused(open_log, tmp_path / "log.csv", None, run.recording)
        assert told.startswith(str(tmp_path / "log.csv"))
        assert said in told
    (tmp_path / "names.toml").write_text("start = 0")
    (tmp_path / "log.csv").write_text("time,plant.qpos[1]\n")
    with pytest.raises(InputError, match="nothing to compare: one of them has no rows"):
        compare(run, tmp_path / "log.csv", names=tmp_path / "names.toml")
    (tmp_path / "log.csv").write_text("time,word,plant.qpos[1]\n0,a,1\n1,b,1\n")
    assert open_log(tmp_path / "log.csv", None, run.recording).columns == ("time", "plant.qpos[1]")


def test_a_bag_with_joint_trajectories_is_checked_as_a_table_is(tmp_path):
    writer = pytest.importorskip("mcap_ros2.writer")
    times = np.array([0.0, 0.25, 1.5])
    rows = np.column_stack([times, HOME_Q + np.outer(0.1 * times, np.eye(7)[0])])
    order = [3, 1, 0, 2, 6, 5, 4]  # of names, which say what is what
    points = [
        {"positions": row[1:][order].tolist(), "velocities": [],
         "time_from_start": {"sec": int(row[0]), "nanosec": int(row[0] % 1 * 1e9)}}
        for row in rows
    ]  # fmt: skip
    names = [f"fer_joint{joint + 1}" for joint in order]
    with (tmp_path / "bag.mcap").open("wb") as file:
        bag = writer.Writer(file)
        schema = bag.register_msgdef("trajectory_msgs/msg/JointTrajectory", TRAJECTORY)
        content = {"joint_names": names, "points": points}
        bag.write_message("/arm/trajectory", schema, content, log_time=10**18)
        bag.finish()
    (motion,) = motions(tmp_path / "bag.mcap")
    assert np.array_equal(np.column_stack([motion.times, motion.joints]), rows)
    assert not motion.speeds.size


def test_a_bag_without_a_trajectory_and_a_broken_one_are_refused(run, tmp_path):
    pytest.importorskip("mcap_ros2")
    pytest.importorskip("foxglove")
    export(run.folder, tmp_path / "x.mcap", rate=10.0, overwrite=False)
    with pytest.raises(InputError, match="no message in it is a JointTrajectory"):
        motions(tmp_path / "x.mcap")
    content = (tmp_path / "x.mcap").read_bytes()
    (tmp_path / "y.mcap").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"y\.mcap: is no whole MCAP file"):
        motions(tmp_path / "y.mcap")
