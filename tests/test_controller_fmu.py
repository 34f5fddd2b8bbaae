"""The native controller FMU, in FMI 2.0 and FMI 3.0: its law, parameters and states."""

from __future__ import annotations

from dataclasses import replace

import controller_fmu_jobs as jobs
import numpy as np
import pytest
from fmu_support import in_process
from law_support import SANITIZERS, inputs_of, replay, sanitized
from numpy.typing import NDArray
from panda_cosim import load_scenario
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains, preset
from random_tasks import run_plain

Array = NDArray[np.float64]

pytestmark = pytest.mark.fmu

ROWS = 300  # steps of a test
VERSIONS = pytest.mark.parametrize("version", [2, 3])


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("fmu") / "it"
    jobs.unpack(str(folder))
    return str(folder)


@pytest.fixture(scope="session")
def sanitized_folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("sanitized") / "it"
    jobs.unpack(str(folder), *SANITIZERS)
    return str(folder)


@pytest.fixture(scope="session")
def inputs() -> Array:
    """Inputs of a controller in the middle of its task (n, 84)."""
    return inputs_of(run_plain(load_scenario("pick_and_place")))[900 : 900 + ROWS]


@VERSIONS
@pytest.mark.parametrize("name", ["default", "tutorial"])
def test_it_gives_the_bits_of_the_law(folder: str, inputs: Array, version: int, name: str) -> None:
    gains = preset(name, ki=(2.0,) * 7)
    parameters = {"use_reference": [gains.use_reference], "ki": [2.0] * 7}
    for other in ("kp", "kd", "integral_limit", "finger_speed", "derivative_filter"):
        value = getattr(gains, other)
        parameters[other] = list(value) if isinstance(value, tuple) else [value]
    result = in_process(jobs.replay, folder, version, parameters, inputs.tolist())
    assert np.array_equal(result, replay(Controller(gains), inputs))


@VERSIONS
def test_no_sanitizer_finds_anything(sanitized_folder: str, inputs: Array, version: int) -> None:
    given = sanitized_folder, version, inputs.tolist()
    results = in_process(jobs.rolled_back, *given, **sanitized())
    assert results[1] == results[0]


@VERSIONS
def test_a_longer_period_holds_the_outputs(folder: str, inputs: Array, version: int) -> None:
    result = in_process(jobs.replay, folder, version, {"period": [0.005]}, inputs.tolist())
    expected = replay(Controller(Gains(), 0.005), inputs[::5])
    assert np.array_equal(result, expected.repeat(5, axis=0))


@VERSIONS
def test_a_state_goes_on_with_the_same_bits(folder: str, inputs: Array, version: int) -> None:
    straight, back, elsewhere = in_process(jobs.rolled_back, folder, version, inputs.tolist())
    assert back == straight
    assert elsewhere == straight


@VERSIONS
def test_gains_may_change_between_steps(folder: str, inputs: Array, version: int) -> None:
    results = in_process(jobs.tuned, folder, version, inputs.tolist())
    for result, change in zip(results, ({"kp": (3.0,) * 7}, {"use_reference": False}), strict=True):
        controller, half = Controller(), ROWS // 2
        before = replay(controller, inputs[:half])
        controller.gains = replace(controller.gains, **change)  # type: ignore[arg-type]
        assert np.array_equal(result, np.vstack((before, replay(controller, inputs[half:]))))


@VERSIONS
@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("period", [0.0015], "period"),
        ("kp", [1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0], "kp[3]"),
        ("limit_share", [2.0], "limit_share"),
    ],
)
def test_impossible_parameters_are_refused(
    folder: str, version: int, name: str, values: list[float], message: str
) -> None:
    assert message in in_process(jobs.refused, folder, version, name, values)


@VERSIONS
def test_quaternions_are_scaled_and_zeros_are_not_taken(
    folder: str, inputs: Array, version: int
) -> None:
    rows = inputs[:6].copy()
    rows[0] = 0.0  # as some importers send at first
    rows[2, 3:7] *= 2.0
    rows[4, 17:21] = 0.0
    warnings, outputs = in_process(jobs.logged, folder, version, rows.tolist())
    start = [*Gains().base_ctrl, 255.0, *[0.0] * 30]
    assert outputs[0] == start
    expected = inputs[1:6].copy()
    expected[1, 3:7] = rows[2, 3:7] / np.linalg.norm(rows[2, 3:7])
    expected[3, 17:21] = rows[3, 17:21]
    assert np.abs(replay(Controller(), expected) - outputs[1:]).max() <= 1e-12
    assert len(warnings) == 2
    assert all("(logged once)" in text for text in warnings)
