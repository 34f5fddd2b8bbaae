"""What the real robot's interface refuses: names, instants, rows and figures, by numpy alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_recording import FakeRecording
from forked import command
from numpy.typing import NDArray
from panda_cosim import Recording
from panda_cosim.assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT
from panda_cosim.controller.model import ArmModel
from panda_cosim.scenarios.judging.preflight import preflight
from panda_cosim.scenarios.judging.refusals import outcome
from panda_cosim.scenarios.sweep.row import metrics
from panda_cosim.scenarios.view import story
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

DT = 1e-3  # [s]
SAME = 1e-6  # relative: third differences lose digits
ROWS, AT = 240, 120  # of a recording at rest, and the row at which something happens
ROW_TIMES = [0.0, 0.1, 0.2, 0.239]
HOME = np.array(HOME_Q)
# From Franka's documents, once more.
FER = {
    "velocity": np.array([2.175] * 4 + [2.61] * 3),
    "acceleration": np.array([15, 7.5, 10, 12.5, 15, 20, 20]),
    "jerk": np.array([7500.0, 3750, 5000, 6250, 7500, 10000, 10000]),
}
FR3 = {"acceleration": np.full(7, 10.0), "jerk": np.full(7, 5000.0)}


def fr3_speed(q: Array, qd: Array) -> Array:
    """Largest speed at a position (n, 7), as libfranka's rate_limiting.h has it, joint by joint."""
    speed = np.empty_like(q)
    numbers = [
        (2.62, 0.30, 12.0, -2.7501, 2.7501), (2.62, 0.20, 5.17, -1.7918, 1.7918),
        (2.62, 0.20, 7.0, -2.9065, 2.9065), (2.62, 0.30, 8.0, -3.0481, -0.1458),
        (5.26, 0.35, 34.0, -2.8101, 2.8101), (4.18, 0.35, 11.0, 0.54092, 4.5205),
        (5.26, 0.35, 34.0, -3.0196, 3.0196),
    ]  # fmt: skip
    for joint, (most, offset, slope, low, high) in enumerate(numbers):
        for row in range(len(q)):
            room = high - q[row, joint] if qd[row, joint] >= 0 else q[row, joint] - low
            at_end = max(0.0, -offset + max(0.0, slope * room) ** 0.5)
            speed[row, joint] = min(most, at_end)
    return speed


def at_rest() -> FakeRecording:
    """A robot that stands still at home."""
    hand = ArmModel().hand(HOME, np.zeros(7))
    signals = {
        "controller.qpos_ref": HOME,
        "controller.pos_cmd": np.array(HOME_XPOS),
        "controller.quat_cmd": np.array(HOME_XQUAT),
        "plant.hand_xpos": np.array(HOME_XPOS),
        "plant.hand_xquat": np.array(HOME_XQUAT),
        "plant.qpos": np.concatenate((HOME, np.zeros(9))),
        "plant.qvel": np.zeros(15),
        "plant.actuator_force": np.append(hand.bias, 0.0),
        "plant.qfrc_bias": hand.bias.copy(),
        "plant.jac": hand.jacobian.copy(),
    }
    repeated = {name: np.repeat(value[None], ROWS, axis=0) for name, value in signals.items()}
    return FakeRecording(DT * np.arange(ROWS), repeated, {"row_times": ROW_TIMES})


def ramp(rate: float, order: int) -> Array:
    """A signal (n,) that is 0 up to row `AT`, with a constant derivative of an order from then on.

    It is the sum of backward differences, so that the derivative jumps in one row.
    """
    values = np.where(np.arange(ROWS) > AT, rate, 0.0)
    for _ in range(order):
        values = np.cumsum(values) * DT
    return values


def command_joint(joint: int, values: Array) -> Callable[[FakeRecording], None]:
    def change(run: FakeRecording) -> None:
        run.signals["controller.qpos_ref"][:, joint - 1] += values

    return change


def add(name: str, element: int, values: Array) -> Callable[[FakeRecording], None]:
    def change(run: FakeRecording) -> None:
        run.signals[name][:, element - 1] += values

    return change


