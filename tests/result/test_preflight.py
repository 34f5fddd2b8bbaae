"""What the real robot's interface refuses: names, instants, rows and figures, by numpy alone."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fake_recording import FakeRecording
from fault_support import write_files
from forked import command
from libfranka import FER, FR3, speed
from panda_cosim import Recording, Scenario, TableRow, TrajectoryTable, load_scenario
from panda_cosim.assets.checks import CHECKS
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.controller.model import ArmModel
from panda_cosim.result.judging.advice import refusals
from panda_cosim.result.judging.preflight import preflight
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.view import run
from panda_cosim.study.sweep.row import metrics
from panda_cosim.task.rotations import Array
from random_tasks import run_in_memory

Quantity = tuple[Array, Any, Any]  # values (n, k), largest sizes, and what both are counted from

DT = 1e-3  # [s]
SAME = 1e-5  # relative: third differences lose digits
TORQUE = np.array([87.0] * 4 + [12.0] * 3)
COLLISION = np.array([20.0, 20, 18, 18, 16, 14, 12])
LIMITS: dict[str, dict[str, Any]] = {"fer": FER, "fr3": FR3}
RATES = ("velocity", "acceleration", "jerk")


def differences(values: Array, order: int) -> Array:
    """Backward differences [1/s^order] at each row, of a signal that rests before."""
    rested = np.concatenate((np.repeat(values[:1], order, axis=0), values))
    return np.diff(rested, order, axis=0) / DT**order


def length(vectors: Array) -> Array:
    return np.linalg.norm(vectors, axis=1)[:, None]


def turned(quaternions: Array) -> tuple[Rotation, Array]:
    """Orientations, and where the fingertips then are from the hand's origin (n, 3) [m]."""
    hand = Rotation.from_quat(quaternions, scalar_first=True)
    return hand, hand.apply([0.0, 0.0, 0.1034])


def arm_quantities(run: Any, robot: str) -> Iterator[tuple[str, Quantity]]:
    """What is measured, with its bounds."""
    limits = LIMITS[robot]
    q, qd, force = (run[f"plant.{name}"][:, :7] for name in ("qpos", "qvel", "actuator_force"))
    middle = (limits["low"] + limits["high"]) / 2
    yield "arm_position", (q - middle, limits["high"] - middle, middle)
    yield "arm_velocity", (qd, speed(robot, q, qd), 0.0)
    yield "torque", (force, TORQUE, 0.0)
    model = ArmModel()
    gravity = [model.hand(each, np.zeros(7)).bias.copy() for each in np.vstack((q[:1], q[:-1]))]
    sent = np.where(force.any(axis=1, keepdims=True), force - gravity, 0.0)
    yield "torque_rate", (np.diff(sent, axis=0, prepend=0.0 * q[:1]) / DT, 1000.0, 0.0)
    moved = np.einsum("nij,nj->ni", run["plant.jac"], qd)
    tip = moved[:, :3] + np.cross(moved[:, 3:], turned(run["plant.hand_xquat"])[1])
    yield "hand_velocity", (length(tip), limits["translation"][0], 0.0)
    if "controller.external_torque" in run:
        external = run["controller.external_force"]
        yield "external_torque", (run["controller.external_torque"], COLLISION, 0.0)
        yield "external_force", (external[:, :3], 20.0, 0.0)
        yield "external_moment", (external[:, 3:], 25.0, 0.0)


def hand_quantities(run: Any, robot: str) -> Iterator[tuple[str, Quantity]]:
    """What the commanded pose asks of the hand."""
    limits = LIMITS[robot]
    hand, lever = turned(run["controller.quat_cmd"])
    place = run["controller.pos_cmd"] + lever
    turning = np.concatenate((np.zeros((1, 3)), (hand[1:] * hand[:-1].inv()).as_rotvec())) / DT
    for order, rate in enumerate(RATES):
        moving = length(differences(place, order + 1))
        yield f"translation_{rate}", (moving, limits["translation"][order], 0.0)
        bound = limits["rotation"][order]
        yield f"rotation_{rate}", (length(differences(turning, order)), bound, 0.0)
    away = length(place - run["plant.hand_xpos"] - turned(run["plant.hand_xquat"])[1])
    away[1:] = 0.0
    yield "start_place", (away, limits["translation"][0] * DT, 0.0)


