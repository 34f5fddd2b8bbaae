"""A summary of recordings whose numbers are known: holds, events and verdicts.

Each number of real runs is computed once more in test_definitions.py.
"""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fake_recording import FakeRecording
from panda_cosim import Recording, Scenario, Success, TableRow, TrajectoryTable, load_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.cli.outcome import outcome_lines
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.result.judging.advice import advise
from panda_cosim.result.judging.limits import exceeded, first_limit, largest_share, limit_shares
from panda_cosim.result.recording import Column, Recorder
from panda_cosim.run.summary import summarize
from panda_cosim.task.rotations import Array
from random_tasks import run_plain

TICKS = 2000
MILLIMETRE = 1e-9  # [mm], rounding of a metric
NAMES = ["time"] + [
    f"{instance}.{name}"
    for instance, interface in INTERFACES.items()
    for variable in interface.variables
    if variable.causality == "output" or variable.name.endswith("_cmd")
    for name in variable.names()
]


def blank_rows() -> Array:
    """A block that lies on the floor, and a hand that is where it shall be (n, columns)."""
    rows = np.zeros((TICKS + 1, len(NAMES)))
    rows[:, 0] = np.arange(TICKS + 1) * 1e-3
    values = {"plant.hand_xquat[1]": 1.0, "controller.quat_cmd[1]": 1.0, "plant.qpos[12]": 0.05,
              "plant.qpos[13]": 1.0, "plant.qpos[4]": -1.5, "plant.qpos[6]": 1.5}  # fmt: skip
    for name, value in values.items():
        rows[:, NAMES.index(name)] = value
    return rows


@pytest.fixture
def record(tmp_path):
    def make(rows: Array, *, complete: bool = True) -> Recording:
        with Recorder(tmp_path / "run", [Column(n) for n in NAMES], {"scene": "tabletop"}) as out:
            out.append(rows)
            out.close(complete=complete, reason=None if complete else "cut")
        return Recording.open(tmp_path / "run")

    return make


def scenario(**success: object) -> Scenario:
    rows = tuple(TableRow(t, "home", (0.0, 0.0, 0.0), 0.08) for t in (0.0, 1.0))
    return Scenario("test", TrajectoryTable(rows), 2.0, success=Success(**success))  # type: ignore[arg-type]


def put(rows: Array, name: str, values: object, start: int = 0, stop: int | None = None) -> None:
    rows[start:stop, NAMES.index(name)] = values


def carried_rows(*, slip: float = 0.0) -> Array:
    """The block is held from 0.3 to 1.2 s, carried up by 0.2 m, and set down elsewhere."""
    rows = blank_rows()
    put(rows, "plant.contact_force", 60.0, 300, 1200)
    height = np.full(TICKS + 1, 0.05)
    height[400:600] = np.linspace(0.05, 0.25, 200)
    height[600:] = 0.25
    put(rows, "plant.qpos[12]", height)
    put(rows, "plant.hand_xpos[3]", height + 0.1)
    put(rows, "controller.pos_cmd[3]", height + 0.1)
    put(rows, "controller.grip_cmd", 0.08, 1150)
    put(rows, "plant.qpos[10]", slip, 700)
    return rows


@pytest.mark.parametrize(("sign", "lift"), [(1.0, 0.2), (-1.0, 0.0)])
def test_lift_slip_and_place_are_those_of_the_block_that_is_not_lifted_downwards(
    record, sign, lift
):
    rows = carried_rows(slip=0.0004)
    for name in ("plant.qpos[12]", "plant.hand_xpos[3]"):
        rows[:, NAMES.index(name)] *= sign
    success = {"block_position": (0.0, 0.0, sign * 0.25), "position_tolerance": 0.001}
    summary = summarize(record(rows), scenario(**success))
    block = summary.block
    assert block["lift_m"] == pytest.approx(lift, abs=1e-12)
    assert block["slip_mm"] == pytest.approx(0.4, abs=MILLIMETRE)
    assert block["release_s"] == pytest.approx(1.2, abs=1e-9)
    assert block["placed_at_s"] == pytest.approx(1.7, abs=1e-9)  # half a second later
    assert block["place_error_mm"] == pytest.approx(0.4, abs=MILLIMETRE)
    assert summary.success


def test_letting_go_is_a_drop_and_no_slip(record):
    rows = carried_rows(slip=0.0004)
    put(rows, "plant.qpos[12]", 0.249, 1151)  # falls by 1 mm after the command, while it is held
    put(rows, "plant.support_force", 12.0, 1160, 1162)  # N
    put(rows, "controller.grip_cmd", 0.01, 450, 1150)  # a weaker grip does not let go
    block = summarize(record(rows), scenario(max_drop=0.0009)).block
    assert block["slip_mm"] == pytest.approx(0.4, abs=MILLIMETRE)
    assert block["drop_mm"] == pytest.approx(1.0, abs=MILLIMETRE)
    assert block["holds"][0]["release_command_s"] == pytest.approx(1.15)
    assert block["set_down_force_N"] == 12.0


