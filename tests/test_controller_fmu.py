"""The native controller FMU has the bits of the law in Python."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fmu_instance import ERROR, OK, STEP, Instance, RefusedError, unpacked
from law_support import inputs_of, replay
from panda_cosim import load_scenario
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains, preset
from random_tasks import run_plain

Array = NDArray[np.float64]
pytestmark = [pytest.mark.fmu, pytest.mark.own_process]
ROWS = 300  # steps of a test


@pytest.fixture(params=(2, 3), ids=("fmi2", "fmi3"))
def it(request):
    return unpacked("native", "controller", request.param)


@pytest.fixture(scope="module")
def inputs():
    """Inputs of a controller in the middle of its task (n, 109)."""
    return inputs_of(run_plain(load_scenario("pick_and_place")))[900 : 900 + ROWS]


def outputs(it: Instance, inputs: Array, first: int = 0) -> Array:
    """Outputs after each step."""
    rows = []
    for tick, row in enumerate(inputs.tolist(), first):
        it.set_inputs(row)
        assert it.step(tick * STEP) == OK, it.messages()
        rows.append(it.outputs())
    return np.array(rows)


@pytest.mark.parametrize("name", ["default", "tutorial"])
def test_it_gives_the_bits_of_the_law(it, inputs, name):
    gains = preset(name, ki=(2.0,) * 7)
    values: dict[str, Any] = {"use_reference": [gains.use_reference]}
    for gain in ("kp", "ki", "kd", "integral_limit", "finger_speed", "derivative_filter"):
        value = getattr(gains, gain)
        values[gain] = value if isinstance(value, tuple) else [value]
    assert np.array_equal(outputs(Instance(it).start(values), inputs),
                          replay(Controller(gains), inputs))  # fmt: skip


def test_a_longer_period_holds_the_outputs(it, inputs):
    expected = replay(Controller(Gains(), 0.005), inputs[::5])
    instance = Instance(it).start({"period": [0.005]})
    assert np.array_equal(outputs(instance, inputs), expected.repeat(5, axis=0))


@pytest.mark.parametrize("change", [{"kp": (3.0,) * 7}, {"use_reference": False}])
def test_gains_may_change_between_steps(it, inputs, change):
    controller, instance = Controller(), Instance(it).start()
    for first, half in ((0, inputs[: ROWS // 2]), (ROWS // 2, inputs[ROWS // 2 :])):
        assert np.array_equal(outputs(instance, half, first), replay(controller, half))
        controller.gains = replace(controller.gains, **change)
        for name, value in change.items():
            assert instance.set(name, *(value if isinstance(value, tuple) else (value,))) == OK


def test_a_period_that_is_no_multiple_of_the_step_is_refused(it):
    instance = Instance(it)
    assert instance.set("period", 0.0015) == instance.enter() == OK
    assert instance("ExitInitializationMode") == ERROR
    assert "period" in instance.messages()


def test_a_broken_model_of_the_arm_is_named(it, tmp_path):
    place = it.copy(tmp_path / "fmu")
    (place.folder / "resources" / "panda.mjb").write_bytes(b"no model")
    with pytest.raises(RefusedError, match=r"panda\.mjb"):
        Instance(place)


def test_quaternions_are_scaled_and_zeros_are_not_taken(it, inputs):
    rows = inputs[:6].copy()
    rows[0] = 0.0  # as some importers send at first
    rows[2, 3:7] *= 2.0
    rows[4, 17:21] = 0.0
    instance = Instance(it).start()
    got = outputs(instance, rows)
    assert got[0].tolist() == [*Gains().base_ctrl, 255.0, *[0.0] * 57]
    expected = inputs[1:6].copy()
    expected[1, 3:7] = rows[2, 3:7] / np.linalg.norm(rows[2, 3:7])
    expected[3, 17:21] = rows[3, 17:21]
    assert np.abs(replay(Controller(), expected) - got[1:]).max() <= 1e-12
    assert len(instance.log) == 2
    assert all("(logged once)" in text for _, _, text in instance.log)
