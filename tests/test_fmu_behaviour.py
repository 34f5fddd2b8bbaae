"""How an FMU behaves: its values, its steps, its errors, its states, many times over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmu_jobs
import pytest
from fmu_support import ERROR, OK, Worker, in_process
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.sources.targets import Kind, Target, build, build_fmu

NAMES = tuple(INTERFACES)
pytestmark = pytest.mark.fmu
START = [["setupExperiment"], ["enterInitializationMode"], ["exitInitializationMode"]]
MEMORY_BOUND = 3.0  # [kB] that an instance may leave behind, on average
MEMORY_NOISE = 8000.0  # [kB] by which resident memory goes up and down


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


def test_an_impossible_value_is_reported_and_may_be_put_right(
    run: Run, fmus: dict[str, str]
) -> None:
    script = [["setupExperiment"], ["set", {"block_mass": -1.0}], ["enterInitializationMode"]]
    wrong = run(fmus["plant"], *script, ["exitInitializationMode"], ["step", 0])
    assert wrong["results"][1] == ERROR
    assert "block_mass" in wrong["text"]
    assert wrong["results"][-1] == OK  # a refused value changes nothing
    inside = {"block_pos[1]": 0.0, "block_pos[2]": 0.0}  # of the arm's base
    script[1] = ["set", inside]
    assert ERROR in run(fmus["plant"], *script, ["exitInitializationMode"])["results"]


@pytest.mark.parametrize("number", [0, 5, -1])
@pytest.mark.parametrize("kind", ["native", "python"])
def test_a_number_that_no_item_of_an_enumeration_has_is_refused(
    run: Run, kind: Kind, number: int
) -> None:
    plant = str(build(("plant",), target=Target(kind))["plant"])
    outcome = run(plant, START[0], ["set", {"scene": number}], *START[1:], ["step", 0])
    assert outcome["results"][1] == ERROR
    assert outcome["results"][-1] == OK  # a refused value changes nothing
    assert f"scene = {number} is out of range [1, 4]" in outcome["text"]


def test_an_exception_inside_is_logged_with_cause_and_traceback(run: Run, tmp_path: Path) -> None:
    broken = _changed_plant(tmp_path, b'raise ZeroDivisionError("100% broken")')
    outcome = run(broken, *START, ["step", 0], ["step", 1], ["get", "qpos[1]"])
    assert outcome["results"][3:5] == [ERROR, ERROR]
    (_, category, first), *_ = outcome["log"]
    assert "ZeroDivisionError: 100% broken" in first
    assert "Traceback" in first
    assert "in advance" in first
    assert category == "logStatusError"
    assert "in the error state after an earlier failure" in outcome["text"]


def _changed_plant(folder: Path, step: bytes) -> str:
    """Package a plant that does something else in place of a step."""
    from panda_cosim.fmus.sources.targets import own_code, own_fmu  # noqa: PLC0415 - only here

    file = "fmus/inside/plant.py"
    slave = own_code("plant")[file]
    call = b"self._plant.step(count)"
    assert slave.count(call) == 1
    fmu = own_fmu("plant", in_python=True, changed={file: slave.replace(call, step)})
    return str(build_fmu(fmu, folder / "changed.fmu"))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(("name", "variable"), [("plant", "ctrl[3]"), ("controller", "jac[2,5]")])
def test_an_input_that_is_not_finite_is_refused_by_name(
    run: Run, fmus: dict[str, str], name: str, variable: str, value: str
) -> None:
    before = ["set", {variable: float(value)}]
    outcome = run(fmus[name], *START, before, ["step", 0], ["set", {variable: 0.0}], ["step", 0])
    assert outcome["results"][4] == ERROR
    assert f"input {variable}" in outcome["text"]
    assert "not finite" in outcome["text"]
    assert outcome["results"][-1] == OK  # nothing has happened, so it may go on


def test_an_input_out_of_range_is_clamped_with_one_warning(run: Run, fmus: dict[str, str]) -> None:
    steps = [["set", {"ctrl[8]": 300.0, "push_force[1]": -2e3}], ["step", 0], ["step", 1]]
    outcome = run(fmus["plant"], *START, *steps, ["get", "ctrl[8]", "push_force[1]"])
    assert outcome["results"][4:6] == [OK, OK]
    assert outcome["results"][-1] == [255.0, -1000.0]
    kinds = [kind for _, kind, _ in outcome["log"]]
    assert kinds == ["logStatusWarning"] * 2
    assert "ctrl[8]" in outcome["text"]
    assert "clamped" in outcome["text"]


def test_zeros_for_all_inputs_are_survived(run: Run, fmus: dict[str, str]) -> None:
    outcome = run(fmus["controller"], *START, ["zero"], ["step", 0], ["step", 1], ["outputs"])
    assert outcome["results"][4:6] == [OK, OK]
    assert all(abs(x) < 1e3 for x in outcome["results"][-1])
    assert "input quat_cmd is zero; the last valid one is used" in outcome["text"]


@pytest.mark.parametrize("size", [-0.001, float("nan"), float("inf")])
@pytest.mark.parametrize("name", NAMES)
def test_a_step_that_has_no_length_is_refused(
    run: Run, fmus: dict[str, str], name: str, size: float
) -> None:
    outcome = run(fmus[name], *START, ["step", 0, size], ["step", 0])
    assert outcome["results"][3:] == [ERROR, OK]
    assert outcome["log"][0][1] == "logStatusError"


@pytest.mark.parametrize("name", NAMES)
def test_one_step_of_5_ms_is_five_of_1_ms(fmus: dict[str, str], name: str) -> None:
    coarse, fine = in_process(fmu_jobs.substeps, fmus[name])
    assert coarse == fine


def test_diverging_physics_is_an_error_with_time_and_cause(run: Run, tmp_path: Path) -> None:
    fast = b"self._plant.data.qvel[:] = 1e9; self._plant.step(count)"
    work = tmp_path / "work"
    work.mkdir()
    outcome = run(_changed_plant(tmp_path, fast), *START, ["step", 0], ["step", 1], cwd=work)
    assert outcome["results"][-1] == ERROR
    assert "the physics diverged at t = 0.00" in outcome["text"]
    assert outcome["files"] == []  # no MUJOCO_LOG.TXT


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("plant", {"block_mass": 0.3}),
        ("plant", {"scene": "tutorial"}),
        ("plant", {"qpos[1]": 0.3}),
        ("controller", {"period": 0.002}),
    ],
)
def test_what_cannot_be_set_any_more_is_refused_by_name(
    run: Run, fmus: dict[str, str], name: str, values: dict[str, Any]
) -> None:
    outcome = run(fmus[name], *START, ["step", 0], ["set", values], ["step", 1])
    assert outcome["results"][3:] == [OK, ERROR, OK]
    (name,) = (n.partition("[")[0] for n in values)
    assert name in outcome["text"]


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
    assert outcome["results"][3:] == [ERROR, OK]
    assert f"fmi2Get{kind}: " in outcome["text"]
    assert "4711" in outcome["text"]


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ([["step", 0]], "not initialized"),
        ([["setupExperiment"], ["enterInitializationMode"], ["step", 0]], "initialization mode"),
        ([["exitInitializationMode"]], "not initialized"),
        ([*START, ["enterInitializationMode"]], "the instance is initialized"),
        ([*START, ["terminate"], ["step", 0]], "the instance is terminated"),
        ([*START, ["terminate"], ["zero"]], "the instance is terminated"),
        ([*START, ["terminate"], ["terminate"]], "the instance is terminated"),
    ],
)
@pytest.mark.parametrize("name", NAMES)
def test_calls_out_of_order_are_refused(
    run: Run, fmus: dict[str, str], name: str, script: list[list[Any]], told: str
) -> None:
    outcome = run(fmus[name], *script)
    assert outcome["results"][-1] == ERROR
    assert told in outcome["text"]


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
def test_bytes_that_are_not_a_state_are_refused(run: Run, fmus: dict[str, str], name: str) -> None:
    for data in ("00", "50435332020000007b7d" * 40):
        outcome = run(fmus[name], *START, ["restore", data], ["step", 0])
        assert outcome["results"][-2:] == [ERROR, OK]
        assert "the state cannot be used" in outcome["text"]


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
