"""The FMU that plays a table."""

import re

import numpy as np
import pytest

from fmu_instance import OK, STEP, Instance, Unpacked
from panda_cosim.fmus.inside.trajectory import NAMES
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Target, build_trajectory
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.task.rotations import Array
from panda_cosim.task.scenario import load_scenario
from panda_cosim.task.writer import write_input_csv

LENGTH = 300  # [tick] that are played
pytestmark = pytest.mark.own_process


@pytest.fixture(scope="module")
def commands():
    scenario = load_scenario("pick_and_place")
    return resolve(scenario, start_values(scenario)).sample(instants(scenario))


@pytest.fixture(scope="module", params=("native", "python"))
def target(request):
    return Target(request.param)


def player(commands: Array, target: Target) -> Instance:
    """An instance that plays commands."""
    return Instance(Unpacked(Fmu(build_trajectory(commands, target=target)).folder))


def played(it: Instance, count: int, ticks: int = 1, start: int = 0) -> list[list[float]]:
    """Outputs at the start [tick] and after each of some steps [ticks]."""
    rows = [it.start(start_time=start * STEP).outputs()]
    for i in range(count):
        assert it.step((start + i * ticks) * STEP, ticks * STEP) == OK, it.messages()
        rows.append(it.outputs())
    return rows


def test_at_each_instant_it_gives_the_commands_of_that_instant(commands, target):
    assert played(player(commands, target), LENGTH) == commands[: LENGTH + 1].tolist()
    longer_and_later = played(player(commands, target), 20, 5, 1000)
    assert longer_and_later == commands[1000:1101:5].tolist()


def test_after_the_last_row_the_commands_stay(commands, target):
    rows = played(player(commands[:3], target), 4)
    assert rows == [*commands[:3].tolist(), *[commands[2].tolist()] * 2]


def test_it_plays_the_file_that_inputs_writes(commands, tmp_path):
    file, other = tmp_path / "other.csv", commands[500:520]
    write_input_csv(file, np.arange(20) * STEP, other)
    it = player(commands, Target("python"))
    it.set("table", str(file).encode())
    assert played(it, 19) == other.tolist()


HEADER = ",".join(("time", *NAMES)) + "\n"


@pytest.mark.parametrize(("text", "told"), [
    (None, "cannot be"),
    ("time,x\n0,1\n", "line 1: .*columns"),
    (HEADER + ",".join(["0"] * 14 + ["nan"]), "15 finite numbers"),
    (HEADER + ",".join(["0.5"] * 15), "15 finite numbers per 0.001 s"),
    (HEADER + ",".join(["x"] * 15), "cannot be read"),
])  # fmt: skip
def test_a_file_that_is_no_table_is_refused(commands, text, told, tmp_path):
    file = tmp_path / "bad.csv"
    if text is not None:
        file.write_text(text)
    it = player(commands, Target("python"))
    it.set("table", str(file).encode())
    with pytest.raises(AssertionError, match=f"{re.escape(str(file))}.*({told})"):
        it.start()


def test_a_native_one_plays_only_the_table_that_it_was_built_with(commands):
    it = player(commands, Target("native"))
    it.set("table", b"/some.csv")
    with pytest.raises(AssertionError, match="a native FMU plays only the table that"):
        it.start()