def turn(values: Array) -> Callable[[FakeRecording], None]:
    """Turn the commanded hand about the line between its fingertips' centre and its origin."""

    def change(run: FakeRecording) -> None:
        home = Rotation.from_quat(HOME_XQUAT, scalar_first=True)
        about_z = Rotation.from_rotvec(values[:, None] * np.array([0.0, 0.0, 1.0]))
        run.signals["controller.quat_cmd"][:] = (home * about_z).as_quat(scalar_first=True)

    return change


def push(*force: float) -> Callable[[FakeRecording], None]:
    """A force on the hand [N], world axes, that the servos hold against."""

    def change(run: FakeRecording) -> None:
        torque = np.array(force) @ run.signals["plant.jac"][0, :3]
        run.signals["plant.actuator_force"][AT + 1 :, :7] -= torque

    return change


JOINT, HAND = "joint_motion_generator_", "cartesian_motion_generator_"
REFUSALS = {
    # key: error, interface, joint, row of the first refusal, value and bound
    "joint_position": (command_joint(4, ramp(1.6, 0)), f"{JOINT}position_limits_violation",
                       "joint", 4, AT + 1, HOME[3] + 1.6, -0.0698),
    "joint_velocity": (command_joint(4, ramp(2.2, 1)), f"{JOINT}velocity_limits_violation",
                       "joint", 4, AT + 1, 2.2, 2.175),
    "joint_acceleration": (command_joint(4, ramp(-12.6, 2)), f"{JOINT}velocity_discontinuity",
                           "joint", 4, AT + 1, -12.6, -12.5),
    "joint_jerk": (command_joint(4, ramp(6300.0, 3)), f"{JOINT}acceleration_discontinuity",
                   "joint", 4, AT + 1, 6300.0, 6250.0),
    "translation_velocity": (add("controller.pos_cmd", 2, ramp(1.71, 1)),
                             f"{HAND}velocity_limits_violation", "cartesian", None, AT + 1, 1.71,
                             1.7),
    "translation_acceleration": (add("controller.pos_cmd", 3, ramp(13.1, 2)),
                                 f"{HAND}velocity_discontinuity", "cartesian", None, AT + 1, 13.1,
                                 13.0),
    "translation_jerk": (add("controller.pos_cmd", 1, ramp(6510.0, 3)),
                         f"{HAND}acceleration_discontinuity", "cartesian", None, AT + 1, 6510.0,
                         6500.0),
    "rotation_velocity": (turn(ramp(2.51, 1)), f"{HAND}velocity_limits_violation", "cartesian",
                          None, AT + 1, 2.51, 2.5),
    "rotation_acceleration": (turn(ramp(25.1, 2)), f"{HAND}velocity_discontinuity", "cartesian",
                              None, AT + 1, 25.1, 25.0),
    "rotation_jerk": (turn(ramp(12600.0, 3)), f"{HAND}acceleration_discontinuity", "cartesian",
                      None, AT + 1, 12600.0, 12500.0),
    "elbow_velocity": (command_joint(3, ramp(2.2, 1)), f"{HAND}velocity_limits_violation",
                       "cartesian", None, AT + 1, 2.2, 2.175),
    "elbow_acceleration": (command_joint(3, ramp(10.1, 2)), f"{HAND}velocity_discontinuity",
                           "cartesian", None, AT + 1, 10.1, 10.0),
    "elbow_jerk": (command_joint(3, ramp(5010.0, 3)), f"{HAND}acceleration_discontinuity",
                   "cartesian", None, AT + 1, 5010.0, 5000.0),
    "elbow_position": (command_joint(3, ramp(2.9, 0)), f"{HAND}elbow_limit_violation",
                       "cartesian", None, AT + 1, 2.9, 2.8973),
    "torque_rate": (add("plant.actuator_force", 6, ramp(1010.0, 1)),
                    "controller_torque_discontinuity", "torque", 6, AT + 1, 1010.0, 1000.0),
    "torque": (add("plant.actuator_force", 5, ramp(13.0, 0)), "tau_j_range_violation", "arm", 5,
               AT + 1, None, 12.0),
    "arm_position": (add("plant.qpos", 1, ramp(2.9, 0)), "joint_position_limits_violation", "arm",
                     1, AT + 1, 2.9, 2.8973),
    "arm_velocity": (add("plant.qvel", 7, ramp(-2.62, 0)), "joint_velocity_violation", "arm", 7,
                     AT + 1, -2.62, -2.61),
    "hand_velocity": (add("plant.qvel", 1, ramp(3.1, 0)), "cartesian_velocity_violation", "arm",
                      None, AT + 1, 3.1 * 0.554499478, 1.7),
    "external_torque": (add("plant.actuator_force", 1, ramp(-50.0, 0)), "joint_reflex", "arm", 1,
                        AT + 2, 50.0 * (1 - (1 / 1.5) ** 2), 20.0),
    "external_force": (push(0.0, 0.0, 30.0), "cartesian_reflex", "arm", 3, AT + 3,
                       30.0 * (1 - (1 / 1.5) ** 3), 20.0),
    "external_moment": (add("plant.actuator_force", 7, ramp(-30.0, 0)), "cartesian_reflex", "arm",
                        None, None, None, -25.0),
    "start_pose": (add("controller.qpos_ref", 2, np.full(ROWS, 0.003)),
                   "joint_position_motion_generator_start_pose_invalid", "joint", 2, 0, 0.003,
                   0.002175),
    "start_place": (add("controller.pos_cmd", 1, np.full(ROWS, 0.002)),
                    "cartesian_position_motion_generator_start_pose_invalid", "cartesian", None, 0,
                    0.002, 0.0017),
    "end_velocity": (command_joint(7, ramp(0.5, 2)), f"{JOINT}velocity_discontinuity", "joint", 7,
                     ROWS - 1, 0.5 * DT * (ROWS - 1 - AT), 0.02),
    "end_acceleration": (command_joint(6, ramp(90.0, 3)), f"{JOINT}acceleration_discontinuity",
                         "joint", 6, ROWS - 1, 90.0 * DT * (ROWS - 1 - AT), 10.0),
}  # fmt: skip


