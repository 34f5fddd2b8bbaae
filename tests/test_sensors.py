"""Sensors between plant and controller: each error does what it says, and zero does nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from panda_cosim.controller.sensor_errors import SensorErrors
from panda_cosim.controller.sensors import TRUTH, Sensors
from panda_cosim.plant.plant import Plant

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


def readings(
    errors: SensorErrors, count: int, truth: Any = None
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Truth and readings of some ticks, each (count,) records of `TRUTH`."""
    sensors, source = Sensors(errors), np.random.default_rng(5)
    rows = np.zeros((2, count), TRUTH)
    for tick in range(count):
        sensors.truth_values[:] = source.normal(0.0, 0.3, sensors.truth_values.size)
        if truth is not None:
            sensors.truth["qpos"] = truth
        sensors.update()
        rows[0, tick] = sensors.truth
        rows[1, tick] = sensors.reading_values[: TRUTH.itemsize // 8].view(TRUTH)[0]
    return rows[0], rows[1]


def test_without_errors_readings_are_the_truth_bit_for_bit():
    true, told = readings(SensorErrors(), 50)
    assert true.tobytes() == told.tobytes()


@given(st.integers(0, 8))
@settings(max_examples=9, deadline=None)
def test_a_delay_is_a_number_of_ticks(delay):
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
    sensors.truth["qpos"], sensors.truth["qvel"] = (
        plant.outputs["qpos"][:7],
        plant.outputs["qvel"][:7],
    )
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
