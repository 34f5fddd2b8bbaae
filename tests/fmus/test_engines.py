"""Other versions of MuJoCo: in FMUs, in runs, sweeps and suites, and what counts as a change."""

import json
import os
import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from bounded import ran
from fmu_support import members
from forked import command as cli
from panda_cosim import Recording, Scenario, load_scenario
from panda_cosim.fmus.atomic import cache_folder
from panda_cosim.fmus.build.engines import made_with
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.run.execution import run_scenario
from panda_cosim.run.options import Options
from panda_cosim.run.prepare import prepare
from panda_cosim.study.compare.against_reference import compare_with_reference
from panda_cosim.study.compare.engines import changed_pairs, difference_of, engine_row, touching
from panda_cosim.study.compare.outcome import Outcome
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.sweep.definition import sweep_of
from panda_cosim.study.sweep.sweeping import sweep
from panda_cosim.task.tolerances import Tolerances
from regress_support import CONTENT, SUMMARY, columns, record

ENGINE = "3.11.0"
HERE = mujoco.__version__
ARM = """<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body pos="0 0 .5"><joint name="a" axis="0 1 0" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      <body pos=".3 0 0"><joint name="b" axis="0 1 .3" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body></body>
  </worldbody>
  <actuator><motor joint="a" gear="3"/><motor joint="b"/></actuator>
</mujoco>
"""
CTRL = (0.7, -0.3)
SCENARIO = f"""purpose = "An arm falls on the floor"
duration = 1.0
step = 0.002
[fmus]
plant = "model.xml"
[inputs]
"plant.ctrl" = [{CTRL[0]}, {CTRL[1]}]
"""
# The same in MuJoCo alone; prints qpos as hex. Arguments: model, factor on ctrl.
ALONE = f"""
import sys, mujoco, numpy as np
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
rows = [data.qpos.copy()]
for _ in range(500):
    data.ctrl[:] = np.array({CTRL}) * float(sys.argv[2])
    mujoco.mj_step(model, data)
    rows.append(data.qpos.copy())
print(mujoco.__version__, np.array(rows).tobytes().hex())
"""


@pytest.fixture(scope="module")
def engine():
    """Return the folder of another version of MuJoCo."""
    try:
        made_with(ENGINE, bytes)
    except CosimError as error:
        pytest.skip(str(error))
    return next((cache_folder() / "engines").glob(f"{ENGINE}-*"))


@pytest.fixture
def arm(tmp_path):
    """Return the folder of a scenario of a model that is not ours."""
    folder = tmp_path / "suite" / "arm"
    folder.mkdir(parents=True)
    (folder / "model.xml").write_text(ARM)
    (folder / "scenario.toml").write_text(SCENARIO)
    return folder


def python(*arguments: object, path: Path | None = None) -> str:
    environment = {**os.environ, **({"PYTHONPATH": str(path)} if path else {})}
    command = [sys.executable, "-c", *map(str, arguments)]
    done = ran(command, env=environment)
    return done.stdout.strip()


def qpos(run: Path) -> np.ndarray:
    return np.asarray(Recording.open(run)["plant.qpos"])


# What only reads.


def test_check_and_info_download_no_engine_and_say_so(arm, tmp_path, monkeypatch):
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    text = (arm / "scenario.toml").read_text()
    (arm / "scenario.toml").write_text(f'mujoco = "3.10.0"\n{text}')
    done = cli("check", arm, code=0)
    said = f"mujoco: 3.10.0 is not installed, but would be by a run; checked with {HERE}"
    assert said in " ".join(done.stdout.split())
    assert cli("info", arm).returncode == 0
    assert not (tmp_path / "cache" / "engines").exists()
    done = cli("run", arm, "--no-video", "--out", tmp_path / "run", code=1)
    assert "MuJoCo 3.10.0 cannot be installed" in done.stderr


# FMUs.


def test_an_fmu_holds_the_engine(engine, arm, tmp_path):
    command = ["mjcf2fmu", arm / "model.xml", "--mujoco", ENGINE, "--out", tmp_path / "a.fmu"]
    cli(*command, code=0)
    library = engine / "mujoco" / f"libmujoco.so.{ENGINE}"
    (held,) = (c for name, c in members(tmp_path / "a.fmu").items() if "libmujoco" in name)
    assert held == library.read_bytes()


