"""`mjcf2fmu`: FMUs of models that others wrote are what MuJoCo makes of them."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import mjcf_jobs
import mujoco
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_support import Worker
from mjcf_jobs import BOX, write
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.sources.model_fmu import ModelOptions, describe, taken_warnings
from panda_cosim.scenarios.cli.app import app
from typer.testing import CliRunner

LITTLE = 200_000  # kB
STEPS = {2: 1000, 3: 200}  # by version of FMI: both step the same code


def _package_folder(name: str, *parts: str) -> Path:
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        return Path("missing")
    return Path(spec.origin).parent.joinpath(*parts)


def foreign_models() -> Iterator[Path]:
    """Models that nobody here wrote."""
    yield from sorted(_package_folder("gymnasium", "envs", "mujoco", "assets").glob("*.xml"))
    yield from [_package_folder("mujoco", "testdata", "model.xml")]
    menagerie = os.environ.get("MENAGERIE_ROOT")
    yield from sorted(Path(menagerie or "missing").glob("franka_emika_panda/panda.xml"))


MODELS = list(foreign_models())


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    made = Worker(tmp_path_factory.mktemp("worker"))
    yield made
    made.close()


@pytest.fixture
def box(tmp_path: Path) -> Path:
    path = tmp_path / "box.xml"
    path.write_text(BOX)
    return path


def test_there_are_ten_models_at_least() -> None:
    assert len(MODELS) >= 10


@pytest.mark.fmu
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("model", MODELS, ids=lambda path: path.stem)
def test_an_fmu_steps_as_mujoco_does(worker: Worker, tmp_path: Path, model: Path, fmi: int) -> None:
    path = worker.do(mjcf_jobs.make, str(model), str(tmp_path / "Model.fmu"), fmi)
    assert validate_fmu(path) == []
    same, moved = worker.do(mjcf_jobs.steps_alike, path, str(model), STEPS[fmi], fmi)
    assert same == STEPS[fmi]
    assert moved > 1e-6


def test_variables_have_the_units_that_mujoco_defines(box: Path, tmp_path: Path) -> None:
    options = ModelOptions(
        inputs=["body box force"],
        outputs=["body box xpos", "body post jacobian turn", "site tip xmat"],
        parameters=["body box mass", "geom cube friction", "qpos"],
    )
    variables = Fmu(write(box, tmp_path / "Box.fmu", options)).variables
    units = {name: variable.unit for name, variable in variables.items()}
    assert [units[f"qpos[{i}]"] for i in range(1, 9)] == [*"mmm1111", "rad"]
    assert [units[f"qvel[{i}]"] for i in range(1, 8)] == [*["m/s"] * 3, *["rad/s"] * 4]
    assert [units[f"qfrc_bias[{i}]"] for i in (1, 4, 7)] == ["N", "N.m", "N.m"]
    assert units["box_force[3]"] == "N"
    assert units["box_xpos[1]"] == units["angle"].replace("rad", "m") == "m"
    assert [units[f"post_jacobian[{i},1]"] for i in (1, 4)] == ["m/rad", "1"]
    assert units["box_mass"] == "kg"
    assert units["gravity[3]"] == "m/s2"
    assert float(variables["box_mass"].start or 0) == 2.0
    assert variables["ctrl"].minimum == -1.0
    assert "start_qpos[8]" in variables


@pytest.mark.fmu
def test_parameters_and_keyframe_are_the_start(worker: Worker, box: Path, tmp_path: Path) -> None:
    path = worker.do(mjcf_jobs.make, str(box), str(tmp_path / "a.fmu"), 2)
    assert worker.do(mjcf_jobs.outputs, path, {}, ["qpos[8]", "angle"], 0) == [0.0, 0.0]
    falling = worker.do(mjcf_jobs.outputs, path, {"gravity[3]": 0.0}, ["qpos[3]"], 50)
    assert falling == [1.0]
    options = {"keyframe": "turned", "parameters": ["qpos"]}
    made = mjcf_jobs.make(str(box), str(tmp_path / "b.fmu"), 3, **options)
    assert worker.do(mjcf_jobs.outputs, made, {}, ["qpos[8]", "angle"], 0) == [0.5, 0.5]
    assert Fmu(Path(made)).variables["ctrl"].start == 0.25
    high = worker.do(mjcf_jobs.outputs, made, {"start_qpos[3]": 4.0}, ["qpos[3]"], 0)
    assert high == [4.0]


def test_the_interface_that_is_printed_gives_the_same_fmu(box: Path, tmp_path: Path) -> None:
    options = ModelOptions(outputs=["site tip jacobian"], parameters=["body box mass"])
    file = tmp_path / "box.toml"
    file.write_text(describe(box, options))
    direct = write(box, tmp_path / "box.fmu", options).read_bytes()
    again = write(box, tmp_path / "again.fmu", ModelOptions(interface=file)).read_bytes()
    assert again == direct


def test_an_interface_that_is_no_file_is_refused(box: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="/dev/null: not a regular file"):
        write(box, tmp_path / "a.fmu", ModelOptions(interface=Path("/dev/null")))


def test_suggestions_of_the_interface_are_valid(box: Path, tmp_path: Path) -> None:
    file = tmp_path / "box.toml"
    text = describe(box, ModelOptions()).replace("\n# ", "\n")
    file.write_text("\n".join(line for line in text.splitlines() if "=" in line or "[" in line)
                    .replace("# One line per variable; `source` names", "#")
                    .replace("and max are optional", "# and max are optional"))  # fmt: skip
    made = write(box, tmp_path / "all.fmu", ModelOptions(interface=file), 3)
    assert validate_fmu(str(made)) == []
    assert "tip_xmat[9]" in Fmu(made).variables


BAD_INTERFACES = {
    "name = [": r"^\S+bad.toml: cannot be read: Invalid value",
    'nam = "x"': "no key 'nam'; valid: name, .*; did you mean 'name'",
    'name = "a b"': "must be of letters, digits and _",
    "outputs = 3": "outputs|inline|table",
    '[outputs]\n"a b" = { source = "qpos" }': "outputs.a b: a name must be",
    '[outputs]\nx = { sourse = "qpos" }': "must be a table such as",
    '[outputs]\nx = { source = "body bix xpos" }': "not in the model; did you mean 'box'",
    '[outputs]\nx = { source = "site zzz xpos" }': "not in the model; valid: ",
    '[outputs]\nx = { source = "body box ypos" }': "mjcf2fmu --help` lists the sources",
    '[outputs]\nx = { source = "qpoz" }': "no field of MjData; did you mean",
    '[outputs]\nx = { source = "data qpos 5 9" }': "qpos has 8 elements",
    '[outputs]\nx = { source = "qpos", unit = "inch" }': "unit 'inch': valid",
    '[inputs]\nx = { source = "ctrl", start = [1, 2] }': "start: must be a number, or 1 of them",
    '[inputs]\nx = { source = "qpos" }': "no such input",
    '[parameters]\nx = { source = "body post free_xy" }': "has no free joint",
    '[parameters]\nx = { source = "body box free_xy sit" }': "start rule 'sit'; valid:",
    '[parameters]\nx = { source = "body box free_xy stand flor" }': "did you mean 'floor'",
    '[inputs]\nx = { source = "ctrl", start = 5 }': "start: 5.0 is out of range; must",
    '[inputs]\nx = { source = "ctrl", max = -0.5 }': "must be between -1 and -0.5",
    '[parameters]\nx = { source = "gravity", tunable = "yes" }': "tunable: must be true or false",
    '[inputs]\nx = { source = "ctrl", tunable = true }': "tunable: only parameters have this",
    '[parameters]\nx = { source = "qpos", tunable = true }': "an effect at the start only",
    "[parameters]\nx = { source = \"body 'box mass\" }": "a quotation mark",
    '[parameters]\nx = { source = "model geom_size ² 1" }': "no such parameter",
    'keyframe = "none"': "no keyframe 'none'; valid: turned",
    '[inputs]\nx = { source = "ctrl" }\n[outputs]\nx = { source = "qpos" }': "two variables",
}  # fmt: skip


@pytest.mark.parametrize("text", BAD_INTERFACES)
def test_a_bad_interface_is_refused_in_one_line(box: Path, tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=BAD_INTERFACES[text]) as caught:
        write(box, tmp_path / "x.fmu", ModelOptions(interface=file))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "x.fmu").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [("# a text", "MuJoCo refuses it"),
     ("<mujoco><worldbody><body/></worldbody></mujoco>x", "refuses"),
     ("<mujoco><asset><mesh name='m' file='none.stl'/></asset></mujoco>", "none.stl")],
)  # fmt: skip
def test_what_mujoco_refuses_is_refused_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    model = tmp_path / "model.xml"
    model.write_text(text)
    result = CliRunner().invoke(app, ["mjcf2fmu", str(model), "--out", str(tmp_path / "x.fmu")])
    assert result.exit_code == InputError.exit_code
    assert told in result.output.replace("\n", " ")
    with pytest.raises(InputError) as caught:
        write(model, tmp_path / "x.fmu", ModelOptions())
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "x.fmu").exists()


def test_a_warning_of_mujoco_is_reported_and_no_file_is_left(
    box: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    odd = Path("odd.xml")
    odd.write_text(box.read_text().replace('ctrl="0.25"', 'ctrl="nan"'))
    result = CliRunner().invoke(app, ["mjcf2fmu", "odd.xml", "--print-interface"])
    assert result.exit_code == 0
    assert "odd.xml: MuJoCo warns: XML contains a 'NaN'" in result.stderr
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_models_that_are_loaded_in_two_threads_leave_the_handler_of_warnings_as_it_was() -> None:
    before = mujoco.get_mju_user_warning()
    first_is_in, first_may_leave = threading.Event(), threading.Event()

    def take(is_in: threading.Event, may_leave: threading.Event) -> None:
        with taken_warnings():
            is_in.set()
            may_leave.wait(10)

    first = threading.Thread(target=take, args=(first_is_in, first_may_leave))
    first.start()
    assert first_is_in.wait(10)
    second_may_leave = threading.Event()
    second = threading.Thread(target=take, args=(threading.Event(), second_may_leave))
    second.start()
    second.join(0.2)  # it comes in now, or waits
    for may_leave, thread in ((first_may_leave, first), (second_may_leave, second)):
        may_leave.set()
        thread.join(10)
    assert mujoco.get_mju_user_warning() is before


def test_an_fmu_can_be_made_of_a_compiled_model(box: Path, tmp_path: Path) -> None:
    compiled = tmp_path / "box.mjb"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_path(str(box)), str(compiled))
    (tmp_path / "b").mkdir()
    one = write(box, tmp_path / "box.fmu", ModelOptions())
    two = write(compiled, tmp_path / "b" / "box.fmu", ModelOptions())
    assert one.read_bytes() == two.read_bytes()
    assert np.all([Fmu(path).variables["qpos[1]"].unit == "m" for path in (one, two)])
