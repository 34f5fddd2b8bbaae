"""Each number of a run is what its definition says: computed again from recordings, by numpy."""

import json
import math
import runpy
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fake_recording import FakeRecording
from forked import command
from panda_cosim import Recording, Scenario, Success
from panda_cosim.assets.franka import Q_MAX, Q_MIN, QDD_MAX, QDDD_MAX
from panda_cosim.result.judging.definitions import DEFINITIONS
from panda_cosim.result.judging.holds import find_holds
from panda_cosim.result.recording.storage import open_parquet
from panda_cosim.run.summary import summarize
from panda_cosim.study.analysis.margins import Loop, Margins
from panda_cosim.task.criteria import EVENTS
from panda_cosim.task.fields import field_names
from panda_cosim.task.rotations import Array

SAME = 1e-9  # relative and in any unit, of rounding alone
ANGLE = 1e-6  # [deg] an arc cosine near 1 loses half its digits
LONG = [pytest.param(name, marks=pytest.mark.long)
        for name in ("tutorial", "push_block", "stack_blocks")]  # fmt: skip
SHIPPED = ("pick_and_place", "slow_controller", "place_and_pick_again", "jacobi", "calibrated")
RUN = ("scenario", "complete", "reason", "success", "criteria", "margin", "expect", "expect_reason",
       "as_expected", "verdict", "row_ends", "first_limit", "stepped_by", "code",
       "profile")  # fmt: skip


# --- the numbers once more


def spans_of(time: Array, force: Array) -> list[tuple[int, int]]:
    """First row of each hold and the first after it, found row by row."""

    def lasts(span: list[int]) -> bool:
        return bool(time[min(span[1], len(time) - 1)] - time[span[0]] >= 0.05 - SAME)

    spans: list[list[int]] = []
    for row in np.flatnonzero(force > 0.5).tolist():
        if spans and spans[-1][1] == row:
            spans[-1][1] = row + 1
        else:
            spans.append([row, row + 1])
    longer = [value for a, b in filter(lasts, spans) for value in force[a:b]]
    holds: list[list[int]] = []
    for a, b in spans:
        if not lasts([a, b]) and not (longer and max(force[a:b]) > np.mean(longer)):
            continue
        if holds and time[a] - time[holds[-1][1]] < 0.05 - SAME:
            holds[-1][1] = b
        else:
            holds.append([a, b])
    return [(a, b) for a, b in filter(lasts, holds)]


def hold_again(run: Recording, grasp: int, end: int) -> dict[str, Any]:
    """Rows of a hold's events, and its slip [mm]."""
    block, opening = run["plant.qpos"][:, 9:12], run["controller.grip_cmd"]
    release_command = end
    for row in range(grasp + 1, end):
        rises = opening[row] > opening[row - 1]
        rose = row - 1 > grasp and opening[row - 1] > opening[row - 2]
        if rises and not rose and (opening[row:end] > opening[row - 1]).all():
            release_command = row
    away = (np.linalg.norm(block[row] - block[grasp]) > 0.005 for row in range(grasp, end))
    lift = next((grasp + row for row, is_away in enumerate(away) if is_away), None)
    slip = None
    if lift is not None and lift <= release_command:
        carried = slice(lift, min(release_command + 1, end))
        away = block[carried] - run["plant.hand_xpos"][carried]
        hand = Rotation.from_quat(run["plant.hand_xquat"][carried], scalar_first=True)
        in_hand = hand.apply(away, inverse=True)
        slip = 1e3 * max(np.linalg.norm(in_hand - in_hand[0], axis=1))
    return {"grasp": grasp, "lift": lift, "release_command": release_command, "end": end,
            "slip_mm": slip}  # fmt: skip


