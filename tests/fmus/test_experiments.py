"""Reference experiments in FMUs: what is written, and what `check` makes of those of others."""

import csv
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmu_support import REFERENCE_FMUS, members, needs_compiler, needs_reference_fmus, pack
from forked import command
from panda_cosim import Recording, run_scenario
from toy_fmu import toy_fmu

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MJCF = Path(__file__).parents[1] / "mjcf" / "box.xml"
ROUNDING = 1e-9  # [1] of FMPy, which interpolates inputs in its own way


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("built")
    command("build", "--scenario", "push", "--out", folder, code=0)
    return folder


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    shutil.copy(MJCF, folder / "other.xml")
    command("mjcf2fmu", MJCF, folder / "other.xml", "--step", 0.0005, "--out", folder, code=0)
    assert (folder / "other.fmu").is_file()
    return folder / "box.fmu"


def table(path: Path, name: str) -> dict[str, np.ndarray]:
    head, *rows = csv.reader(io.StringIO(members(path)[f"{FOLDER}/{name}"].decode()))
    return dict(zip(head, np.array(rows, float).T, strict=True))


def changed(path: Path, to: Path, **changes: Callable[[str], str] | str | None) -> Path:
    """Copy an FMU with other members in its folder of experiments; None leaves one out."""
    content = members(path)
    for name in [name for name in content if name.startswith(FOLDER)]:
        change = changes.get(Path(name).stem.replace("-", "_"), str)
        if change is None:
            del content[name]
        elif change is not str:
            text = change(content[name].decode()) if callable(change) else change
            content[name] = text.encode()
    return pack(to, content)


@pytest.mark.own_process
def test_the_plants_references_are_the_run_and_what_fmpy_makes_of_the_stimulus(built, tmp_path):
    path = built / "PandaPlant.fmu"
    assert validate_fmu(str(path)) == []
    stimuli, references = table(path, "stimuli.csv"), table(path, "references.csv")
    names = list(references)[1:]
    recording = Recording.open(run_scenario("push", tmp_path / "run").recording.path)
    rows = np.rint(references["time"] * 1000).astype(int)
    recorded = [name for name in names if f"plant.{name}" in recording.units]
    assert len(recorded) > 100
    for name in recorded:
        np.testing.assert_array_equal(recording[f"plant.{name}"][rows], references[name])
    inputs = np.array(list(zip(*stimuli.values(), strict=True)),
                      dtype=[(name, float) for name in stimuli])  # fmt: skip
    alone = fmpy.simulate_fmu(str(path), stop_time=2.5, step_size=0.001, output_interval=0.001,
                              input=inputs, output=names)  # fmt: skip
    for name in names:
        np.testing.assert_allclose(alone[name][rows], references[name], ROUNDING, ROUNDING)


@pytest.mark.parametrize("name", ["PandaPlant", "PandaController", "PandaTrajectory"])
def test_check_finds_the_references_and_a_change(built, tmp_path, name):
    path = built / f"{name}.fmu"
    done = command("check", path, code=0)
    assert "largest difference 0 " in done.stdout
    last = list(table(path, "references.csv"))[-1]

    def shift(text: str) -> str:  # the last value of the last row
        lines = text.splitlines()
        before, _, value = lines[-1].rpartition(",")
        return "\n".join(
            [*lines[:-1], f"{before},{float(value) + 0.25 * max(1, abs(float(value)))}"]
        )

    done = command("check", changed(path, tmp_path / "x.fmu", references=shift), code=3)
    end = table(path, "references.csv")["time"][-1]
    assert f"({last} at t = {end:g} s)" in done.stdout
    assert done.stdout.startswith("wrong ")


def test_an_array_of_fmi_3_is_one_column(tmp_path):
    command("build", "--scenario", "push", "--fmi", "3", "--out", tmp_path, code=0)
    text = members(tmp_path / "PandaPlant.fmu")[f"{FOLDER}/references.csv"].decode()
    head, row, *_ = csv.reader(io.StringIO(text))
    sizes = dict(zip(head, (len(cell.split()) for cell in row), strict=True))
    assert (sizes["qpos"], sizes["qpos_block"], sizes["hand_xquat"]) == (7, 3, 4)


# An experiment of others: the box without gravity, which stays where it is.
FALL = """<Experiments name="x"><Experiment name="{name}"{times} tolerance="1e-12">{transient}
<Parameters source="p.ssv"/><References source="references.csv"/></Experiment></Experiments>"""
SSV = """<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
version="1.0" name="p"><ssv:Parameters><ssv:Parameter name="gravity[3]"><ssv:Real value="0"/>
</ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"""
TIMES = ' startTime="0" stopTime="0.1" stepSize="0.002"'


def with_files(path: Path, to: Path, **files: str) -> Path:
    changed(path, to, reference=files.pop("exp"), references=files.pop("csv"))
    more = {f"{FOLDER}/{name}.ssv": text for name, text in files.items()}
    return pack(to, members(to) | more)


@pytest.mark.parametrize("is_new", [False, True])
def test_experiments_of_others_are_run_with_their_parameters(box, tmp_path, is_new):
    transient = f"<TransientSimulation{TIMES}/>" if is_new else ""
    exp = FALL.format(name="floats", times="" if is_new else TIMES, transient=transient)
    rows = "time,qpos[3],angle\n0,1,0\n0.1,1.0,0\n5,7,1\n"  # the last is after the end
    path = with_files(box, tmp_path / "x.fmu", exp=exp, csv=rows, p=SSV)
    done = command("check", path, "--json", code=0)
    (found,) = json.loads(done.stdout)["experiments"]
    assert (found["experiment"], found["values"], found["largest_difference"]) == ("floats", 4, 0.0)
    assert found["left_out"] == 2
    told = command("check", path).stdout
    assert told.startswith("hint   floats: 4 values")
    assert "2 more not compared, t = 5 to 5 s, at no instant of the run" in told