def test_fingers_that_brush_what_they_have_let_go_hold_nothing(record):
    rows = carried_rows(slip=0.0004)
    for row in (1210, 1213, 1220, *range(1300, 1420, 10)):  # single rows, 3 N each
        put(rows, "plant.contact_force", 3.0, row, row + 1)
    summary = summarize(record(rows), scenario())
    instants = (summary.events[name] for name in ("release_command", "release", "placed"))
    assert [*instants] == pytest.approx([1.15, 1.2, 1.7])
    assert len(summary.block["holds"]) == 1


def test_a_block_that_is_flung_is_not_lifted(record):
    rows = blank_rows()
    put(rows, "plant.contact_force", 60.0, 300, 340)  # a touch of 40 ms
    put(rows, "plant.qpos[12]", 5.0, 500)
    summary = summarize(record(rows), scenario(min_lift=0.1))
    assert (summary.block["lift_m"], summary.events["grasp"], summary.success) == (0.0, None, False)


@pytest.mark.parametrize("rows", [0, 100])
def test_an_incomplete_run_is_no_success(record, rows):
    recording = record(blank_rows()[:rows], complete=False)
    summary = summarize(recording, scenario(max_tilt=1.0))
    assert (summary.success, summary.complete, summary.reason) == (False, False, "cut")
    assert "ended early: cut" in next(outcome_lines(summary, recording, realtime=False))[0]


@pytest.mark.parametrize("expect", ["success", "failure"])
def test_a_missed_criterion_decides_and_what_was_not_measured_is_no_verdict(record, expect):
    asked = scenario(max_slip=0.001, min_lift=0.1)
    asked = replace(asked, expect=expect, expect_reason="so" if expect == "failure" else "")
    recording = record(blank_rows())
    summary = summarize(recording, asked)
    assert summary.block["slip_mm"] is None
    assert not summary.success
    assert summary.as_expected == (expect == "failure")  # as min_lift is missed
    assert summary.margin == -1.0
    told = "Failure, as expected" if expect == "failure" else "Success criteria missed: "
    assert next(outcome_lines(summary, recording, realtime=False))[0].startswith(told)

    open_ended = summarize(recording, replace(asked, success=Success(max_slip=0.001)))
    assert next(outcome_lines(open_ended, recording, realtime=False))[0].startswith("No verdict")


def test_tracking_of_a_law_without_orientation_is_measured(tmp_path):
    signals = ("plant.hand_xpos", "controller.pos_cmd")
    names = [f"{name}[{i}]" for name in signals for i in (1, 2, 3)]
    time, rows = 1e-3 * np.arange(101.0), np.zeros((101, 7))
    rows[:, 0], rows[:, 1], rows[:, 4] = time, 0.003, 0.0
    rows[50:, [1, 4]] += 0.1  # the command moves at one tick, by as much as the hand
    rows[50, 1] += 0.004
    with Recorder(tmp_path / "run", [Column(n) for n in ("time", *names)], {}) as out:
        out.append(rows)
        out.close(complete=True, reason=None)
    summary = summarize(Recording.open(tmp_path / "run"), scenario(tracking_max=0.01))
    assert summary.tracking["max_mm"] == pytest.approx(7.0, abs=MILLIMETRE)
    assert summary.tracking["moving_rms_mm"] is None  # when the command turns is not known
    assert summary.orientation == {}
    assert summary.success


# What a run's summary tells of the robot's limits.


ROWS = 20
JERK = ("joint-reference jerk of joint 4", "200%")


def still(**metadata: Any) -> FakeRecording:
    """A recording of nothing that moves; its signals may be changed."""
    signals = {
        "plant.qpos": np.tile([*HOME_Q, *(0.0,) * 9], (ROWS, 1)),
        "plant.qvel": np.zeros((ROWS, 15)),
        "plant.actuator_force": np.zeros((ROWS, 8)),
        "plant.hand_xpos": np.zeros((ROWS, 3)),
        "controller.qpos_ref": np.tile(HOME_Q, (ROWS, 1)),
        "controller.qvel_ref": np.zeros((ROWS, 7)),
        "controller.limit": np.zeros((ROWS, 7)),
    }
    return FakeRecording(1e-3 * np.arange(ROWS), signals, metadata)


def test_another_arm_is_not_held_against_this_robots_limits():
    run = still()
    del run.signals["plant.hand_xpos"]
    shares = limit_shares(run)
    assert {key for key in shares if not key.startswith("reference_")} == {"not_measured"}
    assert set(shares["not_measured"].values()) == {"plant.hand_xpos is not recorded"}


