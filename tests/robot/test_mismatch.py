"""The section [mismatch]: presets, single keys, what they put into the FMUs, and runs with them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from panda_cosim import Scenario, Success, load_scenario, run_scenario
from panda_cosim.controller.model import ArmModel
from panda_cosim.controller.sensor_errors import SensorErrors
from panda_cosim.controller.sensors import TRUTH, Sensors
from panda_cosim.plant.plant import Plant
from panda_cosim.run.start import resolve, start_values
from panda_cosim.run.system.assembly import assemble
from panda_cosim.task.mismatch import SIZES, Mismatch, draw_robot
from panda_cosim.task.writer import write_scenario
from random_tasks import run_in_memory
from refusals import refused

PUSH = load_scenario("push")


@pytest.mark.parametrize("preset", SIZES)
def test_a_preset_draws_within_its_sizes_and_by_its_seed(preset):
    sizes = SIZES[preset]
    robots = [draw_robot(sizes, seed) for seed in range(300)]
    assert robots[3] == draw_robot(sizes, 3)
    offsets = np.array([robot["joint_offset"] for robot in robots])
    assert np.std(offsets) == pytest.approx(sizes.joint_offset, rel=0.1)
    seen = np.array([robot["block_position_error"] for robot in robots])
    assert np.std(seen) == pytest.approx(sizes.block_position, rel=0.1)
    friction = np.array([robot["joint_friction"] for robot in robots])
    assert sizes.friction[0] <= friction.min() < friction.max() <= sizes.friction[1]
    for name in ("link_mass_scale", "servo_scale"):
        assert np.abs(np.array([robot[name] for robot in robots]) - 1.0).max() <= sizes.share


def test_a_key_takes_precedence_over_the_preset_and_the_plants_section_over_both():
    mismatch = Mismatch(preset="calibrated", seed=2, joint_offset=0.0, payload=1.0)
    scenario = replace(PUSH, mismatch=mismatch, plant={"payload": 2.0})
    values = start_values(scenario)
    assert {values["sensors"][f"joint_offset[{i}]"] for i in range(1, 8)} == {0.0}
    assert values["sensors"]["delay"] == values["controller"]["reading_delay"] == 0.001
    assert values["sensors"]["hand_pose_source"] == "model"
    assert values["sensors"]["seed"] == 2.0
    assert values["plant"]["payload"] == 2.0
    assert values["plant"]["joint_friction[1]"] > 0.2


def test_the_sensors_stand_between_plant_and_controller():
    scenario = replace(PUSH, mismatch=Mismatch(delay=0.002))
    assembly = assemble(scenario)
    assert list(assembly.interfaces) == ["sensors", "controller", "plant"]
    into = {c.target[1]: c.source for c in assembly.connections if c.target[0] == "controller"}
    assert into["jac[6,7]"] == ("sensors", "jac_measured[6,7]")
    torques = into.pop("actuator_force[1]")[0]  # the servos measure these
    assert torques == "plant"
    sources = {source[0] for name, source in into.items() if "actuator" not in name}
    assert sources == {"sensors"}
    assert {c.source[0] for c in assembly.connections if c.target[0] == "sensors"} == {"plant"}


def test_the_camera_moves_the_table_with_the_block_it_sees():
    scenario = load_scenario("pick_and_place")
    seen = Mismatch(block_position_error=(0.002, -0.001, 0.0005), block_yaw_error=0.1)
    true, shifted = (
        resolve(each, start_values(each)) for each in (scenario, replace(scenario, mismatch=seen))
    )
    at_block = [i for i, row in enumerate(scenario.table.rows) if row.frame == "target"]
    moved = shifted.positions - true.positions
    np.testing.assert_allclose(moved[at_block], [(0.002, -0.001, 0.0005)] * 4, atol=1e-12)
    others = [i for i in range(len(moved)) if i not in at_block]
    np.testing.assert_allclose(moved[others], 0.0, atol=1e-12)
    assert (shifted.orientations[at_block] != true.orientations[at_block]).any()


def test_keys_and_elements_can_be_set_and_the_others_stay_the_presets():
    values = {"mismatch.preset": "worn", "mismatch.seed": 3.0, "mismatch.joint_offset[3]": 0.01}
    found = PUSH.changed(values).mismatch
    assert (found.seed, found.joint_offset[2]) == (3, 0.01)
    assert found.joint_offset[0] == draw_robot(SIZES["worn"], 3)["joint_offset"][0]


BAD = {
    'preset = "old"': "preset: value 'old'; must be one of nominal, calibrated, worn",
    "joint_ofset = 0.1": "key 'joint_ofset' is unknown",
    "joint_noise = -1.0": "joint_noise: value -1.0; must be a number from 0 to 0.1 rad",
    "joint_offset = [0.1, 0.2]": "joint_offset: value [0.1, 0.2]; must be 7 numbers",
    "delay = 0.0015": "delay: value 0.0015 s; must be a whole number of ticks of 0.001 s",
    "seed = 1.5": "seed: value 1.5; must be a whole number",
    'hand_pose_source = "modle"': "hand_pose_source: value 'modle'; must be one of plant, model",
    "servo_scale = nan": "servo_scale: value nan; must be a number",
}


@pytest.mark.parametrize("line", BAD)
def test_what_is_impossible_is_refused_in_one_line(line, tmp_path):
    write_scenario(PUSH, tmp_path)
    with (tmp_path / "scenario.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[mismatch]\n{line}\n")
    said = refused(Scenario.read, tmp_path)
    assert "[mismatch]" in said
    assert BAD[line] in said


def shortened(**keys: object) -> Scenario:
    """The first fifth of a second of a run."""
    scenario = load_scenario("pick_and_place").changed({"duration": 0.2})
    return replace(scenario, mismatch=Mismatch(**keys))  # type: ignore[arg-type]


@pytest.mark.own_process
@pytest.mark.parametrize("known", [0.0, 0.003])
def test_a_known_delay_does_not_let_the_hand_run_ahead(tmp_path, known):
    """The hand is ahead by its speed times the delay, unless the controller knows the delay."""
    keys = {"mismatch.delay": 0.003, "controller.reading_delay": known}
    scenario = replace(PUSH, duration=0.3, success=Success(), push=()).changed(keys)
    recording = run_scenario(scenario, tmp_path / "run").recording
    ahead = recording["plant.hand_xpos"] - recording["controller.pos_cmd"]
    expected = (0.003 - known) * recording["controller.vel_cmd"]  # m
    assert np.abs(ahead - expected).max() < 1e-4  # m
    assert np.abs(recording["controller.vel_cmd"]).max() > 0.1  # m/s


@pytest.mark.own_process
def test_runs_with_sensors(tmp_path):
    mismatches = {}, {"dropout": 0.0}, {"preset": "calibrated"}, {"preset": "calibrated"}
    plain, zero, one, again = (
        run_scenario(shortened(**keys), tmp_path / str(number)).recording
        for number, keys in enumerate(mismatches)
    )
    # All zero: the same bits as without the sensors.
    assert all(plain[name].tobytes() == zero[name].tobytes() for name in plain.columns)
    assert not any(name.startswith("sensors.") for name in plain.columns)
    # The same seed gives the same bits, and the controller gets what the sensors tell.
    assert all(one[name].tobytes() == again[name].tobytes() for name in one.columns)
    offset = one["sensors.qpos_measured"][1:] - one["plant.qpos"][:-1, :7]
    told = [one.metadata["parameters"]["sensors"][f"joint_offset[{i}]"] for i in range(1, 8)]
    np.testing.assert_allclose(offset[:50].mean(0), told, atol=1e-5)  # rad; late by one tick


def test_a_law_knows_of_no_mass_unless_it_asks_for_the_truth_by_name():
    circle = load_scenario("draw_circle")  # its law takes both
    plain = replace(circle, duration=0.02, success=Success())
    nominal = run_in_memory(plain).signals
    asked = {f"controller.{name}": f"plant.{name}" for name in ("mass_matrix", "qfrc_bias")}
    heavier = replace(plain, mismatch=Mismatch(payload=2.0, link_mass_scale=(1.2,) * 7))
    told = run_in_memory(heavier).signals
    q, seen = (told[f"sensors.{name}_measured"][1] for name in ("qpos", "mass_matrix"))
    np.testing.assert_allclose(seen, ArmModel().inertia(q), rtol=1e-12, atol=1e-15)
    for name in ("mass_matrix", "qfrc_bias"):  # at the start, but for the open fingers
        true, known = nominal[f"plant.{name}"][0], told[f"sensors.{name}_measured"][0]
        assert np.abs(known - true).max() < 0.01 * np.abs(true).max()
    wires = {c.target: c.source for c in assemble(replace(heavier, connect=asked)).connections}
    for end in ("qfrc_bias[4]", "mass_matrix[4,4]"):
        assert wires["controller", end] == ("plant", end)


# Sensors between plant and controller: each error does what it says, and zero does nothing.


ALL_ERRORS = SensorErrors(
    seed=3,
    joint_offset=(1e-3,) * 7,
    joint_noise=(1e-4,) * 7,
    joint_quantisation=(1e-5,) * 7,
    velocity_noise=(1e-3,) * 7,
    delay=3,
    dropout=0.2,
    hand_pose_source="model",
    block_position_error=(1e-3, 2e-3, 3e-3),
    block_yaw_error=0.1,
)


def readings(errors: SensorErrors, count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Truth and readings of some ticks, each (count,) records of `TRUTH`."""
    sensors, source = Sensors(errors), np.random.default_rng(5)
    rows = np.zeros((2, count), TRUTH)
    for tick in range(count):
        sensors.truth_values[:] = source.normal(0.0, 0.3, sensors.truth_values.size)
        sensors.update()
        rows[0, tick] = sensors.truth
        rows[1, tick] = sensors.reading_values[: TRUTH.itemsize // 8].view(TRUTH)[0]
    return rows[0], rows[1]


@given(st.integers(0, 8))
@settings(max_examples=9, deadline=None)
def test_a_delay_is_a_number_of_ticks_and_without_errors_readings_are_the_truth(delay):
    true, told = readings(SensorErrors(delay=delay), 30)
    assert told[delay:].tobytes() == true[: 30 - delay].tobytes()
    assert all(row.tobytes() == true[0].tobytes() for row in told[:delay])


def test_offset_noise_and_quantisation_have_their_sizes():
    offset, noise, step = (np.full(7, size) for size in (0.01, 1e-3, 1e-4))
    errors = SensorErrors(
        joint_offset=tuple(offset), joint_noise=tuple(noise), velocity_noise=tuple(2 * noise)
    )
    true, told = readings(errors, 2000)
    error = told["qpos"] - true["qpos"]
    np.testing.assert_allclose(error.mean(0), 0.01, atol=1e-4)  # rad
    np.testing.assert_allclose(error.std(0), 1e-3, rtol=0.1)
    np.testing.assert_allclose((told["qvel"] - true["qvel"]).std(0), 2e-3, rtol=0.1)
    true, told = readings(SensorErrors(joint_quantisation=tuple(step)), 50)
    np.testing.assert_allclose(told["qpos"] / step, np.round(told["qpos"] / step), atol=1e-6)
    assert np.abs(told["qpos"] - true["qpos"]).max() <= 0.5001e-4


def test_a_lost_reading_leaves_the_last_one():
    true, told = readings(SensorErrors(dropout=0.3), 2000)
    lost = [i for i in range(1, 2000) if told[i].tobytes() != true[i].tobytes()]
    assert 0.25 < len(lost) / 2000 < 0.35
    assert all(told[i].tobytes() == told[i - 1].tobytes() for i in lost)


def test_the_model_knows_where_the_hand_is_if_the_encoders_are_right():
    plant, sensors = Plant(), Sensors(SensorErrors(hand_pose_source="model"))
    plant.inputs["ctrl"][:7] += 0.2
    plant.step(200)
    for name in ("qpos", "qvel"):
        sensors.truth[name] = plant.outputs[name][:7]
    sensors.update()
    for name in ("hand_xpos", "hand_xquat", "jac"):
        np.testing.assert_allclose(sensors.readings[name], plant.outputs[name], atol=1e-12)
    bias = plant.outputs["qfrc_bias"]  # where the fingers are is not measured
    np.testing.assert_allclose(sensors.readings["qfrc_bias"], bias, atol=1e-3)


def test_the_camera_shifts_and_turns_the_block():
    errors = SensorErrors(block_position_error=(1e-3, 0.0, -2e-3), block_yaw_error=0.1)
    sensors = Sensors(errors)
    sensors.truth["target_xmat"] = np.eye(3)
    sensors.update()
    np.testing.assert_allclose(sensors.readings["target_xpos"], (1e-3, 0.0, -2e-3))
    assert np.arctan2(*sensors.readings["target_xmat"][1::-1, 0]) == pytest.approx(0.1)


@given(st.integers(1, 1200))
@settings(max_examples=10, deadline=None)
def test_a_restored_state_goes_on_with_the_same_bits(tick):
    sensors, other = Sensors(ALL_ERRORS), Sensors(ALL_ERRORS)
    truth = np.random.default_rng(tick).normal(size=(tick + 30, sensors.truth_values.size))
    for row in truth[:tick]:
        sensors.truth_values[:] = row
        sensors.update()
    other.set_state(sensors.get_state())
    other.reading_values[:] = sensors.reading_values
    for row in truth[tick:]:
        for each in (sensors, other):
            each.truth_values[:] = row
            each.update()
        assert sensors.reading_values.tobytes() == other.reading_values.tobytes()
