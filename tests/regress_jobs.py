"""Runs a shipped scenario with one planted fault: `regress_jobs.py SCENARIO FAULT FOLDER`."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from panda_cosim import Scenario, load_scenario, run_scenario
from panda_cosim.controller.gains import PRESETS
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.scenario.trajectory import Trajectory

LATE = 0.050  # s
Job = tuple[Scenario, Options]


def as_it_is(scenario: Scenario, _folder: Path) -> Job:
    return scenario, Options()


def weaker_gain(scenario: Scenario, _folder: Path) -> Job:
    kp = tuple(0.95 * gain for gain in PRESETS[scenario.gains].kp)
    return scenario, Options(overrides={"controller": {"kp": kp}})


def one_tick_of_delay(scenario: Scenario, _folder: Path) -> Job:
    return scenario, Options(coupling="jacobi")


def gripper_late(scenario: Scenario, _folder: Path) -> Job:
    in_time = Trajectory.sample

    def late(self: Trajectory, times: Any) -> Any:
        commands = in_time(self, times)
        commands[:, 13] = in_time(self, np.asarray(times) - LATE)[:, 13]
        return commands

    Trajectory.sample = late  # type: ignore[method-assign]
    return scenario, Options()


def heavier_block(scenario: Scenario, _folder: Path) -> Job:
    mass = float(scenario.plant.get("block_mass", 0.18))  # type: ignore[arg-type]
    return scenario, Options(overrides={"plant": {"block_mass": 1.2 * mass}})


def without(name: str) -> Callable[[Scenario, Path], Job]:
    def job(scenario: Scenario, _folder: Path) -> Job:
        return scenario, Options(overrides={"controller": {name: 0.0}})

    return job


def another_build(scenario: Scenario, folder: Path) -> Job:
    """The same FMUs with other GUIDs, as if built anew."""
    scenario = replace(scenario, purpose="Another comment")
    return scenario, Options(fmus={name: _rebuilt(p, folder) for name, p in build().items()})


def _rebuilt(fmu: Path, folder: Path) -> Path:
    new = folder.with_name(f"{folder.name}-{fmu.name}")
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as archive:
        guid = old.read("modelDescription.xml").partition(b'guid="')[2].partition(b'"')[0]
        for name in old.namelist():
            content = old.read(name)
            if name in ("modelDescription.xml", "resources/variables.txt"):
                content = content.replace(guid, b"{anew}")
            archive.writestr(name, content)
    return new


FAULTS = {
    "as_it_is": as_it_is,
    "weaker_gain": weaker_gain,
    "one_tick_of_delay": one_tick_of_delay,
    "gripper_late": gripper_late,
    "heavier_block": heavier_block,
    "another_build": another_build,
    **{
        f"without_{name}_{joint}": without(f"{name}[{joint}]")
        for name in ("gravity_feedforward", "inertia_feedforward", "servo_lag")
        for joint in range(1, 8)
    },
}

if __name__ == "__main__":
    target = Path(sys.argv[3])
    chosen, options = FAULTS[sys.argv[2]](load_scenario(sys.argv[1]), target)
    run_scenario(chosen, target, options)
