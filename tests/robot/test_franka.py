"""The interface of a real robot, with real clients: motions, reflexes, gripper, and bad clients."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from franka_clients import JOINTS, TICKS, UPWARDS
from franka_support import Coupled, claimed_address, couple, needs_clients
from panda_cosim import Options, load_scenario
from panda_cosim.assets.checks import CHECKS
from panda_cosim.assets.franka import HOME_Q, ROBOTS
from panda_cosim.controller.franka import line, wire
from panda_cosim.controller.franka.description import end_effector
from panda_cosim.controller.franka.line import Service
from panda_cosim.controller.franka.motions import MOTIONS, Kinematics
from panda_cosim.controller.franka.signals import Settings
from panda_cosim.controller.model import ArmModel
from panda_cosim.run.prepare import prepare

FRICTION = 1.5e-3  # [rad] that the joints' friction keeps a stiff spring from its reference
PLACE = 1e-3  # [m] within which the end effector follows a slow motion
LAG = 0.01  # [m] that springs and dampers may be behind a fast one
SINGLE = 1e-6  # [1] of numbers that are sent as float32
BRAKING = 20  # ticks at most in which the arm comes to rest after a smooth motion
pytestmark = [pytest.mark.timeout(120)]


@cache
def after(*words: str) -> Coupled:
    """What has come of a client; one that has failed itself is an error."""
    made = couple(*words)
    assert made.told is not None or not made.errors, made.errors
    return made


# The wire.


def test_messages_have_the_sizes_and_offsets_of_libfranka() -> None:
    layouts = dict(wire.ROBOT.requests)
    sizes = {name: layout.itemsize + 12 for name, layout in layouts.items()}
    assert sizes == {
        "connect": 16, "move": 125, "stop_move": 12, "set_collision_behavior": 428,
        "set_joint_impedance": 68, "set_cartesian_impedance": 60, "set_guiding_mode": 19,
        "set_ee_to_k": 140, "set_ne_to_ee": 140, "set_load": 116, "automatic_error_recovery": 12,
        "get_robot_model": 12,
    }  # fmt: skip
    assert [layout.itemsize + 10 for _, layout in wire.GRIPPER.requests] == [14, 10, 50, 26, 10]
    assert (wire.STATE.itemsize, wire.COMMAND.itemsize) == (1377, 371)
    assert len(wire.ERRORS) == len(set(wire.ERRORS)) == 41
    assert {check.error for check in CHECKS.values()} <= set(wire.ERRORS)


def test_a_request_that_is_not_complete_waits() -> None:
    ask = np.array((4, 8, 10), wire.GRIPPER.header).tobytes()
    assert [*wire.GRIPPER.split(ask + ask[:-1])] == [(4, 8, 10, None)]
    assert wire.GRIPPER.answer(4, 8, 2, b"more") == ask[:6] + b"\x10\0\0\0\2\0more"


# Motions.


@needs_clients
@pytest.mark.parametrize("what", ["joint", "joint_velocity"])
def test_joints_follow_tick_by_tick_as_far_as_they_are_told(what: str) -> None:
    made = after(what)
    q = made.rows[:, :7]
    np.testing.assert_allclose(q.max(axis=0) - q.min(axis=0), JOINTS, atol=3.0 * FRICTION)
    assert (made.ended, made.failed, made.warnings) == ("the program has left", False, [])
    if what == "joint_velocity":
        return
    assert made.told["durations"] == [0, 1]
    assert made.told["lag"] < 2.0 * FRICTION
    assert TICKS <= len(q) <= TICKS + BRAKING
    assert made.output("motion_generator")[: TICKS - 1].tolist() == [1.0] * (TICKS - 1)
    assert made.output("motion_generator")[-1] == 0.0
    assert abs(q[-1] - HOME_Q).max() < 2.0 * FRICTION


@needs_clients
@pytest.mark.parametrize("is_told", [True, False])
def test_a_repeat_and_a_pause_give_the_same_bits(is_told, monkeypatch, tmp_path):
    if not is_told:  # the kernel tells nothing of packets, as of another machine's
        monkeypatch.setattr(line, "PACKETS", tmp_path / "none")
    np.testing.assert_array_equal(
        couple("joint", "JointImpedance", "0.3").rows, after("joint").rows
    )


@needs_clients
def test_the_end_effector_follows_poses_and_twists() -> None:
    before, lifted, lowered = after("pose").told
    assert lifted - before == pytest.approx(UPWARDS, abs=PLACE)
    assert lowered == pytest.approx(before, abs=PLACE)


@needs_clients
def test_springs_are_as_soft_as_the_client_sets_them() -> None:
    assert after("soft").told["lag"] > 4.0 * after("joint").told["lag"]


@needs_clients
def test_the_hand_s_impedance_follows_the_hand() -> None:
    def place(q: Any) -> Any:
        return ArmModel("fr3").hand(q, np.zeros(7)).position.copy()

    made = after("joint", "CartesianImpedance")
    for tick in range(0, TICKS, TICKS // 8):
        away = place(made.rows[tick, :7]) - place(made.output("q_c")[tick])
        assert np.linalg.norm(away) < LAG


@needs_clients
def test_torques_act_and_the_model_is_the_robot_s() -> None:
    told, arm = after("torque").told, ArmModel("fr3")
    assert told["away"] < 0.05
    q = np.array(told["q"])
    np.testing.assert_allclose(told["gravity"], arm.hand(q, np.zeros(7)).bias, atol=0.02)
    mass = np.array(told["mass"]).reshape(7, 7)
    own = arm.inertia(q) - np.diag([0.195] * 4 + [0.074] * 3)  # without the rotors
    np.testing.assert_allclose(mass, own, atol=2e-3)


# Reflexes.

RATES = ["velocity_limits_violation", "velocity_discontinuity", "acceleration_discontinuity"]
REFLEXES = {
    "jump": [f"joint_motion_generator_{name}" for name in RATES],
    "kink": [f"joint_motion_generator_{name}" for name in RATES[1:]],
    "start": ["joint_position_motion_generator_start_pose_invalid"],
    "speed": ["joint_motion_generator_velocity_limits_violation"],
    "end of range": ["joint_motion_generator_velocity_limits_violation"],
    "end": ["joint_motion_generator_velocity_discontinuity"],
    "torque": ["controller_torque_discontinuity"],
    "spin": ["joint_velocity_violation"],
    "more than a motor has": ["tau_j_range_violation"],
    "jump of a pose": [f"cartesian_motion_generator_{name}" for name in RATES[1:]],
    "start of poses": ["cartesian_position_motion_generator_start_pose_invalid"],
    "turn": ["cartesian_motion_generator_velocity_limits_violation"],
    "end of a turn": ["cartesian_motion_generator_velocity_discontinuity"],
}


@needs_clients
@pytest.mark.parametrize("what", REFLEXES)
def test_what_the_robot_would_refuse_ends_the_motion_until_the_client_recovers(what: str) -> None:
    made = after("refused", what)
    refusal, rejection = made.told["told"]
    listed = ", ".join(f'"{name}"' for name in REFLEXES[what])
    assert f"[{listed}]" in refusal.replace("tau_J", "tau_j")  # libfranka has both spellings
    assert 'not possible in the current mode ("Reflex")' in rejection
    assert made.warnings == [f"reflex: {', '.join(REFLEXES[what])}"]
    assert made.told["modes"] == ["RobotMode.Reflex", "RobotMode.Idle"]
    assert made.told["errors"] == "[]"
    np.testing.assert_allclose(made.told["again"], 0.25 * JOINTS, atol=3.0 * FRICTION)
    bits = sum(2.0 ** wire.ERRORS.index(name) for name in REFLEXES[what])
    assert set(made.output("errors")) == {0.0, bits}
    if what == "speed":
        commanded = made.output("dq_c")[np.flatnonzero(made.output("errors"))[0], 0]
        assert commanded >= ROBOTS["fr3"].velocity[0] > commanded - 4.0e-3


@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.1, 0.5, 1.0, 1.5]))
def test_joint_motions_are_refused_in_the_tick_that_the_limits_say(seed: int, size: float) -> None:
    """The rates are differenced here once more, over all commands at once."""
    limits, start = ROBOTS["fr3"], np.array(HOME_Q)
    jerk = size * limits.jerk * np.random.default_rng(seed).uniform(-1.0, 1.0, (30, 7))
    jerk[0] = 0.0  # the first command is the start
    commanded = start + np.cumsum(np.cumsum(np.cumsum(jerk, axis=0), axis=0), axis=0) * 1e-9
    rates = [commanded]
    for _ in range(3):
        rates.append(np.diff(rates[-1], axis=0, prepend=rates[-1][:1]) * 1e3)
    above = np.abs(rates[2]) >= limits.acceleration, np.abs(rates[3]) >= limits.jerk
    expected = np.flatnonzero((above[0] | above[1]).any(axis=1))
    motion = MOTIONS[wire.Generator.JOINT_POSITION](
        Kinematics(), start, start, wire.Generator.JOINT_POSITION
    )
    found = [bool(motion.errors({"q_c": q})) for q in commanded]
    assert np.flatnonzero(found)[:1].tolist() == expected[:1].tolist()


@pytest.mark.parametrize("generator", [g for g in wire.Generator if 0 < g < 5])
def test_what_is_no_number_is_refused(generator: wire.Generator) -> None:
    start, nothing = np.array(HOME_Q), {"has_elbow": 0}
    for name, size in (("q_c", 7), ("dq_c", 7), ("O_T_EE_c", 16), ("O_dP_EE_c", 6)):
        nothing[name] = np.full(size, np.nan)
    assert MOTIONS[generator](Kinematics(), start, start, generator).errors(nothing)


@pytest.mark.parametrize(("angles", "error"), [
    (lambda k: 1e-3 * (k > 5), "cartesian_motion_generator_velocity_discontinuity"),
    (lambda k: 4e-6 * k * k, "cartesian_motion_generator_velocity_limits_violation"),
])  # fmt: skip
def test_the_elbow_moves_within_its_limits_and_leaves_the_hand_where_it_is(angles, error) -> None:
    start, arm = np.array(HOME_Q), Kinematics()
    pose = arm.end_effector(start)
    motion = MOTIONS[wire.Generator.CARTESIAN_POSE](
        arm, start, start, wire.Generator.CARTESIAN_POSE
    )
    command = {"O_T_EE_c": wire.columns(pose), "has_elbow": 1}
    for k in range(400):
        errors = motion.errors({**command, "elbow_c": [angles(k), -1.0]})
        if errors:
            assert error in errors
            break
        assert motion.q[2] == pytest.approx(angles(k), abs=1e-6)
        np.testing.assert_allclose(arm.end_effector(motion.q), pose, atol=1e-5)
    assert errors


@needs_clients
def test_a_collision_is_found_by_the_client_s_thresholds() -> None:
    def push(inputs: Any, tick: int) -> None:
        inputs["push_force"][2] = -40.0 * (100 <= tick < 200)

    soft, hard = (couple("touched", threshold, act=push) for threshold in ("20", "100"))
    assert "cartesian_reflex" in soft.told["told"][0]
    assert 100 < int(np.flatnonzero(soft.output("errors"))[0]) < 120
    assert hard.warnings == []


@needs_clients
def test_lost_commands_keep_the_acceleration_and_twenty_in_a_row_end_the_motion() -> None:
    some = couple("lossy", dropout=0.2, seed=3.0)
    assert some.warnings == []
    assert 0.6 < some.output("success_rate")[TICKS - 10] < 0.95
    all_lost = couple("lossy", dropout=1.0)
    assert "communication_constraints_violation" in all_lost.told
    refused = int(np.flatnonzero(all_lost.output("errors"))[0])
    assert refused + 1 == ROBOTS["fr3"].lost_packets


@needs_clients
def test_commands_can_arrive_late() -> None:
    late, prompt = couple("joint", delay=0.005), after("joint")
    wave = slice(5, TICKS)
    np.testing.assert_allclose(
        late.output("q_c")[wave], prompt.output("q_c")[: TICKS - 5], atol=SINGLE
    )


# The rest of the interface.


@needs_clients
def test_a_motion_is_stopped_from_another_thread() -> None:
    text, mode = after("stopped").told
    assert ("preempted" in text, mode) == (True, "RobotMode.Idle")


@needs_clients
def test_the_gripper_moves_and_grasps() -> None:
    told = after("gripper").told
    homed, moved, width, found, grasped, closed, nothing, grips, narrow, stops = told
    assert (homed, moved, found, grasped, closed) == (True, True, False, False, True)
    assert (nothing, grips, stops) == (True, True, True)
    assert (width, narrow) == (pytest.approx(0.05, abs=1e-4), pytest.approx(0.0, abs=1e-4))


@needs_clients
def test_frames_and_load_are_told_as_they_were_set() -> None:
    before, later = after("settings").told
    tool = end_effector()
    assert before["m_ee"] == [pytest.approx(tool.mass)]
    matrices = [{n: np.reshape(v, (4, 4)).T for n, v in told.items() if len(v) == 16}
                for told in (before, later)]  # fmt: skip
    for told in matrices:
        np.testing.assert_allclose(told["F_T_EE"], told["F_T_NE"] @ told["NE_T_EE"], atol=SINGLE)
    moved = matrices[0]["O_T_EE"] @ matrices[1]["NE_T_EE"]
    np.testing.assert_allclose(matrices[1]["O_T_EE"], moved, atol=SINGLE)
    np.testing.assert_allclose(matrices[1]["EE_T_K"], matrices[1]["NE_T_EE"], atol=SINGLE)
    assert later["m_load"] == [0.5]


@needs_clients
def test_a_client_may_leave_and_come_again() -> None:
    one, other = after("twice").told
    assert one == other == pytest.approx(HOME_Q, abs=SINGLE)


@needs_clients
def test_franky_moves_in_all_of_its_ways() -> None:
    q, before, later, turned, is_there, width = after("with_franky").told
    assert q == pytest.approx([0.1, 0.1, 0.0, -1.6, 0.0, 1.7, -0.7], abs=2.0 * FRICTION)
    assert np.linalg.norm(np.subtract(later, before)) == pytest.approx(0.05 * 2**0.5, abs=PLACE)
    assert 0.01 < turned[0] - q[0] < 0.05
    assert (is_there, width) == (True, pytest.approx(0.03, abs=1e-4))


# Clients that do what they should not.


@needs_clients
def test_a_client_that_dies_in_a_motion_is_an_error() -> None:
    made = couple("dies")
    assert (made.failed, made.ended) == (True, "the program has closed its connection in a motion")


@pytest.mark.parametrize(("client", "message"), [
    ("wrong_size", "request 0 of 14 bytes, which version 10 of the robot does not have"),
    ("nonsense", "request 4294967295 of 4294967295 bytes"),
    ("floods", "floods: more than 10000 requests"),
])  # fmt: skip
def test_a_client_that_sends_what_it_should_not_is_an_error(client: str, message: str) -> None:
    made = couple(client)
    assert made.failed
    assert message in made.ended
    assert "\n" not in made.ended


def test_a_client_of_another_version_is_told_ours() -> None:
    made = couple("older")
    assert (made.told, made.failed) == ([1, wire.ROBOT.version], False)


def test_it_does_not_wait_for_ever_for_a_client() -> None:
    made = couple(connection_timeout=0.2)
    assert made.failed
    assert made.ended.startswith("no program has connected to 127.0.2.")
    assert made.ended.endswith(":1337 for 0.2 s")


def test_without_a_client_a_run_waits_as_long_as_it_may_take() -> None:
    alone = replace(load_scenario("franky_pick"), client=None)
    for limit, patience in ((None, 0.0), (2.0, 2.0)):
        values = prepare(alone, Options(waits=True, time_limit=limit)).start_values()
        assert values["controller"]["connection_timeout"] == patience


def test_it_listens_on_this_machine_alone_and_a_port_in_use_is_refused() -> None:
    assert Settings().address == "127.0.0.1"
    with claimed_address() as address:
        service = Service(wire.ROBOT, None, address, 1337)
        try:
            with pytest.raises(wire.ProgramError, match=f"{address}:1337: Address already in use$"):
                Service(wire.ROBOT, None, address, 1337)
        finally:
            service.close()
