"""Other controllers, plants and systems by name: built, connected, judged, told what is wrong."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_support import in_process
from forked import command
from odd_fmu import odd_ssp
from panda_cosim import InputError, load_scenario
from panda_cosim.fmus.interface.variables import Causality, Interface, Variable
from panda_cosim.fmus.sources.law import read_law
from panda_cosim.run.start import resolve, start_values
from panda_cosim.run.system.assembly import assemble
from panda_cosim.run.system.connector import Connector
from panda_cosim.run.system.parts import Part
from panda_cosim.study.check.diagnosis import check_folder
from panda_cosim.task.writer import make_scenario
from parts_jobs import run_folder, same_bits, write_arm
from toy_fmu import INDICES, toy_fmu

RAMP = """
class Ramp:
    "Rises by one a second"

    def update(self, time, y):
        return time
"""
TOYS = """
duration = 0.05
[fmus]
ramp = "ramp.py:Ramp"
toy = "toy.fmu"
[connect]
"toy.u[1,1]" = "ramp.ctrl"
[[success.signal]]
signal = "toy.y[1,1]"
reduce = "max"
above = 0.1
"""
SSP = """
duration = 0.05
system = "toy.ssp"
[[success.signal]]
signal = "toy.y[1,1]"
reduce = "final"
above = 0.04
"""


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "mine"
    make_scenario(made, ["law"])
    return made


def job(folder: Path, out: Path, values: dict[str, Any] | None = None) -> Any:
    return in_process(run_folder, str(folder), str(out), values or {})


def part(name: str, n: int, unit: str, causality: Causality) -> Part:
    variable = Variable("x", (n,) if n else (), unit, causality, "continuous", "")
    return Part(name, Path(f"{name}.fmu"), Interface(name, "", (variable,)), Path)


@given(st.integers(0, 3), st.integers(0, 3), *[st.sampled_from(["m", "rad", ""])] * 2)
def test_outputs_feed_inputs_of_their_name_size_and_unit_alone(n, m, unit, other):
    parts = [part("arm", n, unit, "output"), part("law", m, other, "input")]
    connector = Connector(parts)
    if n == m and (unit == other or not unit or not other):
        connector.connect_by_name(parts[1], parts[1].interface.variables[0])
        ends = [(c.source[1], c.target[1]) for c in connector.connections]
        assert ends == [(f"x[{i}]", f"x[{i}]") for i in range(1, n + 1)] or ends == [("x", "x")]
        return
    with pytest.raises(
        InputError, match=r"arm\.x \(.* feeds law\.x \(.*must have the same"
    ) as told:
        connector.connect_by_name(parts[1], parts[1].interface.variables[0])
    assert ('[connect] must name elements, such as "law.x' in str(told.value)) == (n != m)
    assert not connector.connections


def test_a_new_law_runs_at_once_and_its_run_can_be_run_again(folder, tmp_path):
    done = job(folder, tmp_path / "run", {"controller.gain": 12.0})
    assert done["summary"]["success"], done["summary"]["criteria"]
    assert done["parameters"]["controller"].items() >= {"gain": 12.0, "lag": 0.1}.items()
    assert "controller.ctrl[8]" in done["columns"]
    assert "controller.omega_cmd[1]" not in done["columns"]  # not taken, so not sent
    again = tmp_path / "again"
    job(tmp_path / "run" / "scenario", again)
    assert in_process(same_bits, str(tmp_path / "run"), str(again))


def test_a_law_is_read_and_checked_without_being_run(folder):
    path = folder / "my_law.py"
    more = "    offsets = (0.0, 0.1)\n    on = True\n\n    def update("
    path.write_text("raise SystemExit(1)\n" + path.read_text().replace("    def update(", more, 1))
    found = read_law(path, "ResolvedRate").parameters
    assert (found["offsets"], found["on"]) == ((0.0, 0.1), True)
    assert [d.level for d in check_folder(folder)] == ["good", "good"]


@pytest.mark.long
def test_rows_that_a_law_is_to_follow_get_the_time_that_the_arm_needs(folder):
    keys = {"table.rows[2].time": 0.2, "timing": "feasible", "duration": 30.0}
    hasty = load_scenario(folder).changed(keys)
    assert resolve(hasty, start_values(hasty)).times[1] > 0.5


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("my_law.py:ResolvedRate", "my_law.py", r"\[fmus\] controller: .*FILE.py:CLASS"),
        ("my_law.py:ResolvedRate", "my_law.py:Resolved", "class: value 'Resolved'; .*ResolvedRate"),
        ("my_law.py:ResolvedRate", "law.txt", r"\[fmus\] controller: value .*must be LAW.py:CLASS"),
        ("# gain", "gian = 1\n# gain", "gian: no such parameter of ResolvedRate; .*gain"),
        ("[controller]", '[connect]\n"plant.ctr" = "controller.ctrl"\n[controller]',
         r"\[connect\] 'plant.ctr': plant .* no input of this name; valid: .*ctrl"),
        ("[controller]", '[connect]\n"plant.ctrl" = "plant.qpos"\n[controller]',
         r"plant.qpos \(16\) \[rad.*feeds plant.ctrl \(8\) \[rad, 1\]; must have the same shape"),
        ("[controller]", '[connect]\n"controller.jac" = "plantt.jac"\n[controller]',
         "no FMU 'plantt'; .*did you mean 'plant'"),
        ("plant.hand_xpos", "plant.hand_xposs", r"\[\[success.signal\]\] 1: .*hand_xposs"),
        ("hand_xpos, hand", "hand_pos, hand", "takes 'hand_pos', which does not exist"),
        ("def update(self, time, ", "def update(self, ", r"must have a method update\(self, time"),
        ("gain = 10.0", "period = 0.0005", "period: start: value 0.0005; must be"),
        ("gain = 10.0", "gain = 1e400", "gain: start: value inf; must be a finite number"),
        ("gain = 10.0", "qpos = 1.0", "two variables have the name .qpos."),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(folder, old, new, message):
    texts = {path: path.read_text() for path in (folder / "scenario.toml", folder / "my_law.py")}
    path = next(path for path, text in texts.items() if old in text)
    path.write_text(texts[path].replace(old, new, 1))
    wrong = [d.text for d in check_folder(folder) if d.level == "wrong"]
    assert len(wrong) == 1
    assert "\n" not in wrong[0]
    assert re.search(message, wrong[0])


def test_a_file_stands_for_our_fmu_of_its_name_alone(tmp_path):
    """The controller that a sweep has built is none for the scenario of a program."""
    scenario = replace(load_scenario("franky_pick"), client=None)
    parts = assemble(scenario, files={"controller": tmp_path, "plant": tmp_path}).parts
    assert {part.name: part.built for part in parts} == {"controller": None, "plant": tmp_path}


def test_a_law_that_fails_ends_the_run_with_its_place(folder, tmp_path):
    path = folder / "my_law.py"
    path.write_text(path.read_text().replace("error = ", "1 / (time < 0.1)\n        error = ", 1))
    done = command("run", folder, "--no-video", "--isolate", "--out", tmp_path / "run", code=1)
    assert "ZeroDivisionError" in done.stderr
    assert "t = 0.1" in done.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["complete"] is False


def test_the_arms_run_is_drawn_with_its_own_model_and_its_scenario_checked(tmp_path):
    arm, run = write_arm(tmp_path / "arm"), tmp_path / "run"
    assert any("PythonFMU slave" in d.text for d in check_folder(arm))
    told = command("info", arm, code=0).stdout
    assert "a step late" in told
    assert "FMUs are stepped in the order controller, plant" in told
    command("run", arm, "--no-video", "--plot", "--isolate", "--out", run, code=0)
    command("view", run, code=0)
    command("render", run, "--size", "64x48", "--fps", 5, code=0)
    assert (run / "plot.png").stat().st_size > 10_000
    files = {path.name for path in run.iterdir()}
    assert {"view.html", "video.mp4", "contact_sheet.png"} <= files
    (run / "scenario" / "plant.mjb").unlink()
    assert "its FMU holds no model" in command("render", run, code=2).stderr


def test_a_damaged_model_is_one_line_at_every_door(tmp_path):
    good, run = tmp_path / "good", tmp_path / "run"
    good.mkdir()
    two = '<body><freejoint/><geom size="1"/></body>' * 2
    (good / "plant.xml").write_text(f"<mujoco><worldbody>{two}</worldbody></mujoco>")
    (good / "scenario.toml").write_text('duration = 0.02\n[fmus]\nplant = "plant.xml"\n')
    done = command("run", good, "--no-video", "--out", run, code=0)
    bad = tmp_path / "bad"
    shutil.copytree(good, bad)
    (bad / "scenario.toml").write_text('duration = 0.02\n[fmus]\nplant = "plant.mjb"\n')
    # MuJoCo loads this model, but its shape's kind is beyond the table of functions.
    damaged = mujoco.MjModel.from_xml_path(str(good / "plant.xml"))
    damaged.geom_type[:] = 2**24
    mujoco.mj_saveModel(damaged, str(bad / "plant.mjb"))
    shutil.copy(bad / "plant.mjb", run / "scenario")
    model = bad / "plant.mjb"
    for arguments in (["view", run], ["check", bad], ["mjcf2fmu", model, "--out", tmp_path / "no"]):
        done = command(*arguments)
        said = " ".join((done.stdout + done.stderr).split())
        assert done.returncode == 2, (arguments, said)
        assert "plant.mjb: MuJoCo cannot load it: it ends with signal" in said, arguments
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmus_in_c_are_a_system_with_a_verdict(tmp_path, fmi):
    folder = tmp_path / "toys"
    folder.mkdir()
    toy_fmu(folder / "toy.fmu", fmi)
    (folder / "scenario.toml").write_text(TOYS)
    (folder / "ramp.py").write_text(RAMP)
    assert [d.level for d in check_folder(folder)][-1] == "good"
    done = job(folder, tmp_path / "run", {"toy.k": 3.0})
    assert done["parameters"]["toy"]["k"] == 3.0
    value = done["summary"]["criteria"][0]["value"]
    assert value == pytest.approx(3.0 * 0.049 + 0.05, rel=1e-12)  # y = k u + t [N]
    assert done["summary"]["success"]
    assert not job(folder, tmp_path / "missed")["summary"]["success"]  # with k = 1
    assert '"k"' in command("info", folder / "toy.fmu", "--json", code=0).stdout
    keys = "success.tracking_rms = 1.0\nsuccess.max_limit_share = 1.0\n"
    (folder / "scenario.toml").write_text(keys + TOYS)
    wrong = [each.text for each in check_folder(folder) if each.level == "wrong"]
    reasons = {
        "tracking_rms": "plant.hand_xpos is not recorded",
        "max_limit_share": "plant.qpos is not recorded",
    }
    assert [text.partition(": ")[2] for text in wrong] == [
        f"[success] {name}: {reason}" for name, reason in reasons.items()
    ]
    criteria = job(folder, tmp_path / "unmeasured")["summary"]["criteria"]
    assert {c["name"]: c["reason"] for c in criteria if c["name"] in reasons} == reasons


def test_an_ssp_of_fmus_in_c_is_judged_drawn_exported_and_compared(tmp_path):
    folder, ssp = tmp_path / "toy", tmp_path / "toy" / "toy.ssp"
    folder.mkdir()
    outputs = [f"y{i}" for i in INDICES]
    odd_ssp(ssp, {"toy": toy_fmu(tmp_path / "toy.fmu", 3)}, {"toy": outputs})
    (folder / "scenario.toml").write_text(SSP)
    run, quiet = tmp_path / "run", ("--no-video", "--out")

    def says(*arguments: object, code: int = 0) -> str:
        done = command(*arguments, code=code)
        return done.stdout + done.stderr

    assert says("check", folder).count("it can run") == 1
    assert "y[1..2,1..3]" in says("info", ssp)
    says("run", folder, "--plot", *quiet, run)
    assert (run / "plot.png").stat().st_size > 10_000
    says("export", run, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().splitlines()[-1].startswith("0.05,0.05,")
    assert "holds no model" in says("render", run, code=2)
    assert {path.name for path in run.iterdir()} == {
        "recording.parquet", "summary.json", "scenario", "plot.png",
    }  # fmt: skip
    says("view", run)  # its curves alone
    says("regress", folder, "--update", "--yes")
    says("regress", folder)
    (folder / "scenario.toml").write_text(SSP + "[parameters.toy]\nflip = true\n")
    says("regress", folder, code=1)
    # A scenario judges another system; a system alone is judged by nothing.
    other = ("--system", ssp, "--duration", "0.02")
    says("run", folder, *other, *quiet, tmp_path / "short", code=3)
    says("run", *other, "--set", "toy.k=2", *quiet, tmp_path / "alone")
    made = json.loads((tmp_path / "alone" / "summary.json").read_text())
    assert made["criteria"] == []
    assert made["timing"]["simulated_s"] == pytest.approx(0.02)
    says("run", tmp_path / "alone" / "scenario", *quiet, tmp_path / "x")


@pytest.mark.parametrize(
    ("key", "value"), [("scene", "tutorial"), ("align", False), ("timing_share", 0.5)]
)
def test_a_system_refuses_what_needs_a_table(tmp_path, key, value):
    (tmp_path / "scenario.toml").write_text(SSP)
    for changes in ({key: value}, {"table.rows[1].x": 0.2}):
        with pytest.raises(InputError, match=r"trajectory\.csv|the scenario has none"):
            load_scenario(tmp_path).changed(changes)
    (tmp_path / "scenario.toml").write_text(f"{key} = {json.dumps(value)}\n{SSP}")
    with pytest.raises(InputError, match=rf"{key}: acts only on .* with a trajectory.csv"):
        load_scenario(tmp_path)
