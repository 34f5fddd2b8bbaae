"""A run's folder: who gets it, what it holds, and that running its copy gives the same bits."""

import dataclasses
import json
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fault_support import write_scenario
from forked import command
from panda_cosim import Options, Scenario, load_scenario, run_scenario, shipped_scenarios
from panda_cosim.fmus.atomic import MARK, check_replaceable
from panda_cosim.fmus.build.ssp import STRUCTURE_FILE, WrittenSystem, structure_description
from panda_cosim.fmus.errors import InputError
from panda_cosim.run.folder import claimed_folder, default_folder
from panda_cosim.study.compare.junit import write_cases
from panda_cosim.task.criteria import Success
from panda_cosim.task.files import marked_json
from panda_cosim.task.mismatch import SIZES, Mismatch
from panda_cosim.task.scenario import Push
from panda_cosim.task.table import TableRow, TrajectoryTable
from panda_cosim.task.tolerances import Tolerances
from panda_cosim.task.writer import write_scenario as write_files
from regress_support import columns, record

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
    push = "[[push]]\nstart = 0.1\nduration = 0.1\nforce = [0.1, 5.0, 0.0]\n"
    made = write_scenario(tmp_path / "short", 0.4, push)
    first = run_scenario(made, tmp_path / "first", values=values)
    again = run_scenario(tmp_path / "first" / "scenario", tmp_path / "again")
    assert again.recording.sha256() == first.recording.sha256()
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