@pytest.mark.parametrize("row", [10, -1])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_jerk_is_that_of_the_reference_to_its_last_row(coupling, row):
    run = still(coupling=coupling)
    # One step of 0.0125 rad/s of joint 4: 12.5 rad/s^2, and 12,500 rad/s^3 of 6,250.
    run.signals["controller.qvel_ref"][row:, 3] = 0.0125
    assert [each[:2] for each in exceeded(run, limit_shares(run))] == [JERK]


@pytest.mark.parametrize("on", [0, 1, 2, 10])
def test_however_late_the_servos_are_switched_on_it_is_no_torque_rate(on):
    run = still()
    torque = run.signals["plant.actuator_force"]
    torque[on:, 1], torque[on + 1 :, 1] = 30.0, 32.0  # N.m
    assert limit_shares(run)["torque_rate_share"] == [0.0] * 7
    torque[on + 2 :, 4] = 1.5
    shares = limit_shares(run)
    assert shares["torque_rate_share"] == [0.0, 0.0, 0.0, 0.0, 1.5, 0.0, 0.0]
    at = 1e-3 * (on + 2)
    assert [*exceeded(run, shares)] == [("torque rate of joint 5", "150%", pytest.approx(at))]


def test_with_jacobi_the_reference_begins_with_the_first_update():
    """Row 0 has the start values, and the first update stands in row 1."""
    run = still(coupling="jacobi")
    run.signals["controller.qvel_ref"][1:, 6] = -0.005  # rad/s
    shares = limit_shares(run)
    assert shares["reference_jerk_share"] == shares["reference_acceleration_share"] == [0.0] * 7


def test_a_law_without_a_joint_reference_is_judged_by_the_plants_limits():
    scenario = load_scenario("pick_and_place")
    run = still()
    del run.signals["controller.qvel_ref"]
    run.signals["plant.actuator_force"][10:, 1] = 5.0  # N.m
    run.signals["plant.actuator_force"][12:, 1] = 10.22
    course = run_plain(replace(scenario, duration=0.05))
    for name in [n for n in course.signals if n.startswith("controller.") and "_cmd" not in n]:
        del course.signals[name]
    shares = limit_shares(run)
    assert list(exceeded(run, shares)) == [("torque rate of joint 2", "522%", 0.012)]
    assert shares["not_measured"] == dict.fromkeys(
        [f"reference_{kind}_share" for kind in ("velocity", "acceleration", "jerk")],
        "controller.qvel_ref is not recorded",
    )
    asked = replace(scenario, success=Success(max_limit_share=1.0))
    (criterion,) = summarize(course, asked).criteria
    assert criterion.ok
    assert criterion.value == largest_share(limit_shares(course))


def test_the_first_limit_that_binds_is_named_also_a_servo_without_torque_left():
    run = still()
    assert first_limit(run) is None
    run.signals["controller.limit"][7:, 4] = 4.0
    run.signals["controller.limit"][9:, 1] = 3.0
    run.signals["plant.actuator_force"][5:, 1] = -43.5  # N.m of 87
    assert first_limit(run) == {"time_s": 0.007, "joint": 5, "kind": "jerk"}
    run.metadata["parameters"] = {"plant": {"torque_limit_scale[2]": 0.5}}
    assert first_limit(run) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del run.signals["controller.limit"]  # a law that has no limits
    assert first_limit(run) == {"time_s": 0.005, "joint": 2, "kind": "torque"}
    del run.signals["plant.actuator_force"]
    assert first_limit(run) is None


def test_limits_are_told_where_all_criteria_hold_and_can_be_criteria():
    scenario = load_scenario("near_singular")
    run = run_plain(scenario)
    unbounded = replace(scenario.success, max_limit_share=None)
    summary = summarize(run, replace(scenario, success=unbounded))
    assert summary.success
    text = "\n".join(advise(run, summary))
    assert re.search(r"torque rate of joint \d is \d+% of its limit", text)
    assert "reference jerk" not in text  # which is kept
    assert "limit of joint" in text
    assert "more time does not help" in text
    early = replace(summary, first_limit={**(summary.first_limit or {}), "time_s": 0.1})
    for ours in (True, False):  # it refuses FMUs of one's own
        told = "\n".join(advise(run, early, ours=ours))
        assert ("give that row more time (`panda-cosim retime" in told) == ours
    for bound, ok in ((1.0, False), (100.0, True)):
        bounded = replace(scenario.success, max_limit_share=bound)
        summary = summarize(run, replace(scenario, success=bounded))
        assert summary.success is ok
        assert next(c for c in summary.criteria if c.name == "max_limit_share").ok is ok