@pytest.mark.parametrize("key", REFUSALS)
def test_each_refusal_has_libfrankas_name_its_instant_row_value_and_bound(key: str) -> None:
    change, error, interface, joint, row, value, bound = REFUSALS[key]
    run = at_rest()
    assert preflight(run, "fer")["findings"] == []
    change(run)
    told = preflight(run, "fer")
    first = next(each for each in told["findings"] if each["name"] == key)
    assert (first["error"], first["interface"]) == (error, interface)
    if row is not None:
        assert first["time_s"] == pytest.approx(row * DT)
        assert first["row"] == 1 + sum(time < row * DT - 1e-9 for time in ROW_TIMES)
    for name, expected in (("value", value), ("bound", bound)):
        if expected is not None:
            assert first[name] == pytest.approx(expected, rel=SAME)
    if joint is not None:
        assert first["joint"] == joint
    assert max(told[f"{key}_share"]) >= 1.0


# --- runs


def run_of(scenario: str, folder: Path, *options: str) -> tuple[dict[str, Any], Recording]:
    """Summary and recording of a run."""
    out = folder / scenario
    done = command("run", scenario, "--no-video", "--no-view", "--out", out, *options)
    assert done.returncode in (0, 3), done.stdout + done.stderr
    return json.loads((out / "summary.json").read_text()), Recording.open(out)


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Recording]:
    """The Panda's fast cycle, as FR3 sees it; its observer is on."""
    folder = tmp_path_factory.mktemp("fast")
    settings = ("--set", "preflight=fr3", "--set", "controller.observer=true")
    return run_of("pick_and_place_fast", folder, *settings)