@pytest.mark.parametrize(("height", "code"), [(1.0, 0), (1.1, 3)])
def test_an_experiment_becomes_a_scenario_judged_by_its_references(box, tmp_path, height, code):
    exp = FALL.format(name="floats", times=TIMES, transient="")
    rows = f"time,qpos[3],angle\n0,1,0\n0.1,{height},0\n5,7,1\n"
    path = with_files(box, tmp_path / "x.fmu", exp=exp, csv=rows, p=SSV)
    done = command("new", tmp_path / "mine", "--from", path, code=0)
    assert "Criteria: 2 of 6 reference values" in done.stdout
    options = ("--no-video", "--no-view", "--out", tmp_path / "run")
    assert command("run", tmp_path / "mine", *options).returncode == code
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [c["name"] for c in summary["criteria"] if not c["ok"]] == (
        ["final fmu.qpos[3] above"] if code else []
    )


COUPLED = """duration = 0.02
[fmus]
a = "a.fmu"
b = "b.fmu"
[connect]
"b.u" = "a.y"
[steps]
b = 2
[inputs]
"a.u[1,2]" = 3.0
[parameters.b]
k = 0.5
"""


@needs_compiler
def test_stimuli_are_what_the_master_fed(tmp_path):
    """The second FMU takes mN, in steps of 2 ms."""
    content = members(toy_fmu(tmp_path / "a.fmu", 2))
    text = content["modelDescription.xml"].replace(b'unit="N"', b'unit="mN"')
    milli = b'<Unit name="mN"><BaseUnit kg="1" m="1" s="-2" factor="0.001"/></Unit>'
    text = text.replace(b"<UnitDefinitions>", b"<UnitDefinitions>" + milli)
    pack(tmp_path / "b.fmu", content | {"modelDescription.xml": text})
    (tmp_path / "scenario.toml").write_text(COUPLED)
    command("build", "--scenario", tmp_path, "--out", tmp_path / "built", code=0)
    options = ("--no-video", "--no-view", "--out", tmp_path / "run")
    assert command("run", tmp_path, *options).returncode == 0
    recording, path = Recording.open(tmp_path / "run"), tmp_path / "built" / "b.fmu"
    stimuli = table(path, "stimuli.csv")
    fed = 1000.0 * recording["a.y"][1:, 0, 1]  # each step has what the first FMU gives at its end
    np.testing.assert_allclose(stimuli["u[1,2]"][:-1], fed, ROUNDING)
    references = table(path, "references.csv")
    np.testing.assert_allclose(references["time"], np.arange(0.0, 0.021, 0.002), ROUNDING)
    later = np.rint(references["time"][1:] * 1000).astype(int)
    np.testing.assert_array_equal(references["y[1,2]"][1:], recording["b.y"][later, 0, 1])
    shutil.copy(path, tmp_path / "b.fmu")
    built = tmp_path / "again"
    assert command("build", "--scenario", tmp_path, "--out", built).returncode == 0
    assert (built / "b.fmu").read_bytes() == path.read_bytes()  # keeps its experiments


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [({"fmi_ls_manifest": None}, 2, "no experiments, so that nothing was compared"),
     ({"references": "time,qpos[3]\n"}, 2, "has no rows"),
     ({"references": "time,qpos[9]\n0,1\n"}, 2, r"no variable 'qpos[9]'"),
     ({"references": "time,qpos[3]\n0,one\n"}, 2, "qpos[3]: must have a value of type Real in"),
     ({"references": "time,qpos[3]\n0\n"}, 2, "references.csv: line 2: 1 values; must be 2"),
     ({"reference": lambda text: text.replace('stepSize="0.0005"', 'stepSize="0"')}, 2,
      "stepSize: value '0'"),
     ({"fmi_ls_manifest": lambda text: text.replace("reference.exp", "../../../x.exp")}, 2,
      "must be a file inside its archive"),
     ({"fmi_ls_manifest": lambda text: text[:60]}, 2, "x.fmu: fmi-ls-manifest.xml: not well"),
     ({"reference": lambda text: text.replace('"1e-06"', '"none"')}, 2, "tolerance: value 'none'")],
)  # fmt: skip
def test_where_nothing_can_be_compared_check_is_not_content(box, tmp_path, changes, code, words):
    done = command("check", changed(box, tmp_path / "x.fmu", **changes), code=code)
    assert words in done.stderr
    assert "good" not in done.stdout


@needs_reference_fmus
@pytest.mark.parametrize(
    ("name", "values"),
    [("fmi2/BouncingBall", 602), ("fmi3/BouncingBall", 602), ("fmi2/VanDerPol", 4002),
     ("fmi3/Dahlquist", 101), ("fmi3/Feedthrough", 336), ("fmi3/StateSpace", 33)],
)  # fmt: skip
def test_results_in_the_reference_fmus_are_found(name, values):
    done = command("check", REFERENCE_FMUS / f"{name}.fmu", code=0)
    assert f" {values} values, largest difference " in done.stdout
