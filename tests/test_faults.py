"""Planted faults are told from the signals alone, and what is no fault is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_support import members, pack
from panda_cosim import Options, load_scenario, run_scenario
from panda_cosim.controller.presets import DEFAULT
from panda_cosim.fmus.sources.targets import build
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run import guarded
from panda_cosim.study.compare.against_reference import Comparison, compare_with_reference
from panda_cosim.study.compare.reference import Reference, reference_path
from panda_cosim.task.trajectory import Trajectory

MARGIN = 3.0  # how far outside its tube the worst signal of a fault is, in tolerances
LATE = 0.050  # s

# What is changed, the scenario that tells it, and how the name of the worst signal begins.
FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "weaker gain": (
        {"controller.kp": tuple(0.95 * k for k in DEFAULT.kp)},
        "push", "controller.dq",
    ),
    "one tick of delay": ({"coupling": "jacobi"}, "push", "controller."),
    "heavier block": (
        {"plant.block_mass": 1.2 * 0.5}, "heavy_block", "controller.dq"
    ),
    "no feedforward of gravity": (
        {"controller.gravity_feedforward[2]": 0.0}, "push", "controller.dq[2]"
    ),
    "no feedforward of inertia": (
        {"controller.inertia_feedforward[1]": 0.0}, "push", "controller.dq[1]"
    ),
    "no lag of a servo": (
        {"controller.servo_lag[7]": 0.0}, "push", "controller.dq[7]"
    ),
    "late gripper": ({}, "heavy_block", "plant.q"),
}  # fmt: skip


def compared(name: str, out: Path, **how: Any) -> tuple[Comparison, Reference, Any]:
    """Run a shipped scenario and compare it with its reference."""
    scenario = load_scenario(name)
    recording = run_scenario(scenario, out, **how).recording
    reference = Reference.read(reference_path(scenario))
    comparison = compare_with_reference(
        recording, Summary.open(out), reference, scenario.regression
    )
    return comparison, reference, recording


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_the_loop_is_reported(tmp_path, monkeypatch, fault):
    values, name, signal = FAULTS[fault]
    in_time = Trajectory.sample

    def late(self: Trajectory, times: Any) -> Any:
        commands = in_time(self, times)
        commands[:, 13] = in_time(self, np.asarray(times) - LATE)[:, 13]
        return commands

    if fault == "late gripper":
        monkeypatch.setattr(Trajectory, "sample", late)
        monkeypatch.setattr(guarded, "sampled", guarded.sampled.__wrapped__)  # no cache
    comparison, _, _ = compared(name, tmp_path / "run", values=values)
    # The commands are what they were: it is what comes of them that tells.
    answers = [d for d in comparison.deviations if "_cmd" not in d.name]
    assert answers[0].share > MARGIN
    assert answers[0].name.startswith(signal)
    assert " times its tolerance" in comparison.problems[-1]


def rebuilt(fmu: Path, folder: Path) -> Path:
    """The same FMU with another GUID, as if built anew."""
    content = members(fmu)
    guid = content["modelDescription.xml"].partition(b'guid="')[2].partition(b'"')[0]
    for name in ("modelDescription.xml", "resources/variables.txt"):
        content[name] = content[name].replace(guid, b"{anew}")
    return pack(folder / fmu.name, content)


def test_another_build_is_no_fault(tmp_path):
    fmus = {name: rebuilt(path, tmp_path) for name, path in build().items()}
    comparison, reference, recording = compared(
        "push", tmp_path / "run", options=Options(fmus=fmus)
    )
    assert comparison.ok, comparison.problems
    ours, theirs = recording.metadata["fmus"], reference.metadata["fmus"]
    assert ours["controller"]["guid"] != theirs["controller"]["guid"]