def joint_quantities(run: Any, robot: str) -> Iterator[tuple[str, Quantity]]:
    """What the joint reference, or a law's own targets, ask of the joints."""
    limits = LIMITS[robot]
    name = "controller.qpos_ref" if "controller.qpos_ref" in run else "controller.ctrl"
    q = run[name][:, :7]
    middle = (limits["low"] + limits["high"]) / 2
    rates = dict(zip(RATES, (differences(q, order) for order in (1, 2, 3)), strict=True))
    fastest = speed(robot, q, rates["velocity"])
    yield "joint_position", (q - middle, limits["high"] - middle, middle)
    yield "elbow_position", (q[:, 2:3], limits["high"][2], 0.0)
    for order, (rate, values) in enumerate(rates.items()):
        yield f"joint_{rate}", (values, fastest if order == 0 else limits[rate], 0.0)
        yield f"elbow_{rate}", (values[:, 2:3], limits["elbow"][order], 0.0)
    ends = np.arange(len(q))[:, None] == len(q) - 1
    yield "end_velocity", (ends * rates["velocity"], limits["acceleration"] * DT, 0.0)
    yield "end_acceleration", (ends * rates["acceleration"], limits["jerk"] * DT, 0.0)
    begins = np.arange(len(q))[:, None] == 0
    yield "start_pose", (begins * (q - run["plant.qpos"][:, :7]), limits["velocity"] * DT, 0.0)


def agree(told: Mapping[str, Any], run: Any, row_times: list[float]) -> None:
    """Compare a section of summary.json with what numpy says of the signals."""
    robot, refused = told["robot"], {each["name"]: each for each in told["findings"]}
    expected = dict(arm_quantities(run, robot))
    expected |= hand_quantities(run, robot) if "controller.pos_cmd" in run else {}
    expected |= joint_quantities(run, robot) if told["interface"] == "joint" else {}
    for key, (values, bounds, middle) in expected.items():
        shares = np.abs(values) / bounds
        assert told[f"{key}_share"] == pytest.approx(shares.max(axis=0), rel=SAME, abs=1e-6), key
        above = np.flatnonzero((shares >= 1.0 - 1e-9).any(axis=1))
        assert (key in refused) == bool(len(above)), key
        if len(above):
            first, row, k = refused[key], above[0], int(shares[above[0]].argmax())
            size = np.broadcast_to(bounds, values.shape)[row, k]
            origin, value = np.broadcast_to(middle, values.shape)[row, k], values[row, k]
            assert first["time_s"] == pytest.approx(DT * row), key
            ahead = 1 + sum(time < DT * row - 1e-9 for time in row_times)
            assert first["row"] == min(ahead, len(row_times)), key
            assert first["joint"] == (k + 1 if values.shape[1] > 1 else None), key
            assert first["value"] == pytest.approx(origin + value, rel=SAME), key
            assert first["bound"] == pytest.approx(origin + np.copysign(size, value)), key
            assert first["share"] == pytest.approx(shares.max(), rel=SAME), key
    unseen = {"external_torque", "external_force", "external_moment"}  # without the observer
    assert refused.keys() <= expected.keys() | unseen


# --- scenarios

# Targets of the servos, or torques besides those that hold the arm: each event is a constant for
# some ticks, of the signal or of one of its derivatives.
LAW = """
import numpy as np
class Path:
    def start(self):
        self.path = np.tile({rest}, (2000, 1))
        for joint, order, at, ticks, size in {events}:
            values = np.zeros(2000)
            values[at:at + ticks] = size
            for _ in range(order):
                values = np.cumsum(values) * 0.001
            self.path[:, joint - 1] += values
    def update(self, time, pos_cmd, quat_cmd, qfrc_bias):
        return np.append(self.path[round(time / 0.001)] + {held} * qfrc_bias, 255.0)
"""
Event = tuple[int, int, int, int, float]  # joint, order of the derivative, tick, ticks, size
Pose = tuple[float, float, float]  # time [s], x [m] from home, turn about the vertical [rad]