def measured_again(run: Recording, goal: tuple[float, float, float] | None) -> dict[str, Any]:
    """The numbers of a run by key, from the words of their definitions."""
    time, qpos, last = run.time, run["plant.qpos"], len(run.time) - 1
    block, (w, x, y, z) = qpos[:, 9:12], qpos[:, 12:16].T
    force, hand = run["plant.contact_force"], run["plant.hand_xpos"]
    holds = [hold_again(run, *span) for span in spans_of(time, force)]
    joints = run["controller.joint_contact"] if "controller.joint_contact" in run else 0 * qpos
    ended = [hold for hold in holds if hold["end"] <= last]
    released: Mapping[str, Any] = ended[-1] if ended else {}
    placed = None
    if ended:
        later = np.flatnonzero(time >= time[released["end"]] + 0.5 - SAME)
        again = [h for h in holds if h["grasp"] > released["end"] and h["grasp"] <= later[:1]]
        placed = int(later[0]) if len(later) and not again else None

    command = np.hstack((run["controller.pos_cmd"], run["controller.quat_cmd"]))
    changes = [row for row in range(last) if (command[row] != command[row + 1]).any()]
    moving = sorted({*changes, *(row + 1 for row in changes)})
    speed = np.linalg.norm(np.diff(hand, axis=0), axis=1) / np.diff(time)
    rest = last
    while rest > 0 and speed[rest - 1] < 0.005:
        rest -= 1

    error = 1e3 * np.linalg.norm(hand - run["controller.pos_cmd"], axis=1)
    turns = [run["controller.quat_cmd"] + sign * run["plant.hand_xquat"] for sign in (-1, 1)]
    apart = np.min([np.linalg.norm(turn, axis=1) for turn in turns], axis=0)
    angle = np.degrees(4 * np.arcsin(apart / 2))
    powers = run["plant.actuator_force"][:, :7] * run["plant.qvel"][:, :7]
    power = powers.clip(min=0.0).sum(axis=1)
    tilt = np.degrees(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1)))
    yaw = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    at = last if placed is None else placed

    def instant(row: int | None) -> float | None:
        return None if row is None or row > last else float(time[row])

    drop = pressed = None
    if placed is not None:
        drop = 1e3 * (block[released["release_command"], 2] - block[placed, 2])
        if released["lift"] is not None and "plant.support_force" in run:
            pressed = max(run["plant.support_force"][released["lift"] : placed + 1])
    away = None if goal is None else 1e3 * (block[at] - goal)
    slips = [hold["slip_mm"] for hold in holds if hold["slip_mm"] is not None]
    lifts = [max(block[h["grasp"] : h["end"], 2]) - block[h["grasp"], 2] for h in holds]
    return {
        "events.start": time[0],
        "events.grasp": instant(holds[0]["grasp"]) if holds else None,
        "events.lift": next((instant(h["lift"]) for h in holds if h["lift"] is not None), None),
        "events.release_command": instant(released.get("release_command")),
        "events.release": instant(released.get("end")),
        "events.placed": instant(placed),
        "events.command_end": instant(moving[-1]) if moving else None,
        "events.at_rest": instant(rest) if rest < last else None,
        "events.end": time[-1],
        "events.collision": instant(next((r for r in range(last + 1) if 2.0 in joints[r]), None)),
        "tracking.rms_mm": np.sqrt(np.mean(error**2)),
        "tracking.max_mm": max(error),
        "tracking.moving_rms_mm": np.sqrt(np.mean(error[moving] ** 2)) if moving else None,
        "tracking.moving_max_mm": max(error[moving]) if moving else None,
        "orientation.rms_deg": np.sqrt(np.mean(angle**2)),
        "orientation.max_deg": max(angle),
        "block.holds.grasp_s": [instant(h["grasp"]) for h in holds],
        "block.holds.lift_s": [instant(h["lift"]) for h in holds],
        "block.holds.release_command_s": [instant(h["release_command"]) for h in holds],
        "block.holds.release_s": [instant(h["end"]) for h in holds],
        "block.holds.slip_mm": [h["slip_mm"] for h in holds],
        "block.lift_m": max(lifts, default=0.0),
        "block.slip_mm": max(slips, default=None),
        "block.drop_mm": drop,
        "block.set_down_force_N": pressed,
        "block.place_error_mm": None if away is None else np.linalg.norm(away),
        "block.place_error_xyz_mm": away,
        "block.tilt_deg": tilt[at],
        "block.peak_tilt_deg": max(tilt),
        "block.yaw_deg": yaw[at],
        "block.yaw_error_deg": min(abs(yaw[at] - quarter) for quarter in range(-180, 181, 90)),
        "block.release_s": instant(released.get("end")),
        "block.placed_at_s": instant(placed),
        "block.final_position_m": block[-1],
        "block.final_quaternion_wxyz": qpos[-1, 12:16],
        "contact.peak_force_N": max(force),
        "contact.unwanted_force_N": max(run["plant.unwanted_contact_force"]),
        **limits_again(run),
        "energy.arm_work_J": sum(power[i] * (time[i] - time[i - 1]) for i in range(1, last + 1)),
        "energy.peak_power_W": max(power),
        "timing.simulated_s": time[-1] - time[0],
        "timing.cycle_s": instant(moving[-1]) if moving else 0.0,
        "timing.steps": last,
    }  # fmt: skip