TEXTS = st.lists(TEXT, max_size=2).map(tuple)
FRAMES = st.sampled_from(["world", "home", "target"])
ROWS = st.tuples(FRAMES, POSITION, st.floats(0.0, 0.08), st.none() | QUATERNION)
MISMATCH = st.builds(
    Mismatch,
    preset=st.sampled_from(["nominal", *SIZES]),
    seed=st.integers(0, 9),
    delay=st.sampled_from([0.0, 0.003]),
    joint_offset=st.none() | st.just((0.1, *[0.0] * 6)),
)
SCENARIOS = st.builds(
    Scenario,
    st.just("name"),
    st.lists(ROWS, min_size=2, max_size=4).map(
        lambda rows: TrajectoryTable(tuple(TableRow(k / 7, *row) for k, row in enumerate(rows)))
    ),
    st.integers(1, 3_600_000).map(lambda ticks: ticks * 0.001),
    purpose=TEXT,
    align=st.booleans(),
    mismatch=MISMATCH,
    plant=SECTION,
    controller=SECTION,
    push=st.lists(st.builds(Push, st.just(0.1), st.just(0.2), POSITION), max_size=2).map(tuple),
    not_finite=TEXTS,
    order=TEXTS,
    parameters=st.dictionaries(TEXT.filter(bool), SECTION, max_size=2),
    success=st.builds(Success, max_tilt=st.none() | st.floats(0.0, 179.0)),
    regression=st.floats(1e-9, 1.0).map(lambda most: Tolerances(values={"plant.qpos[10]": most})),
)


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(SCENARIOS)
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
        *(({"time_limit": limit}, "time_limit: value .* must be (a number from 0 to|of type float)")
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


# Commands replace only files that they made, and nothing that is a recording.


SLAVE = Path(__file__).parents[1] / "slaves" / "decay.py"
PAGES = Path(__file__).parents[2] / "src" / "panda_cosim"
MODEL = '<mujoco><worldbody><body><joint/><geom size=".1" mass="1"/></body></worldbody></mujoco>'


def written_by_commands(folder: Path) -> dict[str, tuple[tuple[object, ...], Path]]:
    """Return command lines with a file that each of them would write."""
    run, out = folder / "run", folder / "out"
    return {
        "view beside the run": (("view", run), run / "view.html"),
        "plot": (("plot", run, "--out", out / "a.png"), out / "a.png"),
        "video": (("render", run, "--out", out), out / "video.mp4"),
        "compare": (("compare", run, run, "--out", out), out / "compare.html"),
        "export": (("export", run, out / "a.csv"), out / "a.csv"),
        "inputs": (("inputs", "push", out / "a.csv"), out / "a.csv"),
        "analyze": (("analyze", "--out", out), out / "loops.png"),
        "bench": (("bench", "--json", out / "a.json"), out / "a.json"),
        "report": (("regress", "push", "--report", out), out / "report.html"),
        "junit": (("regress", "push", "--report", out), out / "junit.xml"),
        "junit of a run": (("run", "push", "--junit", out / "a", "--out", folder / "b"), out / "a"),
        "sweep report": (("sweep", "report", folder, "--out", out / "a"), out / "a"),
        "model": (("mjcf2fmu", folder / "m.xml", "--out", out / "m.fmu"), out / "m.fmu"),
        "slave": (("build", "--slave", SLAVE, "--out", out), out / "Decay.fmu"),
        "system": (("build", "--out", out), out / "Panda.ssp"),
        "retime": (("retime", "push", "--out", out), out / "trajectory.csv"),
        "new": (("new", out), out / "trajectory.csv"),
    }


@pytest.mark.parametrize("case", written_by_commands(Path()))
def test_a_file_that_no_command_made_stays(tmp_path, case):
    record(tmp_path / "run", columns(2))
    (tmp_path / "m.xml").write_text(MODEL)
    arguments, file = written_by_commands(tmp_path)[case]
    file.parent.mkdir(exist_ok=True)
    file.write_text("<!DOCTYPE html>\nmine, about panda-cosim")
    before = sorted(tmp_path.rglob("*"))
    done = command(*arguments, cwd=tmp_path, code=2)
    error = done.stderr.splitlines()[-1]
    assert f"{file}: already exists; must be " in error
    assert file.read_text() == "<!DOCTYPE html>\nmine, about panda-cosim"
    assert sorted(tmp_path.rglob("*")) == before


def test_what_was_made_is_replaced_and_so_is_a_file_that_is_given_up(tmp_path):
    run, out = tmp_path / "run", tmp_path / "out"
    record(run, columns())
    for _ in range(2):
        command("plot", run, "--out", out / "x.png", cwd=tmp_path, code=0)
    assert [path.name for path in out.iterdir()] == ["x.png"]
    (out / "x.csv").write_text("mine")
    command("inputs", "push", out / "x.csv", "--overwrite", cwd=tmp_path, code=0)
    assert (out / "x.csv").read_text() != "mine"


def test_no_picture_or_page_takes_the_place_of_a_recording(tmp_path):
    content = record(tmp_path, columns()).path.read_bytes()
    for name in ("view", "plot"):
        place = tmp_path / f"{name}.png"  # a name that plot takes for a file's
        place.write_bytes(content)
        done = command(name, tmp_path, "--out", place, "--overwrite", cwd=tmp_path, code=2)
        assert "holds a recording; must be another file" in done.stderr
        assert place.read_bytes() == content


def test_every_page_carries_the_mark():
    pages = [path for path in PAGES.rglob("*.html") if "<!DOCTYPE" in path.read_text()]
    assert pages
    for page in pages:
        assert f"<!-- {MARK} -->" in page.read_text(), page


def test_texts_and_archives_that_were_made_here_are_known(tmp_path):
    paths = {name: tmp_path / name for name in ("a.json", "a.xml", "a.ssp", "b.ssp", "c.ssp")}
    paths["a.json"].write_text(marked_json(json.dumps({"kp": 8})))
    write_cases("panda-cosim run", [], paths["a.xml"])
    system = structure_description(WrittenSystem({}, (), 1.0))
    others = {"b.ssp": system.replace(b"panda-cosim", b"another"), "c.ssp": MARK.encode()}
    for name, description in {"a.ssp": system, **others}.items():
        with zipfile.ZipFile(paths[name], "w") as archive:
            archive.writestr(STRUCTURE_FILE, description)
    check_replaceable(paths["a.json"], paths["a.xml"], paths["a.ssp"])
    for name in others:
        with pytest.raises(InputError, match="already exists"):
            check_replaceable(paths[name], overwrite=False)
    broken = paths["a.ssp"].read_bytes()[:-30]
    paths["a.ssp"].write_bytes(broken)
    with pytest.raises(InputError, match="already exists"):
        check_replaceable(paths["a.ssp"])
