"""The FMU that plays a table."""

from __future__ import annotations

import re
from pathlib import Path

import fmu_jobs
import numpy as np
import pytest
from fmu_support import Worker
from numpy.typing import NDArray
from panda_cosim.fmus.inside.trajectory import HOME, NAMES
from panda_cosim.fmus.interface.controller import COMMANDS, CONTROLLER
from panda_cosim.fmus.interface.trajectory import TRAJECTORY
from panda_cosim.fmus.sources.targets import Target, build_trajectory
from panda_cosim.scenarios.run.start import instants, resolve, start_values
from panda_cosim.scenarios.scenario.scenario import load_scenario
from panda_cosim.scenarios.scenario.writer import write_input_csv

Array = NDArray[np.float64]
LENGTH = 300  # [tick] that are played


@pytest.fixture(scope="module")
def commands() -> Array:
    scenario = load_scenario("pick_and_place")
    return resolve(scenario, start_values(scenario)).sample(instants(scenario))


@pytest.fixture(scope="module", params=("native", "python"))
def target(request: pytest.FixtureRequest) -> Target:
    return Target(request.param)


@pytest.fixture(scope="module")
def path(commands: Array, target: Target) -> str:
    return str(build_trajectory(commands, target=target))


@pytest.fixture(scope="module")
def in_python(commands: Array) -> str:
    """The kind that reads CSV files."""
    return str(build_trajectory(commands, target=Target("python")))


def test_its_outputs_are_the_controllers_command_inputs() -> None:
    assert [v.name for v in TRAJECTORY.of("output")] == list(COMMANDS)
    for name in COMMANDS:
        given, taken = TRAJECTORY.variable(name), CONTROLLER.variable(name)
        assert (given.shape, given.unit, given.description) == (
            taken.shape, taken.unit, taken.description,
        )  # fmt: skip


@pytest.mark.fmu
def test_at_each_instant_it_gives_the_commands_of_that_instant(
    worker: Worker, path: str, commands: Array
) -> None:
    assert worker.do(fmu_jobs.played, path, LENGTH, 1) == commands[: LENGTH + 1].tolist()


@pytest.mark.fmu
def test_longer_steps_and_later_starts_give_the_same_commands(
    worker: Worker, path: str, commands: Array
) -> None:
    rows = worker.do(fmu_jobs.played, path, 20, 5, "", 1000)
    assert rows == commands[1000:1101:5].tolist()


@pytest.mark.fmu
def test_after_the_last_row_the_commands_stay(
    worker: Worker, commands: Array, target: Target, tmp_path: Path
) -> None:
    short = build_trajectory(commands[:3], tmp_path / "short.fmu", target)
    rows = worker.do(fmu_jobs.played, str(short), 4, 1)
    assert rows == [*commands[:3].tolist(), *[commands[2].tolist()] * 2]


@pytest.mark.fmu
def test_it_plays_the_file_that_inputs_writes(
    worker: Worker, in_python: str, commands: Array, tmp_path: Path
) -> None:
    file = tmp_path / "other.csv"
    other = commands[500:520]
    write_input_csv(file, np.arange(20) * 0.001, other)
    assert worker.do(fmu_jobs.played, in_python, 19, 1, str(file)) == other.tolist()


@pytest.mark.fmu
@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "cannot be"),
        ("", "line 1: .*columns"),
        ("time,x\n0,1\n", "line 1: .*columns"),
        (",".join(("time", *NAMES)) + "\n", "rows|15 finite numbers"),
        (",".join(("time", *NAMES)) + "\n" + ",".join(["0"] * 14 + ["nan"]), "15 finite numbers"),
        (",".join(("time", *NAMES)) + "\n" + ",".join(["0"] * 14), "rows|15 finite numbers"),
        (",".join(("time", *NAMES)) + "\n" + ",".join(["0.5"] * 15), "line 2: time 0.5 s"),
        (
            ",".join(("time", *NAMES)) + "\n" + ",".join(["x"] * 15),
            "cannot be read|line 2: 15 finite",
        ),
    ],
)
def test_a_file_that_is_no_table_is_refused(
    worker: Worker, in_python: str, text: str | None, told: str, tmp_path: Path
) -> None:
    file = tmp_path / "bad.csv"
    if text is not None:
        file.write_text(text)
    refused, text = worker.do(fmu_jobs.refused, in_python, {"table": str(file)})
    assert refused
    assert str(file) in text
    assert re.search(told, text)


@pytest.mark.fmu
def test_a_native_one_plays_only_the_table_that_it_was_built_with(
    worker: Worker, commands: Array
) -> None:
    native = str(build_trajectory(commands))
    refused, text = worker.do(fmu_jobs.refused, native, {"table": "/some.csv"})
    assert refused
    assert "/some.csv: a native FMU plays only the table that it was built with" in text


@pytest.mark.fmu
def test_its_state_can_be_restored(worker: Worker, path: str, tmp_path: Path) -> None:
    assert worker.do(fmu_jobs.replay, path, {}, str(tmp_path)) == 50


def test_without_a_table_the_hand_stays_at_home() -> None:
    assert len(HOME) == len(NAMES) == 14
