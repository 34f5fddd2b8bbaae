"""How an FMU behaves: its values, its steps, its errors, its states, many times over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmu_jobs
import pytest
from fmu_support import DISCARD, OK, Worker, in_process
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.packaging.build import Target, build

NAMES = tuple(INTERFACES)
pytestmark = pytest.mark.fmu
START = [["setupExperiment"], ["enterInitializationMode"], ["exitInitializationMode"]]
MEMORY_BOUND = 3.0  # [kB] that an instance may leave behind, on average
MEMORY_NOISE = 8000.0  # [kB] by which resident memory goes up and down
ORDER = "called out of order"


@pytest.fixture(scope="module")
def fmus() -> dict[str, str]:
    return {name: str(path) for name, path in build(NAMES, target=Target("python")).items()}


Run = Callable[..., dict[str, Any]]


@pytest.fixture
def run(worker: Worker) -> Run:
    """What does what a script says; returns results, log and files in the working directory."""

    def scripted(path: str, *script: list[Any], cwd: Path | None = None) -> dict[str, Any]:
        outcome: dict[str, Any] = (
            in_process(fmu_jobs.scripted, path, list(script), cwd=cwd)
            if cwd
            else worker.do(fmu_jobs.scripted, path, list(script))
        )
        outcome["text"] = "\n".join(text for _, _, text in outcome["log"])
        return outcome

    return scripted


def test_outputs_at_initialization_follow_the_parameters(run: Run, fmus: dict[str, str]) -> None:
    values = {"block_pos[1]": 0.5, "block_pos[2]": 0.1}
    script = [["setupExperiment"], ["set", values], ["enterInitializationMode"]]
    outcome = run(fmus["plant"], *script, ["get", "qpos[10]", "target_xpos[2]"])
    assert outcome["results"][-1] == pytest.approx([0.5, 0.1], abs=1e-9)
    assert outcome["log"] == []


def test_a_value_that_cannot_be_is_told_and_may_be_put_right(
    run: Run, fmus: dict[str, str]
) -> None:
    script = [["setupExperiment"], ["set", {"block_mass": -1.0}], ["enterInitializationMode"]]
    wrong = run(fmus["plant"], *script, ["exitInitializationMode"], ["step", 0])
    assert wrong["results"][-1] == DISCARD
    assert "block_mass: -1.0 kg is out of range" in wrong["text"]
    better = [["get", "qpos[1]"], ["set", {"block_mass": 0.2}], ["exitInitializationMode"]]
    assert run(fmus["plant"], *script, *better, ["step", 0])["results"][-1] == OK


def test_an_exception_inside_is_logged_with_cause_and_traceback(
    run: Run, fmus: dict[str, str], tmp_path: Path
) -> None:
    broken = str(_broken_plant(tmp_path))
    outcome = run(broken, *START, ["step", 0], ["step", 1], ["get", "qpos[1]"])
    assert outcome["results"][3:5] == [DISCARD, DISCARD]
    (_, category, first), (_, _, trace), *_ = outcome["log"]
    assert first == "t = 0 s: ZeroDivisionError: 100% broken"
    assert "Traceback" in trace
    assert "_advance" in trace
    assert category == "logStatusError"
    assert "not stepped after an earlier failure" in outcome["text"]


def _broken_plant(folder: Path) -> Path:
    """A plant whose step raises, packaged as an FMU."""
    from dataclasses import replace  # noqa: PLC0415 - only here

    from panda_cosim.fmus.packaging.bundle import BUNDLES  # noqa: PLC0415
    from panda_cosim.fmus.packaging.python_fmu import build_bundle  # noqa: PLC0415

    bundle = BUNDLES["plant"]
    slave = bundle.files()["fmus/slaves/plant.py"]
    call = b"self._plant.step(ticks)"
    assert slave.count(call) == 1
    slave = slave.replace(call, b'raise ZeroDivisionError("100% broken")')
    extra = (("fmus/slaves/plant.py", slave),)
    return build_bundle(replace(bundle, extra=extra), folder / "broken.fmu")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(("name", "variable"), [("plant", "ctrl[3]"), ("controller", "jac[2,5]")])
def test_an_input_that_is_not_finite_is_refused_by_name(
    run: Run, fmus: dict[str, str], name: str, variable: str, value: str
) -> None:
    before = ["set", {variable: float(value)}]
    outcome = run(fmus[name], *START, before, ["step", 0], ["set", {variable: 0.0}], ["step", 0])
    assert outcome["results"][4] == DISCARD
    assert outcome["text"] == f"t = 0 s: input {variable} = {value} is not finite"
    assert outcome["results"][-1] == OK  # nothing has happened, so it may go on


def test_an_input_out_of_range_is_clamped_with_one_warning(run: Run, fmus: dict[str, str]) -> None:
    steps = [["set", {"ctrl[8]": 300.0, "push_force[1]": -2e3}], ["step", 0], ["step", 1]]
    outcome = run(fmus["plant"], *START, *steps, ["get", "ctrl[8]", "push_force[1]"])
    assert outcome["results"][4:6] == [OK, OK]
    assert outcome["results"][-1] == [255.0, -1000.0]
    kinds = [kind for _, kind, _ in outcome["log"]]
    assert kinds == ["logStatusWarning"] * 2
    assert "input ctrl[8] = 300 is out of range [0, 255] and is clamped" in outcome["text"]


def test_zeros_for_all_inputs_are_survived(run: Run, fmus: dict[str, str]) -> None:
    outcome = run(fmus["controller"], *START, ["zero"], ["step", 0], ["step", 1], ["outputs"])
    assert outcome["results"][4:6] == [OK, OK]
    assert all(abs(x) < 1e3 for x in outcome["results"][-1])
    assert "input quat_cmd is zero; the last valid one is kept" in outcome["text"]


def test_a_zero_quaternion_keeps_the_last_valid_one(run: Run, fmus: dict[str, str]) -> None:
    names = [f"quat_cmd[{i}]" for i in (1, 2, 3, 4)]
    valid = dict(zip(names, (0.5, 0.5, 0.5, 0.5), strict=True))
    steps = [["set", valid], ["step", 0], ["set", dict.fromkeys(names, 0.0)], ["step", 1]]
    outcome = run(fmus["controller"], *START, *steps, ["get", *names])
    assert outcome["results"][-1] == [0.5] * 4


@pytest.mark.parametrize("size", [0.0015, 0.0, -0.001, 1e-4, float("nan"), float("inf")])
@pytest.mark.parametrize("name", NAMES)
def test_a_step_that_is_no_multiple_is_refused(
    run: Run, fmus: dict[str, str], name: str, size: float
) -> None:
    outcome = run(fmus[name], *START, ["step", 0, size], ["step", 0])
    assert outcome["results"][3:] == [DISCARD, OK]
    assert "must be a whole multiple of 0.001 s" in outcome["text"]
    assert outcome["log"][0][1] == "logStatusDiscard"


@pytest.mark.parametrize("name", NAMES)
def test_one_step_of_5_ms_is_five_of_1_ms(fmus: dict[str, str], name: str) -> None:
    coarse, fine = in_process(fmu_jobs.substeps, fmus[name])
    assert coarse == fine


def test_diverging_physics_is_an_error_with_time_and_cause(
    run: Run, fmus: dict[str, str], tmp_path: Path
) -> None:
    push = [["set", {"push_force[1]": 1e3}], ["far"], ["step", 0], ["step", 1], ["step", 2]]
    outcome = run(fmus["plant"], *START, *push, cwd=tmp_path)
    assert DISCARD in outcome["results"]
    assert "the physics diverged at t = 0.00" in outcome["text"]
    assert outcome["files"] == []  # no MUJOCO_LOG.TXT


@pytest.mark.parametrize(
    ("name", "values", "told"),
    [
        ("plant", {"block_mass": 0.3}, "block_mass is a fixed parameter"),
        ("plant", {"scene": "tutorial"}, "scene is a fixed parameter"),
        ("plant", {"qpos[1]": 0.3}, "qpos[1] cannot be set: it is an output"),
        ("controller", {"period": 0.002}, "period is a fixed parameter"),
    ],
)
def test_what_cannot_be_set_any_more_is_refused_by_name(
    run: Run, fmus: dict[str, str], name: str, values: dict[str, Any], told: str
) -> None:
    outcome = run(fmus[name], *START, ["step", 0], ["set", values], ["step", 1])
    assert outcome["results"][3] == OK
    assert outcome["results"][-1] == DISCARD
    assert told in outcome["text"]


def test_a_fixed_parameter_may_be_set_again_to_what_it_is(run: Run, fmus: dict[str, str]) -> None:
    same = ["set", {"block_mass": 0.18, "scene": "tabletop"}]
    outcome = run(fmus["plant"], *START, ["step", 0], same, ["step", 1])
    assert (outcome["results"][-1], outcome["log"]) == (OK, [])


def test_a_tunable_parameter_may_be_set_between_steps(run: Run, fmus: dict[str, str]) -> None:
    change = ["set", {"kp[1]": 20.0, "use_reference": False}]
    outcome = run(fmus["controller"], *START, ["step", 0], change, ["step", 1], ["get", "kp[1]"])
    assert outcome["results"][-2:] == [OK, [20.0]]
    assert outcome["log"] == []


@pytest.mark.parametrize("kind", ["Real", "Integer", "Boolean", "String"])
@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_value_reference_is_named(
    run: Run, fmus: dict[str, str], name: str, kind: str
) -> None:
    outcome = run(fmus[name], *START, [f"get{kind}", [4711]], ["step", 0])
    assert outcome["results"][-1] == DISCARD
    assert f"fmi2Get{kind}: value reference 4711 is not that of" in outcome["text"]


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ([["step", 0]], "it has not been initialized"),
        ([["setupExperiment"], ["enterInitializationMode"], ["step", 0]], "not been initialized"),
        ([["exitInitializationMode"], ["step", 0]], ORDER),
        ([*START, ["enterInitializationMode"], ["step", 0]], ORDER),
        ([*START, ["terminate"], ["step", 0]], "it has been terminated"),
        ([*START, ["terminate"], ["zero"], ["step", 0]], "cannot be set: it has been terminated"),
        ([*START, ["terminate"], ["terminate"], ["step", 0]], "has been terminated before"),
    ],
)
@pytest.mark.parametrize("name", NAMES)
def test_calls_out_of_order_are_refused(
    run: Run, fmus: dict[str, str], name: str, script: list[list[Any]], told: str
) -> None:
    outcome = run(fmus[name], *script)
    assert outcome["results"][-1] == DISCARD
    assert told in outcome["text"]


def test_text_that_is_not_utf8_is_refused(run: Run, fmus: dict[str, str]) -> None:
    outcome = run(fmus["plant"], ["setupExperiment"], ["set_bytes", 0, "ff"], *START[1:],
                  ["step", 0])  # fmt: skip
    assert outcome["results"][-1] == DISCARD
    assert "fmi2SetString: text is not UTF-8" in outcome["text"]


@pytest.mark.parametrize(
    ("name", "values"), [("plant", {"block_mass": 0.4, "scene": "tutorial"}), ("controller", {})]
)
def test_reset_makes_an_instance_new(
    fmus: dict[str, str], name: str, values: dict[str, Any]
) -> None:
    used, fresh = in_process(fmu_jobs.reset, fmus[name], values)
    assert used == fresh


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("plant", {"block_mass": 0.4, "block_friction": 0.5, "scene": "tutorial"}),
        ("controller", {"kp[2]": 3.0, "ki[2]": 1.0, "kd[3]": 0.01, "period": 0.002}),
    ],
)
def test_a_restored_state_replays_bit_for_bit_also_elsewhere(
    fmus: dict[str, str], name: str, values: dict[str, Any], tmp_path: Path
) -> None:
    assert in_process(fmu_jobs.replay, fmus[name], values, str(tmp_path)) == 50
    assert in_process(fmu_jobs.replay_elsewhere, fmus[name], str(tmp_path)) == 50


@pytest.mark.parametrize("name", NAMES)
def test_a_state_that_is_not_one_is_refused(run: Run, fmus: dict[str, str], name: str) -> None:
    for data in ("", "00", "50435332ffffffff", "50435332020000007b7d"):
        outcome = run(fmus[name], *START, ["restore", data], ["step", 0])
        assert outcome["results"][-1] == DISCARD
        assert "fmi2SetFMUstate: the state is" in outcome["text"]


@pytest.mark.parametrize("name", NAMES)
def test_ten_instances_do_not_disturb_each_other(fmus: dict[str, str], name: str) -> None:
    assert in_process(fmu_jobs.interleave, fmus[name])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [120, pytest.param(2000, marks=pytest.mark.long)])
def test_instances_leave_nothing_behind(
    fmus: dict[str, str], name: str, count: int, tmp_path: Path
) -> None:
    grown = in_process(fmu_jobs.cycles, fmus[name], count, TMPDIR=str(tmp_path))
    assert (grown["files"], grown["paths"], grown["folders"]) == (0, 0, [])
    assert grown["kilobytes"] < MEMORY_NOISE + MEMORY_BOUND * count