def make(folder: Path, settings: str, poses: list[Pose], events: list[Event] | None = None) -> Path:
    """Write a scenario, with our law or, of events, its own."""
    folder.mkdir()
    text = "time,frame,x,y,z,qw,qx,qy,qz,grip\n"
    for time, x, angle in poses:
        text += f"{time},home,{x},0,0,0,{np.cos(angle / 2)},{np.sin(angle / 2)},0,0.08\n"
    (folder / "trajectory.csv").write_text(text)
    if events is not None:
        held = "motors" in settings
        rest = [0.0] * 7 if held else [*HOME_Q]
        (folder / "law.py").write_text(LAW.format(rest=rest, events=events, held=float(held)))
        settings += '[fmus]\ncontroller = "law.py:Path"\n'
    (folder / "scenario.toml").write_text(settings)
    return folder


def resting(*times: float, x: float = 0.0) -> list[Pose]:
    return [(time, x, 0.0) for time in times]


JOINT, HAND = "joint_motion_generator_", "cartesian_motion_generator_"
START = "position_motion_generator_start_pose_invalid"
SPEED = "velocity_limits_violation"
STEP, JUMP = "velocity_discontinuity", "acceleration_discontinuity"
# Settings, poses and events of a scenario, and of each refusal that it is made for: error,
# interface, row of the table, joint, and first instant [s] where the scenario tells it.
SCENARIOS: dict[str, tuple[str, list[Pose], list[Event] | None, dict[str, Any]]] = {
    "angles": (
        'duration = 0.3\npreflight = "fer"\n',
        resting(0.0, 0.03, 0.05, 0.07, 0.09, 0.11, 0.13, 0.15, 0.17, 0.3, x=0.002),
        [(2, 0, 0, 2000, 0.003), (4, 3, 40, 1, 6300.0), (4, 3, 41, 1, -6300.0),
         (3, 3, 60, 1, 5010.0), (3, 3, 61, 1, -5010.0),
         (4, 2, 80, 2, -12.6), (3, 2, 100, 2, 10.1), (5, 1, 120, 5, 2.62), (3, 1, 140, 5, 2.2),
         (4, 0, 160, 5, 1.6), (3, 0, 180, 5, 2.95), (1, 2, 290, 99, 16.0)],
        {
            "start_pose": (f"joint_{START}", "joint", 1, 2, 0.0),
            "start_place": (f"cartesian_{START}", "cartesian", 1, None, 0.0),
            "joint_jerk": (JOINT + JUMP, "joint", 3, 4, 0.04),
            "elbow_jerk": (HAND + JUMP, "cartesian", 4, None, 0.06),
            "joint_acceleration": (JOINT + STEP, "joint", 5, 4, 0.08),
            "elbow_acceleration": (HAND + STEP, "cartesian", 6, None, 0.1),
            "joint_velocity": (JOINT + SPEED, "joint", 7, 5, 0.12),
            "elbow_velocity": (HAND + SPEED, "cartesian", 8, None, 0.14),
            "joint_position": (JOINT + "position_limits_violation", "joint", 9, 4, 0.16),
            "elbow_position": (HAND + "elbow_limit_violation", "cartesian", 10, None, 0.18),
            "end_velocity": (JOINT + STEP, "joint", 10, 1, 0.3),
            "end_acceleration": (JOINT + JUMP, "joint", 10, 1, 0.3),
        },
    ),
    "torques": (
        'duration = 1.2\nscene = "motors"\npreflight = "fer"\n',
        resting(0.0, 0.03, 0.05, 0.07, 1.2),
        [(6, 0, 40, 1, 1.1), (5, 0, 60, 1, 13.0), (5, 0, 61, 1, -11.0), (7, 0, 100, 2000, 2.0),
         (1, 0, 100, 2000, 50.0)],
        {
            "torque_rate": ("controller_torque_discontinuity", "torque", 3, 6, 0.041),
            "torque": ("tau_j_range_violation", "arm", 4, 5, 0.061),
            "arm_velocity": ("joint_velocity_violation", "arm", 5, None, None),
            "hand_velocity": ("cartesian_velocity_violation", "arm", 5, None, None),
            "arm_position": ("joint_position_limits_violation", "arm", 5, None, None),
        },
    ),
    "poses": (
        'duration = 0.4\npreflight = "fer"\n',
        [*resting(0.0, 0.1), (0.15, 0.1, 0.0), (0.2, 0.1, 0.0), (0.25, 0.1, 0.2)],
        None,
        {
            "translation_jerk": (HAND + JUMP, "cartesian", 3, None, 0.101),
            "translation_acceleration": (HAND + STEP, "cartesian", 3, None, 0.102),
            "translation_velocity": (HAND + SPEED, "cartesian", 3, None, None),
            "rotation_jerk": (HAND + JUMP, "cartesian", 5, None, 0.201),
            "rotation_acceleration": (HAND + STEP, "cartesian", 5, None, None),
            "rotation_velocity": (HAND + SPEED, "cartesian", 5, None, None),
        },
    ),
    "pushes": (
        'duration = 0.4\npreflight = "fer"\n[controller]\nobserver = true\n'
        '[[push]]\nstart = 0.1\nduration = 0.1\nforce = [0.0, 0.0, 30.0]\n'
        '[[push]]\nstart = 0.3\nduration = 0.1\nforce = [0.0, 300.0, 0.0]\non = "link5"\n',
        resting(0.0, 0.1, 0.2, 0.3, 0.4),
        None,
        {
            "external_force": ("cartesian_reflex", "arm", 3, 3, None),
            "external_torque": ("joint_reflex", "arm", 5, None, None),
            "external_moment": ("cartesian_reflex", "arm", 5, None, None),
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENARIOS)
def test_each_refusal_has_libfrankas_name_its_instant_row_value_and_bound(name, tmp_path):
    settings, poses, events, refusals = SCENARIOS[name]
    done = run_in_memory(load_scenario(make(tmp_path / name, settings, poses, events)))
    findings = {each["name"]: each for each in done.summary.preflight["findings"]}
    for key, (error, interface, row, joint, at) in refusals.items():
        told = findings[key]
        assert (told["error"], told["interface"], told["row"]) == (error, interface, row), key
        assert joint in (told["joint"], None), key
        assert told["time_s"] == pytest.approx(told["time_s"] if at is None else at), key
    told = done.summary.preflight
    agree(told, done.signals, [time for time, _, _ in poses])
    assert told["interface"] == ("torque" if name == "torques" else "joint")
    for key in ("joint_refusals", "joint_jerk_share", "lost_packets"):
        assert (told[key] is None) == (name == "torques"), key
    assert told["refusals"] == told[f"{told['interface']}_refusals"] + told["arm_refusals"]


def test_each_condition_has_a_scenario_that_does_not_keep_it():
    assert {key for *_, refusals in SCENARIOS.values() for key in refusals} == {*CHECKS}


# --- runs


@pytest.fixture(scope="module")
def fast(tmp_path_factory):
    """The Panda's fast cycle, as FR3 sees it; its observer is on, and no refusal allowed."""
    out = tmp_path_factory.mktemp("fast") / "run"
    values = ("preflight=fr3", "controller.observer=true", "success.max_refusals=0")
    options = ("--no-video", "--no-view", "--out", out, *(f"--set={value}" for value in values))
    command("run", "pick_and_place_fast", *options, code=3)
    return json.loads((out / "summary.json").read_text()), Recording.open(out)


def test_the_pandas_fast_cycle_asks_too_much_acceleration_of_fr3(fast):
    told = fast[0]["preflight"]
    agree(told, fast[1], fast[1].metadata["row_times"])
    assert told["refusals"] == 1
    assert max(told["joint_acceleration_share"]) == pytest.approx(1.59, abs=0.005)
    assert max(told["joint_velocity_share"]) < 1.0
    first = next(each for each in told["findings"] if each["interface"] == "joint")
    assert first["error"] == "joint_motion_generator_velocity_discontinuity"
    criterion = next(each for each in fast[0]["criteria"] if each["name"] == "max_refusals")
    assert (criterion["value"], criterion["ok"]) == (1, False)


def refused_after(q: Array, at: int, count: int) -> int | None:
    """The first row (of 3) at which what the robot receives is refused, if `count` are lost.

    The packets before row `at` are lost; the robot goes on with its last acceleration.
    """
    sent = np.concatenate((np.repeat(q[:1], 30, axis=0), q))
    got = list(sent[: at + 30 - count])
    for _ in range(count):
        got.append(got[-1] + (got[-1] - got[-2]) + (got[-1] - 2 * got[-2] + got[-3]))
    got += list(sent[at + 30 : at + 33])
    acceleration, jerk = (np.diff(got, order, axis=0)[-len(sent[at + 30 : at + 33]) :] / DT**order
                          for order in (2, 3))  # fmt: skip
    refused = (np.abs(acceleration) >= FER["acceleration"]) | (np.abs(jerk) >= FER["jerk"])
    rows = np.flatnonzero(refused.any(axis=1))
    return at + int(rows[0]) if len(rows) else None


def test_packets_may_be_lost_up_to_a_number_that_tick_by_tick_extrapolation_gives(tmp_path):
    events = [(6, 3, 50, 40, 100.0), (6, 3, 90, 80, -100.0), (6, 3, 170, 40, 100.0)]
    settings = 'duration = 0.25\npreflight = "fer"\n'
    folder = make(tmp_path / "s", settings, resting(0.0, 0.25), events)
    done = run_in_memory(load_scenario(folder))
    told, q = done.summary.preflight, done.signals["controller.ctrl"][:, :7]
    borne = told["lost_packets"]
    assert 1 <= borne < 19
    rows = range(len(q))
    assert {refused_after(q, at, n) for n in range(1, borne + 1) for at in rows} == {None}
    first = min(row for at in rows if (row := refused_after(q, at, borne + 1)) is not None)
    assert told["late"]["lost_packets"]["time_s"] == pytest.approx(DT * first)
    assert told["late"]["lost_packets"]["joint"] == 6


@pytest.fixture(scope="module")
def rested(tmp_path_factory):
    """Signals of an arm whose servos hold it, by a law of its own."""
    folder = tmp_path_factory.mktemp("rested") / "still"
    made = make(folder, "duration = 0.1\n", resting(0, 0.1), [])
    return run_in_memory(load_scenario(made)).signals


def recorded(signals: dict[str, Array], **metadata: Any) -> FakeRecording:
    return FakeRecording(DT * np.arange(len(signals["plant.jac"])), {**signals}, metadata)


def test_who_stays_at_home_asks_nothing_of_the_robot():
    """The first command is where the hand is, so that no correction opens each run."""
    rows = tuple(TableRow(t, "home", (0.0, 0.0, 0.0), 0.08) for t in (0.0, 1.0))
    done = run_in_memory(Scenario("home", TrajectoryTable(rows), 0.1, preflight="fer"))
    assert max(done.summary.preflight["joint_jerk_share"]) < 1e-6
    assert (done.summary.preflight["lost_packets"], done.summary.preflight["late"]) == (19, {})
    assert max(done.summary.limits["torque_rate_share"]) < 0.01


def test_a_long_recording_is_judged_in_blocks_as_a_whole(fast):
    """A recording in pieces gives the same, wherever they end."""
    run = fast[1]

    class InPieces(FakeRecording):
        def in_blocks(self, *names: str, before: int = 0) -> Any:
            del before
            for rows in np.array_split(np.arange(run.rows), 97):
                yield [run[name][rows] for name in names]

        def __contains__(self, name: str) -> bool:
            return name in run

        def __getitem__(self, name: str) -> Any:
            return run[name]

    whole, pieces = (preflight(each, "fr3") for each in (run, InPieces(run.time, {}, run.metadata)))
    assert pieces.keys() == whole.keys()
    for key, value in whole.items():
        if key.endswith("_share"):
            assert pieces[key] == pytest.approx(value, rel=1e-12), key
        elif key not in ("findings", "late"):
            assert pieces[key] == value, key
    for told, again in zip(whole["findings"], pieces["findings"], strict=True):
        assert again == told | {name: pytest.approx(told[name]) for name in ("value", "share")}


@pytest.mark.parametrize("signal", ["controller.ctrl", "plant.jac"])
def test_what_is_not_recorded_is_not_called_accepted(signal, rested):
    run = recorded(rested)
    judged = preflight(run, "fer")
    assert judged["refusals"] == 0
    told = [[level for level, _ in refusals(judged, complete=whole)] for whole in (True, False)]
    assert ["good" in levels for levels in told] == [True, False]
    del run.signals[signal]
    told = preflight(run, "fer")
    assert told["refusals"] is None
    assert "good" not in [level for level, _ in refusals(told, complete=True)]


def test_of_no_rows_nothing_is_said_and_an_impedance_law_is_judged_by_its_torques(rested):
    run = recorded(rested, parameters={"controller": {"impedance": True}})
    assert preflight(run, "fer")["interface"] == "torque"
    empty = {name: signal[:0] for name, signal in rested.items()}
    assert preflight(recorded(empty), "fer") == {}


@pytest.mark.parametrize("rows", [1, 101])
def test_the_first_row_of_jacobi_coupling_has_no_command_yet(rows, rested):
    first = {name: signal[:rows].copy() for name, signal in rested.items()}
    late = recorded(first, coupling="jacobi")
    assert preflight(late, "fer")["joint_refusals"] == 0
    late.signals["controller.ctrl"][0] = 0.0
    assert bool(preflight(late, "fer")["joint_refusals"]) == (rows == 1)


# --- what a user sees


def test_view_and_sweeps_have_what_the_summary_has(fast):
    told = fast[0]["preflight"]
    lines = run.refusals_of(Summary.read(fast[0]))
    assert [line.split()[2] for line in lines] == [
        each["error"] for each in told["findings"] if each["interface"] in ("joint", "arm")
    ][: told["refusals"]]
    bars = {bar["name"]: bar["shares"] for bar in run.limits_of(Summary.read(fast[0]))}
    assert bars["fr3: joint jerk"] == told["joint_jerk_share"]
    assert "fr3: torque rate" not in bars  # of another interface
    assert run.refusals_of(Summary(preflight={"robot": 1})) == run.refusals_of(Summary()) == []
    columns = dict(metrics(Summary(preflight=told)))
    assert columns["summary.preflight.refusals"] == 1.0
    assert columns["summary.preflight.joint_jerk_share[7]"] == told["joint_jerk_share"][6]
    assert columns["summary.preflight.lost_packets"] == told["lost_packets"]


def test_check_says_what_the_robot_refuses_and_exits_3():
    done = command("check", "scenarios/slow_controller", "--robot", "fer", code=3)
    assert "joint_motion_generator_velocity_discontinuity at t = 0." in done.stdout
    assert "(row 2)" in done.stdout
    assert "controller.period = 0.001" in done.stdout  # more time would not help


@pytest.mark.parametrize(
    ("name", "robot"), [("pick_and_place", "fer"), ("pick_and_place_fast_fr3", "fr3")]
)
def test_a_robot_accepts_its_own_cycle(name, robot):
    done = command("check", f"scenarios/{name}", "--robot", robot, code=0)
    assert f"{robot} refuses nothing over the joint interface" in done.stdout
    assert ("recommends" in done.stdout) == (robot == "fer")  # the other ends at rest


def test_what_retime_writes_for_a_robot_is_accepted_by_it(tmp_path):
    fast, new, fr3 = tmp_path / "fast", tmp_path / "new", ("--robot", "fr3")
    rows = ("0,home,0,0,0,0.08", "0.6,home,0.1,0.2,-0.1,0.08")
    write_files(fast, "duration = 1.5\n", *rows)
    assert command("check", fast, *fr3).returncode == 3
    command("retime", fast, "--keep-times", *fr3, "--out", new, code=0)
    assert load_scenario(new).robot == "fr3"
    assert command("check", new, *fr3).returncode == 0


def test_what_is_not_run_is_not_called_accepted(tmp_path):
    folder = make(tmp_path / "own", "duration = 0.1\n", resting(0, 0.1), [])
    assert command("check", folder).returncode == 0
    done = command("check", folder, "--robot", "fer", code=2)
    assert f"panda-cosim run {folder} --set preflight=fer" in done.stdout