def differences(values: Array, order: int) -> Array:
    """Backward differences [1/s^order] at each row, of a signal that rests before."""
    rested = np.concatenate((np.repeat(values[:1], order, axis=0), values))
    return np.diff(rested, order, axis=0) / DT**order


def test_figures_are_those_of_the_recording(fast: tuple[dict[str, Any], Recording]) -> None:
    told, run = fast[0]["preflight"], fast[1]
    q = run["controller.qpos_ref"]
    velocity, acceleration, jerk = (differences(q, order) for order in (1, 2, 3))
    hand = Rotation.from_quat(run["controller.quat_cmd"], scalar_first=True)
    place = run["controller.pos_cmd"] + hand.apply([0.0, 0.0, 0.1034])
    turns = np.concatenate((np.zeros((1, 3)), (hand[1:] * hand[:-1].inv()).as_rotvec())) / DT
    moved = np.einsum("nij,nj->ni", run["plant.jac"], run["plant.qvel"][:, :7])
    lever = Rotation.from_quat(run["plant.hand_xquat"], scalar_first=True).apply([0, 0, 0.1034])
    external = run["controller.external_torque"] / [20, 20, 18, 18, 16, 14, 12]
    force = run["controller.external_force"] / [20, 20, 20, 25, 25, 25]
    expected = {
        "joint_velocity": velocity / fr3_speed(q, velocity),
        "joint_acceleration": acceleration / FR3["acceleration"],
        "joint_jerk": jerk / FR3["jerk"],
        "arm_velocity": run["plant.qvel"][:, :7]
        / fr3_speed(run["plant.qpos"][:, :7], run["plant.qvel"][:, :7]),
        "translation_velocity": np.linalg.norm(differences(place, 1), axis=1)[:, None] / 3.0,
        "translation_acceleration": np.linalg.norm(differences(place, 2), axis=1)[:, None] / 9.0,
        "translation_jerk": np.linalg.norm(differences(place, 3), axis=1)[:, None] / 4500.0,
        "rotation_velocity": np.linalg.norm(turns, axis=1)[:, None] / 2.5,
        "elbow_acceleration": acceleration[:, 2:3] / 10.0,
        "elbow_velocity": velocity[:, 2:3] / 1.5,
        "hand_velocity": np.linalg.norm(
            moved[:, :3] + np.cross(moved[:, 3:], lever), axis=1
        )[:, None] / 3.0,
        "torque": run["plant.actuator_force"][:, :7] / ([87] * 4 + [12] * 3),
        "external_torque": external,
        "external_force": force[:, :3],
        "external_moment": force[:, 3:],
        "end_velocity": velocity[-1:] / 0.01,
        "end_acceleration": acceleration[-1:] / 5.0,
    }  # fmt: skip
    refused = {each["name"]: each for each in told["findings"]}
    for key, shares in expected.items():
        most = np.abs(shares).max(axis=0)
        assert told[f"{key}_share"] == pytest.approx(most, rel=1e-5, abs=1e-6), key
        above = np.flatnonzero((np.abs(shares) >= 1.0).any(axis=1))
        assert (key in refused) == bool(len(above)), key
        if len(above) and not key.startswith("end"):
            assert refused[key]["time_s"] == pytest.approx(run.time[above[0]])


def test_the_pandas_fast_cycle_asks_too_much_acceleration_of_fr3(
    fast: tuple[dict[str, Any], Recording],
) -> None:
    told = fast[0]["preflight"]
    assert told["refusals"] == 2
    assert max(told["joint_acceleration_share"]) == pytest.approx(1.59, abs=0.005)
    assert max(told["joint_velocity_share"]) < 1.0
    assert [each["error"] for each in told["findings"] if each["interface"] == "joint"][:2] == [
        "joint_motion_generator_acceleration_discontinuity",
        "joint_motion_generator_velocity_discontinuity",
    ]


