"""Planted faults are told from the signals alone, and what is no fault is not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from panda_cosim.scenarios.compare.compare import Comparison, compare_with_reference
from panda_cosim.scenarios.compare.guards import all_columns
from panda_cosim.scenarios.compare.reference import Reference, reference_path
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.scenario.scenario import load_scenario
from regress_support import record

pytestmark = pytest.mark.fmu

MARGIN = 3.0  # how far outside its tube the worst signal of a fault is, in tolerances

# What is told by which scenario; and by a signal whose name begins so.
PHYSICAL = [
    ("weaker_gain", "push", "controller.dq"),
    ("one_tick_of_delay", "push", "controller."),
    ("gripper_late", "heavy_block", "plant.qpos"),
    ("heavier_block", "heavy_block", "controller.dq"),
    ("without_gravity_feedforward_2", "push", "controller.dq[2]"),
    ("without_inertia_feedforward_1", "push", "controller.dq[1]"),
    ("without_servo_lag_7", "push", "controller.dq[7]"),
]
HARMLESS = [("as_it_is", "push"), ("another_build", "push")]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[tuple[str, str], Future[Path]]]:
    """Run all of them, two at a time."""
    out = tmp_path_factory.mktemp("faults")
    jobs = [(fault, name) for fault, name, *_ in (*PHYSICAL, *HARMLESS)]

    def run(fault: str, name: str) -> Path:
        script = str(Path(__file__).with_name("regress_jobs.py"))
        folder = out / f"{name}-{fault}"
        command = [sys.executable, script, name, fault, str(folder)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        child = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=300
        )
        assert child.returncode == 0, child.stderr
        return folder

    with ThreadPoolExecutor(2) as pool:
        yield {job: pool.submit(run, *job) for job in jobs}


def judged(name: str, recording: Recording, summary: dict[str, Any]) -> Comparison:
    scenario = load_scenario(name)
    reference = Reference.read(reference_path(scenario))
    return compare_with_reference(recording, summary, reference, scenario.regression)


def summary_of(folder: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return summary


@pytest.mark.parametrize(("fault", "name", "signal"), PHYSICAL, ids=[f[0] for f in PHYSICAL])
def test_a_fault_in_the_loop_is_reported(
    runs: dict[tuple[str, str], Future[Path]], fault: str, name: str, signal: str
) -> None:
    folder = runs[fault, name].result()
    # The commands are what they were: it is what comes of them that tells.
    comparison = judged(name, Recording.open(folder), summary_of(folder))
    answers = [d for d in comparison.deviations if "_cmd" not in d.name]
    assert answers[0].share > MARGIN
    assert answers[0].name.startswith(signal)
    assert comparison.problems[-1].kind == "tube"


@pytest.mark.parametrize(("fault", "name"), HARMLESS, ids=[f[0] for f in HARMLESS])
def test_what_is_not_a_fault_is_not_reported(
    runs: dict[tuple[str, str], Future[Path]], fault: str, name: str
) -> None:
    folder = runs[fault, name].result()
    comparison = judged(name, Recording.open(folder), summary_of(folder))
    assert comparison.ok, comparison.problems
    if fault == "another_build":
        reference = Reference.read(reference_path(load_scenario(name)))
        fmus = Recording.open(folder).metadata["fmus"]
        assert fmus["controller"]["guid"] != reference.metadata["fmus"]["controller"]["guid"]


def poison(values: dict[str, Any]) -> None:
    values["plant.qvel[3]"][1234] = np.nan


def cut(values: dict[str, Any]) -> None:
    for name in values:
        values[name] = values[name][: len(values[name]) // 2]


def lose(values: dict[str, Any]) -> None:
    del values["plant.contact_force"]


def rename(values: dict[str, Any]) -> None:
    values["plant.finger_force"] = values.pop("plant.contact_force")


def repeat(values: dict[str, Any]) -> None:
    values["time"][500] = values["time"][499]


SPOILED: list[tuple[Callable[[dict[str, Any]], None], str]] = [
    (poison, "plant.qvel[3] is nan at 1.234 s"),
    (cut, "the reference from 0 to"),
    (lose, "plant.contact_force is missing"),
    (rename, "plant.finger_force is new"),
    (repeat, "time repeats: 0.499000000 s"),
]


@pytest.mark.parametrize(("spoil", "told"), SPOILED, ids=[s[0].__name__ for s in SPOILED])
def test_a_spoiled_recording_is_reported(
    runs: dict[tuple[str, str], Future[Path]],
    tmp_path: Path,
    spoil: Callable[[dict[str, Any]], None],
    told: str,
) -> None:
    folder = runs["as_it_is", "push"].result()
    good = Recording.open(folder)
    values = all_columns(good)
    spoil(values)
    spoiled = record(tmp_path / "spoiled", values, good.units, good.metadata)
    comparison = judged("push", spoiled, summary_of(folder))
    assert any(told in problem.text for problem in comparison.problems), comparison.problems