def limits_again(run: Recording) -> dict[str, Any]:
    """The largest shares of the limits that can be measured."""
    q, qd, torque = (run[f"plant.{name}"] for name in ("qpos", "qvel", "actuator_force"))
    on = int(np.flatnonzero(torque[:, :7].any(axis=1))[0])
    speed_limit = np.array([2.175] * 4 + [2.61] * 3)
    found = {
        "position": 2 * (q[:, :7] - Q_MIN) / (Q_MAX - Q_MIN) - 1,
        "velocity": qd[:, :7] / speed_limit,
        "torque": torque[:, :7] / ([87] * 4 + [12] * 3),
        "torque_rate": (torque[on + 2 :, :7] - torque[on + 1 : -1, :7]) / 0.001 / 1000,
        "finger_speed": qd[:, 7:9] / 0.05,
    }
    if "controller.qvel_ref" in run:
        velocity, late = run["controller.qvel_ref"], int(run.metadata["coupling"] == "jacobi")
        period = run.metadata["parameters"]["controller"]["period"]
        updates = velocity[late :: round(period / 0.001)]
        found["reference_velocity"] = velocity / speed_limit
        found["reference_acceleration"] = np.diff(updates, axis=0) / period / QDD_MAX
        found["reference_jerk"] = np.diff(updates, 2, axis=0) / period**2 / QDDD_MAX
    return {f"limits.{key}_share": np.abs(used).max(axis=0) for key, used in found.items()}


# --- against the product's


@pytest.fixture(scope="module", params=[*SHIPPED, *LONG])
def run(request, tmp_path_factory):
    """Folder of a run of a shipped scenario."""
    out = tmp_path_factory.mktemp("runs") / request.param
    command("run", request.param, "--no-video", "--no-view", "--out", out, code=0)
    return out