def test_a_run_has_the_bits_of_its_engine(engine, arm, tmp_path):
    alone, factor = {}, 1.0 + 1e-14
    for version, path in ((HERE, None), (ENGINE, engine)):
        name, bits = python(ALONE, arm / "model.xml", repr(factor), path=path).split()
        assert name == version
        alone[version] = np.frombuffer(bytes.fromhex(bits)).reshape(-1, 2)
        values = {"mujoco": version, "input_scale": factor}
        scenario = load_scenario(arm).changed(values)
        run = run_scenario(scenario, tmp_path / version)
        assert np.array_equal(qpos(run.folder), alone[version])
        assert run.recording.metadata["versions"]["mujoco"] == version
        again = run_scenario(load_scenario(run.folder / "scenario"), tmp_path / f"{version}-again")
        assert again.recording.sha256() == run.recording.sha256()  # the copy says the engine, too
    assert not np.array_equal(alone[HERE], alone[ENGINE])  # else nothing was told apart


# What failed with older versions.


def test_a_short_keyframe_is_filled_with_qpos0_by_every_engine(engine, arm, tmp_path):
    key = '<keyframe><key name="home" qpos=".1 .2"/></keyframe></mujoco>'
    (arm / "arm.xml").write_text(ARM.replace("</mujoco>", key))
    (arm / "model.xml").write_text(
        '<mujoco><include file="arm.xml"/><size nkey="3"/><worldbody><body pos="1 2 .3">'
        '<freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    for version in (HERE, ENGINE):
        scenario = load_scenario(arm).changed({"mujoco": version, "duration": 0.01})
        run = run_scenario(scenario, tmp_path / version)
        assert np.array_equal(qpos(run.folder)[0], [0.1, 0.2, 1.0, 2.0, 0.3, 1, 0, 0, 0])


# Bad input.


@pytest.mark.parametrize("version", ["3.9.0", "3.10", "new", "2.3.7", "../x"])
def test_a_version_that_cannot_be_used_is_refused(version, tmp_path):
    done = cli("run", "push", "--mujoco", version, "--out", tmp_path / "r", code=2)
    assert "mujoco: value" in done.stderr
    assert "must be a version from 3.10.0 on" in done.stderr
    assert not (tmp_path / "r").exists()
    with pytest.raises(InputError, match="mujoco: value"):
        Scenario("x", load_scenario("push").table, 1.0, mujoco=version)


def test_a_key_that_no_fmu_can_follow_is_refused(arm):
    push = load_scenario("push").changed({"mujoco": ENGINE})
    with pytest.raises(InputError, match="FMUs in Python use the installed version"):
        prepare(push, Options(kind="python"))
    (arm / "scenario.toml").write_text("duration = 1.0\nmujoco = '3.11.0'\nsystem = 'a.ssp'\n")
    with pytest.raises(InputError, match="must be left out with system"):
        load_scenario(arm)


# Sweeps and suites.


def test_a_sweep_varies_the_engine(engine, arm, tmp_path):
    definition = sweep_of(arm, [f"mujoco={HERE},{ENGINE}"])
    rows = sweep(definition, tmp_path / "sweep", jobs=1).table.to_pylist()
    digests = {row["mujoco"]: row["recording_sha256"] for row in rows}
    for version in (HERE, ENGINE):
        scenario = load_scenario(arm).changed({"mujoco": version})
        run = run_scenario(scenario, tmp_path / version)
        assert digests[version] == run.recording.sha256()
    assert len({*digests.values()}) == 2


def test_a_folder_with_a_model_is_a_suite_over_engines(engine, arm, tmp_path):
    suite = ["regress", "--scenarios", arm.parent, "-j", "1"]
    assert cli(*suite, "--update", "--yes").returncode == 0
    report = ["--report", tmp_path / "report"]
    done = cli(*suite, "--mujoco", f"{HERE},{ENGINE}", "--json", *report, code=0)
    own, here, other = json.loads(done.stdout)["scenarios"]
    assert [each["name"] for each in (own, here, other)] == ["arm", f"arm-{HERE}", f"arm-{ENGINE}"]
    assert (own["difference"], here["difference"]) == ("", "equal")
    assert other["difference"].startswith("rounding, tick ")
    assert {each["verdict"] for each in (own, here, other)} == {"same"}
    # The first tick, from the recordings of MuJoCo alone.
    bits = [python(ALONE, arm / "model.xml", "1.0", path=p).split()[1] for p in (None, engine)]
    rows = [np.frombuffer(bytes.fromhex(each)).reshape(-1, 2) for each in bits]
    first = int(np.argmax((rows[0] != rows[1]).any(axis=1)))
    told = int(re.findall(r"tick (\d+): plant", other["difference"])[0])
    assert told <= first  # outputs beside qpos may differ before
    assert "rounding, tick" in (tmp_path / "report" / "report.html").read_text()
    assert other["cause"].startswith(f"changed: mujoco {HERE} -> {ENGINE}")
    text = cli(*suite, "--mujoco", ENGINE).stdout
    assert f"MuJoCo of the runs: {ENGINE}, {HERE}; of the references: {HERE}" in text
    assert other["difference"] in text


# What counts as a change.


def test_noise_tells_rounding_from_change(tmp_path):
    rows = len(columns()["time"])
    grown = 1e-13 * np.exp(0.02 * np.arange(rows))  # what noise makes, growing
    own, noisy, signal = columns(), columns(), "plant.qpos[1]"
    noisy[signal] = own[signal] + grown
    recordings = [record(tmp_path / "own", own), record(tmp_path / "noisy", noisy)]

    def told(name: str, start: int, deviation: np.ndarray | float) -> str:
        values = {each: column.copy() for each, column in columns().items()}
        values[signal][start:] += np.broadcast_to(deviation, rows)[start:]
        return difference_of(*recordings, record(tmp_path / name, values), Tolerances())

    assert told("same", 0, 0.0) == "equal"
    assert told("near", 7, 100 * grown) == f"rounding, tick 7: {signal}"
    assert told("far", 9, 1e4 * grown + 1e-9) == f"beyond rounding, tick 9: {signal}"
    # The noise grows beyond a thousandth of a constant 1e-9 later: before, that is a change.
    assert told("early", 30, 1e-9) == f"beyond rounding, tick 30: {signal}"
    late = int(np.argmax(1e3 * np.maximum.accumulate(np.abs(noisy[signal] - own[signal])) > 1e-9))
    assert told("late", late + 1, 1e-9) == f"rounding, tick {late + 1}: {signal}"
    lost = own | {signal: np.where(np.arange(rows) == 3, np.nan, own[signal])}  # in all of them
    same = [record(tmp_path / name, lost) for name in "abc"]
    assert difference_of(*same, Tolerances()) == "equal"
    short = {name: column[:-5] for name, column in columns().items()}
    assert (
        difference_of(*recordings, record(tmp_path / "short", short), Tolerances())
        == f"beyond rounding, tick {rows - 5}: its length"
    )


def test_contacts_that_an_engine_adds_or_takes_away_are_named(tmp_path):
    scenario, runs = load_scenario("push"), []
    for name, bodies in (("own", ["block", "hand"]), ("noisy", []), ("other", ["hand", "table"])):
        record(tmp_path / name, columns())
        contact = {"unwanted": [{"bodies": bodies}]} if bodies else {}
        (tmp_path / name / "summary.json").write_text(json.dumps({**CONTENT, "contact": contact}))
        runs.append(Outcome(scenario, "same", tmp_path / name, 0.0))
    _, other = engine_row(*runs)
    assert other.difference == "equal; block and hand touch no more; hand and table touch"


def test_a_comparison_names_engines_and_the_first_signal_outside(tmp_path):
    versions = {"versions": {"mujoco": "3.12.0"}}
    made = Reference.of(record(tmp_path / "a", columns(), metadata=versions), SUMMARY, Tolerances())
    values = columns()
    values["plant.qpos[1]"][200:] += 1.0  # the worst
    values["controller.dq[2]"][100:] += 1e-5  # the first
    run = record(tmp_path / "b", values, metadata={"versions": {"mujoco": "4.1.0"}})
    comparison = compare_with_reference(run, SUMMARY, made, Tolerances())
    assert comparison.engines == ("4.1.0", "3.12.0")
    assert comparison.first is not None
    assert comparison.first.name == "controller.dq[2]"
    assert comparison.first.first == pytest.approx(0.1)
    same = compare_with_reference(record(tmp_path / "c", columns()), SUMMARY, made, Tolerances())
    assert same.first is None


def test_pairs_of_geoms_are_named_with_the_tick_from_which_an_engine_parts_them(tmp_path):
    turns = np.where([0, 0, 1, 1, 0, 1], np.pi / 2, 0.0)  # of the arm, down to the floor
    qpos = {"plant.qpos[1]": turns, "plant.qpos[2]": 0.0 * turns}
    record(tmp_path, {"time": 0.001 * np.arange(6), **qpos})
    own = touching(tmp_path, mujoco.MjModel.from_xml_string(ARM), "plant")
    pair = "world geom 1 and body 2 geom 1"
    assert own == {pair: [2, 3, 5]}
    for noisy, other, said in (
        ([2, 3, 5], [2, 3, 4, 5], [f"{pair} touch at tick 4"]),
        ([2, 3], [3, 5], [f"{pair} are apart at tick 2"]),
        ([2, 5], [2, 3], []),  # the noise did so before
    ):
        assert changed_pairs(own, {pair: noisy}, {pair: other}) == said
