"""A run's folder: who gets it, what it holds, and that running its copy gives the same bits."""

from __future__ import annotations

import dataclasses
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fault_support import write_scenario
from panda_cosim import Options, Recording, Scenario, load_scenario, run_scenario, shipped_scenarios
from panda_cosim.fmus.errors import InputError
from panda_cosim.run.folder import claimed_folder, default_folder
from panda_cosim.task.criteria import Success
from panda_cosim.task.scenario import Push
from panda_cosim.task.table import TableRow, TrajectoryTable
from panda_cosim.task.tolerances import Tolerances
from panda_cosim.task.writer import make_scenario
from panda_cosim.task.writer import write_scenario as write_files


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.05)


def bits(recording: Recording) -> bytes:
    return b"".join(block.tobytes() for block in recording.blocks())


# --- The copy of what was run ----------------------------------------------------------------

CHANGES: list[dict[str, Any]] = [
    {},
    {"coupling": "jacobi"},
    {"plant.block_mass": 0.3, "plant.block_pos[1]": 0.41},
    {"plant.scene": "tutorial", "controller.kp[3]": 1 / 3, "controller.kp": 7},
    {"controller.use_reference": False, "controller.ki": [0.1] * 7},
]


@pytest.mark.parametrize("values", CHANGES)
def test_running_the_copy_gives_the_same_bits(tmp_path, values):
    made = tmp_path / "lift"
    make_scenario(made)
    text = (made / "scenario.toml").read_text()
    text = text.replace("duration = 3.4 ", "duration = 0.4 ").replace("# [[push]]", "[[push]]")
    text = text.replace("# start = 1.0", "start = 0.1").replace(
        "# duration = 0.1", "duration = 0.1"
    )
    (made / "scenario.toml").write_text(text.replace("# force = [0.0", "force = [0.1"))
    first = run_scenario(made, tmp_path / "first", values=values)
    again = run_scenario(tmp_path / "first" / "scenario", tmp_path / "again")
    assert bits(again.recording) == bits(first.recording)
    assert again.summary.criteria == first.summary.criteria
    texts = [(place / "scenario.toml").read_bytes()
             for place in (made, tmp_path / "first" / "scenario")]  # fmt: skip
    assert (texts[0] == texts[1]) == (not values)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_shipped_scenario_written_anew_reads_back_the_same(tmp_path, name):
    scenario = load_scenario(name)
    write_files(dataclasses.replace(scenario, folder=None), tmp_path / name)
    read = Scenario.read(tmp_path / name)
    same = {"folder": scenario.folder, "inputs": scenario.inputs}  # inputs of the table have a file
    assert dataclasses.replace(read, **same) == scenario


NUMBER = st.floats(-9.0, 9.0)
POSITION = st.tuples(NUMBER, NUMBER, NUMBER)
QUATERNION = st.tuples(NUMBER, NUMBER, NUMBER, st.floats(0.001, 9.0))
TEXT = st.text(st.characters(exclude_categories=["C", "Z"]), max_size=20)
PARAMETER = st.one_of(NUMBER, st.booleans(), TEXT, st.lists(NUMBER, min_size=1, max_size=7))
SECTION = st.dictionaries(st.sampled_from(["kp", "kp[3]", "block mass", "ä", '"', "\\"]), PARAMETER)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    rows = tuple(
        TableRow(
            float(k) / 7,
            draw(st.sampled_from(["world", "home", "target"])),
            draw(POSITION),
            draw(st.floats(0.0, 0.08)),
            draw(st.one_of(st.none(), QUATERNION)),
        )
        for k in range(draw(st.integers(2, 4)))
    )
    return Scenario(
        "name",
        TrajectoryTable(rows),
        draw(st.integers(1, 3_600_000)) * 0.001,
        purpose=draw(TEXT),
        align=draw(st.booleans()),
        plant=draw(SECTION),
        controller=draw(SECTION),
        push=tuple(Push(0.1, 0.2, force) for force in draw(st.lists(POSITION, max_size=2))),
        success=Success(max_tilt=draw(st.one_of(st.none(), st.floats(0.0, 179.0)))),
        regression=Tolerances(values={"plant.qpos[10]": draw(st.floats(1e-9, 1.0))}),
    )


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(scenarios())
def test_any_scenario_written_reads_back_bit_for_bit(tmp_path_factory, scenario):
    folder = tmp_path_factory.mktemp("written") / "name"
    write_files(scenario, folder)
    assert dataclasses.replace(Scenario.read(folder), folder=None) == scenario


# --- Who gets which folder -------------------------------------------------------------------


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "strftime", lambda _: "20260101-000000")
    with ThreadPoolExecutor(16) as pool:
        folders = list(pool.map(default_folder, ["x"] * 64))
    assert len(set(folders)) == 64


def test_a_folder_that_nothing_was_written_to_goes_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with claimed_folder(None, "x") as folder:
        assert folder.is_dir()
    assert not folder.exists()


# --- Runs that end early ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "pythn"}, "kind: value 'pythn'; must be one of auto, native"),
        *(({"time_limit": limit}, r"time_limit: value .* must be a number from 0 to")
          for limit in (-1.0, float("nan"), True, "soon")),
    ],
)  # fmt: skip
def test_an_invalid_option_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        Options(**options)


def test_a_time_limit_ends_a_run_between_two_steps(tmp_path):
    scenario = dataclasses.replace(load_scenario("push"), duration=600.0)
    run = run_scenario(scenario, tmp_path / "run", Options(time_limit=0.3))
    assert not run.summary.complete
    assert run.summary.reason == "stopped by its time limit of 0.3 s of wall time"
    assert run.signal == 0
    assert 0.2 < run.summary.timing["wall_s"] < 5.0
    assert run.recording.rows == run.summary.timing["steps"] + 1


def test_a_run_in_another_thread_is_stopped_by_its_event(tmp_path):
    scenario = dataclasses.replace(load_scenario("push"), duration=600.0)
    stop, seen = threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(
            run_scenario, scenario, tmp_path / "run", progress=lambda *_: seen.set(), stop=stop
        )
        assert seen.wait(60.0)
        stop.set()
        run = running.result(60.0)
    assert run.summary.reason == "stopped by request"
    assert run.recording.rows >= 1