def arriving(q: Array, at: int, count: int, *, delayed: bool) -> tuple[Array, Array]:
    """Acceleration and jerk (7,) when packets arrive again after `count` were lost before row `at`.

    The robot goes on for so many ticks with its last acceleration.
    """
    rest = np.concatenate((np.repeat(q[:1], 30, axis=0), q))
    last = at - count - 1 + 30
    now = rest[last]
    rate = (rest[last] - rest[last - 1]) / DT
    kept = (rest[last] - 2 * rest[last - 1] + rest[last - 2]) / DT**2
    for _ in range(count):
        rate = rate + DT * kept
        now = now + DT * rate
    packet = rest[last + 1] if delayed else rest[at + 30]
    change = ((packet - now) / DT - rate) / DT
    return change, (change - kept) / DT


@pytest.mark.parametrize("key", ["lost_packets", "delay_ms"])
def test_late_packets_are_borne_up_to_a_number_that_tick_by_tick_extrapolation_gives(
    key: str,
) -> None:
    run = at_rest()
    time = DT * np.arange(ROWS)
    ahead = np.clip((time - 0.05) / 0.15, 0.0, 1.0)
    run.signals["controller.qpos_ref"][:, 5] += 0.02 * (1 - np.cos(np.pi * ahead)) / 2
    told = preflight(run, "fer")
    q = run["controller.qpos_ref"]

    def is_refused(at: int, count: int) -> bool:
        change, jerk = arriving(q, at, count, delayed=key == "delay_ms")
        return bool((np.abs(change) >= FER["acceleration"]).any()
                    or (np.abs(jerk) >= FER["jerk"]).any())  # fmt: skip

    borne = told[key]
    rows = range(ROWS)
    for count in range(1, borne + 1):
        assert not any(is_refused(at, count) for at in rows)
    first = next(at for at in rows if is_refused(at, borne + 1))
    assert told["late"][key]["time_s"] == pytest.approx(DT * first)
    assert told["late"][key]["joint"] == 6
    assert {"lost_packets": 1 <= borne < 19, "delay_ms": borne < 3}[key]


def test_all_but_twenty_packets_may_be_lost_by_a_robot_that_stands() -> None:
    told = preflight(at_rest(), "fr3")
    assert (told["lost_packets"], told["delay_ms"], told["late"]) == (19, 19, {})


def test_a_long_recording_is_judged_in_blocks_as_a_whole(tmp_path: Path) -> None:
    """A recording in pieces gives the same, wherever they end."""
    _, run = run_of("pick_and_place_fast", tmp_path)

    class InPieces(FakeRecording):
        def in_blocks(self, *names: str, before: int = 0) -> Any:
            del before
            for rows in np.array_split(np.arange(run.rows), 97):
                yield [run[name][rows] for name in names]

        def __contains__(self, name: str) -> bool:
            return name in run

    whole, pieces = (preflight(each, "fr3") for each in (run, InPieces(run.time, {}, run.metadata)))
    assert pieces.keys() == whole.keys()
    for key, value in whole.items():
        if key.endswith("_share"):
            assert pieces[key] == pytest.approx(value, rel=1e-12), key
        elif key not in ("findings", "late"):
            assert pieces[key] == value, key
    for told, again in zip(whole["findings"], pieces["findings"], strict=True):
        assert (
            again == pytest.approx(told) if isinstance(told, float) else again.keys() == told.keys()
        )
        assert (again["name"], again["time_s"], again["row"]) == (
            told["name"], told["time_s"], told["row"]
        )  # fmt: skip


@pytest.mark.parametrize("signal", ["controller.qpos_ref", "plant.jac"])
def test_what_is_not_recorded_is_not_called_accepted(signal: str) -> None:
    run = at_rest()
    assert preflight(run, "fer")["refusals"] == 0
    del run.signals[signal]
    told = preflight(run, "fer")
    assert told["refusals"] is None
    assert "good" not in [level for level, _ in outcome(told)]


def test_of_no_rows_nothing_is_said() -> None:
    run = at_rest()
    empty = {name: signal[:0] for name, signal in run.signals.items()}
    assert preflight(FakeRecording(run.time[:0], empty), "fer") == {}