def told(summary: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The numbers of a summary by key; those of the holds as lists."""
    for section, content in summary.items():
        if section in RUN:
            yield section, content
        elif isinstance(content, Mapping):
            for name, value in content.items():
                yield f"{section}.{name}", value
    holds = summary["block"].get("holds")
    for name in holds[0] if holds else ():
        yield f"block.holds.{name}", [hold[name] for hold in holds]


def test_each_number_is_what_its_definition_says(run):
    summary = dict(told(json.loads((run / "summary.json").read_text())))
    recording, scenario = Recording.open(run), Scenario.read(run / "scenario")
    again = measured_again(recording, scenario.success.block_position)
    if not summary["block.holds"]:
        again = {key: value for key, value in again.items() if "block.holds." not in key}
    for key, value in again.items():
        close = ANGLE if "_deg" in key else SAME
        expected = pytest.approx(listed(value), rel=SAME, abs=close, nan_ok=True)
        assert listed(summary[key]) == expected, key


def without(path: Path, signal: str) -> Recording:
    """A recording that lacks a signal."""
    source = open_parquet(path)
    columns = [each for each in source.columns if each.name.partition("[")[0] != signal]
    return Recording(path, replace(source, columns=columns))


NEEDED = sorted({signal for each in DEFINITIONS.values() for signal in each.signals})
WORDS = {*RUN, "block.holds", "contact.unwanted", "limits.not_measured", "preflight.findings",
         "preflight.late"}  # fmt: skip


def test_no_number_is_wrong_for_want_of_a_signal(run):
    """Without a signal that its definition names it has no value, without another the same."""
    robot = "fer" if run.name == "pick_and_place" else ""  # which takes a second
    scenario = replace(Scenario.read(run / "scenario"), preflight=robot)
    path = run / "recording.parquet"
    whole = dict(told(summarize(Recording.open(run), scenario).to_dict()))
    for signal in NEEDED:
        part = dict(told(summarize(without(path, signal), scenario).to_dict()))
        for key in whole.keys() - WORDS:
            value = part.get(key)
            is_none = value is None or not np.size(value) or set(np.ravel(value)) == {None}
            same = not is_none and value == whole[key]
            assert is_none or (same and signal not in DEFINITIONS[key].signals), (key, signal)


def listed(value: Any) -> list[float]:
    """A number or several; what was not measured is NaN."""
    return [math.nan if each is None else float(each) for each in np.ravel(value).tolist()]


def test_each_number_is_defined_and_each_criterion_judges_the_one_that_it_names(run):
    summary = json.loads((run / "summary.json").read_text())
    numbers = dict(told(summary))
    assert numbers.keys() <= DEFINITIONS.keys()
    for criterion in summary["criteria"]:
        definition = DEFINITIONS.get(f"success.{criterion['name']}")
        if definition is not None and definition.metric in numbers:
            value = numbers[definition.metric]
            scale = 1e-3 if definition.metric.endswith("_mm") else 1.0
            assert criterion["value"] == pytest.approx(value * scale, rel=SAME)
            assert criterion["unit"] == definition.unit


def test_every_definition_is_of_a_number_event_or_criterion(tmp_path):
    out = tmp_path / "run"
    short = ("--set", "duration=2.5", "--no-video", "--no-view", "--realtime")
    short = (*short, "--set", "preflight=fer")
    assert command("run", "pick_and_place", *short, "--out", out).returncode == 3  # not placed
    keys = {key for key, _ in told(json.loads((out / "summary.json").read_text()))}
    keys |= {f"success.{name}" for name in field_names(Success)}
    keys -= {"success.block_position", "success.signal", "success.body"}
    keys |= {f"analysis.{name}" for name in field_names(Margins)}
    keys |= {f"analysis.loops.{name}" for name in field_names(Loop)}
    own = {key for key in DEFINITIONS if not key.startswith("success.body.")}
    assert own == keys
    assert {key.removeprefix("events.") for key in own if key.startswith("events.")} == {*EVENTS}


# --- holds


SPANS = st.tuples(st.integers(1, 120), st.sampled_from([0.0, 0.5, 0.75, 2.0, 9.0]))


@given(st.lists(SPANS, min_size=1, max_size=12), st.sampled_from([0.001, 0.0005, 0.01]))
def test_holds_are_those_found_row_by_row(runs, step):
    force = np.array([value for count, value in runs for _ in range(count)])
    time = step * np.arange(len(force))
    signals = {"plant.qpos": np.zeros((len(time), 16)), "plant.contact_force": force,
               "controller.grip_cmd": np.zeros(len(time))}  # fmt: skip
    found = [(hold.grasp, hold.end) for hold in find_holds(FakeRecording(time, signals))]
    assert found == spans_of(time, force)


# The example of ISO 9283: its figures computed again from the recordings, and by hand.


ISO = runpy.run_path(str(Path(__file__).parents[2] / "scenarios" / "examples" / "iso9283.py"))


def test_repeatability_by_hand():
    """Four poses on a circle of 1 mm: no distance differs; angles of +-1 deg twice."""
    poses = np.zeros((4, 6))
    poses[:, :2] = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    poses[:, 5] = [1.0, -1.0, 1.0, -1.0]
    values = ISO["figures"](poses)
    assert values["R_l"] == pytest.approx(1.0)
    assert values["R_c"] == pytest.approx(3.0 * np.sqrt(4.0 / 3.0))
    assert values["R_a"] == 0.0


def test_overshoot_begins_with_the_first_crossing():
    time = 0.001 * np.arange(7)
    distance = np.array([9.0, 0.5, 2.0, 3.0, 0.5, 0.1, 0.0])
    assert ISO["stabilization"](time, distance, 1.0) == pytest.approx((3.0, 0.003))
    assert ISO["stabilization"](time, distance, 4.0) == (0.0, 0.0)
    distance[-1] = 2.0  # mm
    assert ISO["stabilization"](time, distance, 1.0) is None
