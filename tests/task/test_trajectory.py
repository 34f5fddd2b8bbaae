"""The commands follow the table, and their velocities are the derivatives of their poses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panda_cosim import InputError, TableRow, Trajectory, TrajectoryTable, load_scenario
from panda_cosim.run import inputs
from panda_cosim.run.prepare import prepare
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.task import rotations
from panda_cosim.task.rotations import Array
from panda_cosim.task.trajectory import COMMANDS, StartPose
from panda_cosim.task.writer import write_input_csv

DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)
HOME = (0.554499478, 0.0, 0.624502429)  # m
TARGET = (0.4, -0.2, 0.1)  # m
START = StartPose(HOME, DOWN, TARGET)

POSITION_TOLERANCE = 1e-12  # m: rounding only
UNIT_TOLERANCE = 1e-12  # of a quaternion's length
RATE_TOLERANCE = 1e-5  # m/s and rad/s: what a difference over 2 us leaves of the third derivative
STEP = 1e-6  # s, of that difference

POSITION, QUATERNION, VELOCITY, OMEGA = map(slice, (0, 3, 7, 10), (3, 7, 10, 13))
GRIP = 13

number = st.floats(-1.0, 1.0)
offsets = st.tuples(number, number, number)
quaternions = st.tuples(number, number, number, number).filter(lambda q: np.linalg.norm(q) > 0.1)


@st.composite
def trajectories(
    draw: st.DrawFn, kinds: tuple[str, ...] = ("linear", "quintic", "spline")
) -> Trajectory:
    """Draw a trajectory of 2 to 6 rows, 0.2 to 2 s apart."""
    gaps = draw(st.lists(st.floats(0.2, 2.0), min_size=1, max_size=5))
    n = len(gaps) + 1
    q = np.array(draw(st.lists(quaternions, min_size=n, max_size=n)))
    return Trajectory(
        times=np.concatenate([[0.0], np.cumsum(gaps)]) + draw(st.floats(0.0, 1.0)),
        positions=np.array(draw(st.lists(offsets, min_size=n, max_size=n))),
        orientations=q / np.linalg.norm(q, axis=1, keepdims=True),
        grips=np.array(draw(st.lists(st.floats(0.0, 0.08), min_size=n, max_size=n))),
        interpolation=draw(st.sampled_from(kinds)),
    )


def inner_times(trajectory: Trajectory) -> Array:
    """Return times inside the segments, away from the rows, where derivatives may jump."""
    shares = np.linspace(0.01, 0.99, 23)
    starts, lengths = trajectory.times[:-1, None], np.diff(trajectory.times)[:, None]
    return (starts + shares * lengths).ravel()


def angle_between(a: Array, b: Array) -> Array:
    """Return the angle of the rotation from a to b [rad]."""
    return np.linalg.norm(rotations.log(rotations.multiply(b, rotations.conjugate(a))), axis=-1)


@given(trajectories())
def test_each_row_is_reached_at_its_time_and_outside_the_hand_stays(trajectory):
    commands = trajectory.sample(trajectory.times)
    np.testing.assert_allclose(commands[:, POSITION], trajectory.positions, atol=1e-12)
    assert angle_between(commands[:, QUATERNION], trajectory.orientations).max() < 1e-12
    assert np.array_equal(commands[:, GRIP], trajectory.grips)
    first, last = trajectory.times[0], trajectory.times[-1]
    before, after = trajectory.sample([first - 1.0, -1e9]), trajectory.sample([last + 1.0, 1e9])
    for commands, row in ((before, 0), (after, -1)):
        assert np.allclose(commands[:, POSITION], trajectory.positions[row], atol=1e-12)
        assert np.allclose(commands[:, QUATERNION], trajectory.orientations[row], atol=1e-12)
        assert (commands[:, 7:13] == 0.0).all()
        assert (commands[:, GRIP] == trajectory.grips[row]).all()


@given(trajectories(("quintic", "spline")))
def test_velocities_are_the_difference_quotients_of_the_poses(trajectory):
    times = inner_times(trajectory)
    ahead, now, behind = (trajectory.sample(times + shift) for shift in (STEP, 0.0, -STEP))
    moved = (ahead - behind)[:, POSITION]
    turn = rotations.multiply(ahead[:, QUATERNION], rotations.conjugate(behind[:, QUATERNION]))
    rates = np.hstack((moved, rotations.log(turn))) / (2.0 * STEP)
    assert np.abs(rates - now[:, 7:13]).max() < RATE_TOLERANCE
    ahead, behind = (trajectory.sample(trajectory.times + shift) for shift in (STEP, -STEP))
    assert np.abs(ahead - behind)[:, 7:13].max() < 1e-2  # no jump, in 2 us


@given(trajectories(("linear", "quintic")))
def test_the_hand_stays_on_the_segment_and_never_turns_back(trajectory):
    """Its quaternions keep length one, and their sign."""
    q = trajectory.sample(np.linspace(-0.5, trajectory.times[-1] + 0.5, 2000))[:, QUATERNION]
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < UNIT_TOLERANCE
    assert (np.einsum("ij,ij->i", q[1:], q[:-1]) > 0.99).all()
    for k in range(len(trajectory.times) - 1):
        times = np.linspace(trajectory.times[k], trajectory.times[k + 1], 101)
        commands = trajectory.sample(times)
        way = trajectory.positions[k + 1] - trajectory.positions[k]
        gone = commands[:, POSITION] - trajectory.positions[k]
        along = gone @ way
        assert (np.diff(along) >= -POSITION_TOLERANCE).all()
        assert along.max() <= way @ way + POSITION_TOLERANCE
        assert np.abs(np.cross(gone, way)).max() < POSITION_TOLERANCE
        whole = angle_between(trajectory.orientations[k], trajectory.orientations[k + 1])
        turned = angle_between(trajectory.orientations[k], commands[:, QUATERNION])
        assert whole <= np.pi + 1e-9  # the shortest way
        assert (np.diff(turned) >= -1e-7).all()
        assert turned.max() <= whole + 1e-7


@given(trajectories(), st.integers(0, 4000))
def test_the_grip_holds_from_its_row_on(trajectory, millis):
    time = millis * 1e-3
    passed = [k for k, row_time in enumerate(trajectory.times) if row_time <= time + 1e-9]
    expected = trajectory.grips[passed[-1] if passed else 0]
    assert trajectory.sample([time])[0, GRIP] == expected


def test_a_tick_that_rounding_puts_before_its_row_belongs_to_the_row():
    row_time = 0.3
    tick = np.nextafter(row_time, 0.0)
    times, grips = np.array([0.0, row_time, 2.0]), np.array([0.08, 0.0, 0.0])
    trajectory = Trajectory(times, np.eye(3), np.array([DOWN] * 3), grips)
    before, at = trajectory.sample([tick - 1e-6, tick])
    assert before[GRIP] == 0.08
    assert at[GRIP] == 0.0
    assert np.array_equal(at[POSITION], trajectory.positions[1])


yaws = st.floats(-0.78, 0.78)  # rad; the block is square, so more turns are the same


@given(st.lists(st.tuples(offsets, st.none() | quaternions), min_size=2, max_size=4), yaws)
def test_aligned_rows_are_the_same_seen_from_the_block(rows, yaw):
    table = TrajectoryTable(
        tuple(TableRow(float(k), "target", p, 0.0, q) for k, (p, q) in enumerate(rows))
    )
    turned = StartPose(HOME, DOWN, TARGET, yaw)
    times = np.linspace(0.0, float(len(rows)), 50)
    for kind in ("linear", "quintic"):
        plain = Trajectory.from_table(table, START, interpolation=kind, align=True).sample(times)
        other = Trajectory.from_table(table, turned, interpolation=kind, align=True).sample(times)
        c, s = np.cos(yaw), np.sin(yaw)
        to_block = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        seen = (other[:, POSITION] - TARGET) @ to_block.T + TARGET
        assert np.allclose(seen, plain[:, POSITION], rtol=0, atol=1e-12)
        assert np.allclose(other[:, VELOCITY] @ to_block.T, plain[:, VELOCITY], rtol=0, atol=1e-12)
        assert np.allclose(np.abs(other[:, OMEGA] @ to_block.T), np.abs(plain[:, OMEGA]), atol=1e-9)
        back = rotations.multiply(rotations.about_z(-yaw), other[:, QUATERNION])
        # A half turn may be made either way; then only the rows are the same.
        whole = np.isclose(times % 1.0, 0.0)
        assert angle_between(back[whole], plain[whole, QUATERNION]).max() < 1e-7


@given(yaws)
def test_alignment_leaves_world_and_home_rows_alone(yaw):
    places = {"home": (0.1, 0.2, 0.3), "target": (0.1, 0.0, 0.05), "world": (0.6, 0.35, 0.4)}
    rows = (TableRow(float(k), name, at, 0.0) for k, (name, at) in enumerate(places.items()))
    table = TrajectoryTable(tuple(rows))
    turned = StartPose(HOME, DOWN, TARGET, yaw)
    aligned = Trajectory.from_table(table, turned, align=True)
    plain = Trajectory.from_table(table, turned, align=False)
    for row in (0, 2):
        assert np.array_equal(aligned.positions[row], plain.positions[row])
        assert angle_between(aligned.orientations[row], plain.orientations[row]) < 1e-12
    assert np.allclose(plain.positions[1], np.add(TARGET, (0.1, 0.0, 0.05)))
    expected = np.add(TARGET, (0.1 * np.cos(yaw), 0.1 * np.sin(yaw), 0.05))
    assert np.allclose(aligned.positions[1], expected, rtol=0, atol=1e-12)


def test_fmpy_reads_the_input_file_bit_for_bit(tmp_path):
    from fmpy.util import read_csv  # noqa: PLC0415  # heavy

    times = np.arange(501) * 0.001 + 1.0
    table = load_scenario("pick_and_place").table
    commands = Trajectory.from_table(table, START, align=True).sample(times)
    write_input_csv(tmp_path / "in.csv", times, commands)
    read = read_csv(tmp_path / "in.csv")
    assert read.dtype.names == ("time", *COMMANDS)
    assert np.array_equal(read["time"], times)
    assert all(np.array_equal(read[name], commands[:, k]) for k, name in enumerate(COMMANDS))
    with pytest.raises(InputError, match="already exists"):
        write_input_csv(tmp_path / "in.csv", times, commands)


# What is given from outside is the same, made at once or a part at a time.


INPUTS = prepare(load_scenario("pick_and_place")).inputs()


@pytest.mark.parametrize("name", ["tutorial", "push", "fast_circle"])
@pytest.mark.parametrize("part", [100, 16_384])
def test_parts_hold_what_the_whole_does(name, part, monkeypatch):
    monkeypatch.setattr(inputs, "CHUNK", part)
    scenario = load_scenario(name)
    values = start_values(scenario)
    whole = resolve(scenario, values).sample(instants(scenario))
    made = prepare(scenario).inputs()
    rows = np.concatenate([made[k : k + 257][:256] for k in range(0, scenario.ticks + 1, 256)])
    assert rows.shape == made.shape
    np.testing.assert_allclose(rows[:, -14:], whole, rtol=0, atol=1e-15)
    assert bool(scenario.push) == (made.shape[1] == 17)


@given(st.integers(0, 7000), st.integers(0, 7000))
def test_a_slice_is_cut_off_as_that_of_an_array(start, stop):
    assert len(INPUTS[start:stop]) == len(range(INPUTS.shape[0])[start:stop])


@pytest.mark.parametrize("body", ["hand", "block"])
def test_a_push_begins_and_ends_with_its_ticks(body):
    scenario = load_scenario("push")
    scenario = replace(scenario, push=tuple(replace(p, on=body) for p in scenario.push))
    made = prepare(scenario).inputs()
    forces, times = made[0 : made.shape[0]][:, :3], instants(scenario)
    pushed = np.zeros(len(times), dtype=bool)
    for push in scenario.push:
        pushed |= (times > push.start - 5e-4) & (times < push.start + push.duration - 5e-4)
    assert pushed.any()
    np.testing.assert_array_equal(np.abs(forces).sum(axis=1) > 0, pushed)