@pytest.mark.parametrize("rows", [1, ROWS])
def test_the_first_row_of_jacobi_coupling_has_no_command_yet(rows: int) -> None:
    run = at_rest()
    signals = {name: signal[:rows] for name, signal in run.signals.items()}
    late = FakeRecording(run.time[:rows], signals, {"coupling": "jacobi"})
    assert preflight(late, "fer")["findings"] == []
    late.signals["controller.qpos_ref"][0] = 0.0
    assert bool(preflight(late, "fer")["findings"]) == (rows == 1)


def test_where_the_arm_has_motors_the_torques_count() -> None:
    run = at_rest()
    run.units["controller.ctrl[1]"] = "N.m"
    run.signals["plant.actuator_force"][AT + 1 :, 3] += 1.1
    told = preflight(run, "fr3")
    assert (told["interface"], told["refusals"], told["first_s"]) == ("torque", 1, (AT + 1) * DT)
    assert (told["lost_packets"], told["joint_jerk_share"]) == (None, None)
    assert told["joint_refusals"] is told["cartesian_refusals"] is None
    assert (told["torque_refusals"], told["arm_refusals"]) == (1, 0)


# --- what a user sees


def test_view_and_sweeps_have_what_the_summary_has(fast: tuple[dict[str, Any], Recording]) -> None:
    told = fast[0]["preflight"]
    lines = story.refusals_of(fast[0])
    assert [line.split()[2] for line in lines] == [
        each["error"] for each in told["findings"] if each["interface"] in ("joint", "arm")
    ][: told["refusals"]]
    bars = {bar["name"]: bar["shares"] for bar in story.limits_of(fast[0])}
    assert bars["fr3: joint jerk"] == told["joint_jerk_share"]
    assert "fr3: torque rate" not in bars  # of another interface
    assert story.refusals_of({"preflight": {"robot": 1}}) == story.refusals_of({}) == []
    groups = ["events", "tracking", "orientation", "block", "contact", "limits", "energy", "timing"]
    content: dict[str, Any] = {group: {} for group in groups} | {"preflight": told}
    columns = dict(metrics(SimpleNamespace(**content)))
    assert columns["summary.preflight.refusals"] == 2.0
    assert columns["summary.preflight.joint_jerk_share[7]"] == told["joint_jerk_share"][6]
    assert columns["summary.preflight.lost_packets"] == told["lost_packets"]


def test_check_says_what_the_robot_refuses_and_exits_3() -> None:
    done = command("check", "scenarios/library/slow_controller", "--robot", "fer")
    assert done.returncode == 3, done.stdout
    assert "joint_motion_generator_velocity_discontinuity at t = 0." in done.stdout
    assert "(row 2)" in done.stdout
    assert "controller.period = 0.001" in done.stdout  # more time would not help


def test_pick_and_place_passes_for_the_panda() -> None:
    done = command("check", "scenarios/library/pick_and_place", "--robot", "fer")
    assert done.returncode == 0, done.stdout
    assert "fer refuses nothing over the joint interface" in done.stdout


def test_fr3_accepts_its_own_fast_cycle() -> None:
    done = command("check", "scenarios/library/pick_and_place_fast_fr3")
    assert done.returncode == 0, done.stdout
    assert "fr3 refuses nothing over the joint interface" in done.stdout
    assert "recommends" not in done.stdout  # it ends at rest
    assert "it can run" in done.stdout


def test_refusals_are_a_criterion(tmp_path: Path) -> None:
    settings = ("--set", "success.max_refusals=1", "--set", "preflight=fr3")
    summary, _ = run_of("pick_and_place_fast", tmp_path, *settings)
    criterion = next(each for each in summary["criteria"] if each["name"] == "max_refusals")
    assert (criterion["value"], criterion["ok"]) == (2, False)
    assert summary["preflight"]["refusals"] == 2


def test_no_other_robot_is_known() -> None:
    done = command("check", "scenarios/library/pick_and_place", "--robot", "ur5")
    assert done.returncode == 2
    assert "'ur5' is not one of 'fer', 'fr3'" in done.stdout + done.stderr
