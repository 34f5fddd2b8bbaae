"""`mjcf2fmu`: FMUs of models that others wrote are what MuJoCo makes of them."""

import math
import re
import shutil
import threading
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import fmpy
import mujoco
import pytest
from fmpy.validation import validate_fmu
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lxml import etree
from typer.testing import CliRunner

from fmu_instance import Instance, with_content
from panda_cosim.cli.app import app
from panda_cosim.fmus.build import identity
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.fmus.master.fmu_file import Fmu, library_of
from panda_cosim.fmus.sources.mjcf_sources import CONTACTS, HELD, OBJECTS, Sources
from panda_cosim.fmus.sources.model_fmu import ModelOptions, describe, load, model_fmu
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.plant.mujoco_warnings import taken_warnings
from refusals import refused

FILE = Path(__file__).parents[1] / "mjcf" / "box.xml"
BOX = load(FILE)


@pytest.fixture
def box(tmp_path):
    return Path(shutil.copy(FILE, tmp_path))


def write(model: Path, out: Path, options: ModelOptions, fmi: int = 2) -> Path:
    """Make an FMU, named after its file."""
    out.write_bytes(Target(fmi=fmi).make(model_fmu(model, options, out.stem)))
    return out


def test_variables_have_the_units_that_mujoco_defines(box):
    options = ModelOptions(
        inputs=["body box force"],
        outputs=["body box xpos", "body post jacobian turn", "site tip xmat"],
        parameters=["body box mass", "geom cube friction", "qpos"],
    )
    variables = {s.name: s for s in model_fmu(box, options).interface.scalars()}
    units = {name: variable.unit for name, variable in variables.items()}
    assert [units[f"qpos[{i}]"] for i in range(1, 9)] == [*"mmm1111", "rad"]
    assert [units[f"qvel[{i}]"] for i in range(1, 8)] == [*["m/s"] * 3, *["rad/s"] * 4]
    assert [units[f"qfrc_bias[{i}]"] for i in (1, 4, 7)] == ["N", "N.m", "N.m"]
    assert units["box_force[3]"] == "N"
    assert units["box_xpos[1]"] == units["angle"].replace("rad", "m") == "m"
    assert [units[f"post_jacobian[{i},1]"] for i in (1, 4)] == ["m/rad", "1"]
    assert units["box_mass"] == "kg"
    assert units["gravity[3]"] == "m/s2"
    assert variables["box_mass"].start == 2.0
    assert variables["ctrl"].minimum == -1.0
    assert "start_qpos[8]" in variables


@pytest.mark.own_process
def test_parameters_and_keyframe_are_the_start(box, tmp_path):
    def instance(fmi: int, values: dict[str, list[float]], **options: Any) -> Instance:
        fmu = model_fmu(box, ModelOptions(**options), "Other")
        return Instance(with_content(fmu, tmp_path / f"{fmi}{len(values)}", fmi)).start(values)

    it = instance(2, {})
    assert (it.get("qpos")[7], it.get("angle")) == (0.0, [0.0])
    it = instance(2, {"gravity": [0.0] * 3})
    for tick in range(50):
        assert it.step(0.002 * tick, 0.002) == 0
    assert it.get("qpos")[2] == 1.0
    high = [0.0, 0.0, 4.0, 1.0, 0.0, 0.0, 0.0, 0.5]
    it = instance(3, {"start_qpos": high}, keyframe="turned", parameters=["qpos"])
    assert (it.get("qpos"), it.get("angle")) == (high, [0.5])
    assert it.get("ctrl") == [0.25]
    for fmi in (2, 3):
        values = {"keyframe": [2], "turn_gain": [3.0], "ctrl": [0.5]}
        it = instance(fmi, values, parameters=["actuator turn gain"])
        assert it.get("qpos")[7] == it.get("angle")[0] == 0.5
        assert it.step(0.0, 0.002) == 0
        assert it.get("actuator_force") == [1.5]
        other = Instance(it.fmu)
        assert other.set("keyframe", 3) == 3
        assert "out of range" in other.messages()


def test_the_interface_that_is_printed_gives_the_same_fmu(box, tmp_path):
    options = ModelOptions(outputs=["site tip jacobian"], parameters=["body box mass"])
    file = tmp_path / "box.toml"
    file.write_text(describe(box, options))
    assert model_fmu(box, options).digest == model_fmu(box, ModelOptions(interface=file)).digest


def test_suggestions_of_the_interface_are_valid(box, tmp_path):
    file = tmp_path / "box.toml"
    text = describe(box, ModelOptions()).replace("\n# ", "\n")
    file.write_text("\n".join(line for line in text.splitlines() if "=" in line or "[" in line)
                    .replace("# One line per variable; `source` names", "#")
                    .replace("and max are optional", "# and max are optional"))  # fmt: skip
    made = write(box, tmp_path / "all.fmu", ModelOptions(interface=file), 3)
    assert validate_fmu(str(made)) == []
    assert "tip_xmat[9]" in Fmu(made).variables


WORDS = st.lists(st.sampled_from([
    *OBJECTS, *CONTACTS, *HELD, "force", "active", "jacobian", "mass", "free_xy", "gain", "#1",
    "box", "turn", "data", "xpos", "qpos", "ctrl", "0",
]), min_size=1, max_size=5)  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(["input", "output", "parameter", "local"]), WORDS)
@example("output", ["sensor", "#1", "data"])
def test_any_source_is_found_and_described_or_refused(causality, words):
    with suppress(InputError):
        row = Sources(BOX).find(causality, " ".join(words))
        assert row.source
        assert row.description
        assert row.causality == causality


BAD_INTERFACES = {
    "name = [": r"^\S+bad.toml': cannot be read: Invalid value",
    'nam = "x"': "key: value 'nam'; must be one of name, .*; did you mean 'name'",
    'name = "a b"': "must be of letters, digits and _",
    "outputs = 3": "outputs|inline|table",
    '[outputs]\n"a b" = { source = "qpos" }': "outputs.a b: value 'a b'; must be of letters",
    '[outputs]\nx = { sourse = "qpos" }': "must be a table such as",
    '[outputs]\nx = { source = "body bix xpos" }': "body: value 'bix'; .*; did you mean 'box'",
    '[outputs]\nx = { source = "site zzz xpos" }': "site: value 'zzz'; the model has tip",
    '[outputs]\nx = { source = "body box ypos" }': "output body NAME .*; did you mean 'xpos'",
    '[outputs]\nx = { source = "joint #9 qpos" }': "joint: value '#9'; the model has",
    '[outputs]\nx = { source = "qpoz" }': "must be a field of MjData, .*; did you mean",
    '[outputs]\nx = { source = "data qpos 5 9" }': "qpos has 8 elements",
    '[outputs]\nx = { source = "qpos", unit = "inch" }': "unit: value 'inch'; must be one of",
    '[inputs]\nx = { source = "ctrl", start = [1, 2] }': "start: must be a number, or 1 of them",
    '[inputs]\nx = { source = "qpos" }': "must be an input; it is an output",
    '[parameters]\nx = { source = "body post free_xy" }': "has no free joint",
    '[parameters]\nx = { source = "body box free_xy sit" }': "start rule 'sit'; valid:",
    '[parameters]\nx = { source = "body box free_xy stand flor" }': "did you mean 'floor'",
    '[inputs]\nx = { source = "ctrl", start = 5 }': "start: value 5.0; must",
    '[inputs]\nx = { source = "ctrl", max = -0.5 }': "must be a number from -1 to -0.5",
    '[parameters]\nx = { source = "gravity", tunable = "yes" }': "tunable: must be true or false",
    '[inputs]\nx = { source = "ctrl", tunable = true }': "tunable: only parameters have this",
    '[parameters]\nx = { source = "qpos", tunable = true }': "an effect at the start only",
    "[parameters]\nx = { source = \"body 'box mass\" }": "a quotation mark",
    '[parameters]\nx = { source = "model geom_size ² 1" }': "no such parameter",
    'keyframe = "none"': "keyframe: value 'none'; the model has turned",
    '[inputs]\nx = { source = "ctrl" }\n[outputs]\nx = { source = "qpos" }': "two variables",
}  # fmt: skip


@pytest.mark.parametrize("text", BAD_INTERFACES)
def test_a_bad_interface_is_refused_in_one_line(box, tmp_path, text):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    assert re.search(BAD_INTERFACES[text], refused(model_fmu, box, ModelOptions(interface=file)))


@pytest.mark.parametrize(
    ("text", "told"),
    [("# a text", "MuJoCo cannot load it"),
     ("<mujoco><worldbody><body/></worldbody></mujoco>x", "refuses"),
     ("<mujoco><asset><mesh name='m' file='none.stl'/></asset></mujoco>", "none.stl")],
)  # fmt: skip
def test_what_mujoco_refuses_is_refused_in_one_line(tmp_path, text, told):
    model = tmp_path / "model.xml"
    model.write_text(text)
    result = CliRunner().invoke(app, ["mjcf2fmu", str(model), "--out", str(tmp_path / "x.fmu")])
    assert result.exit_code == InputError.exit_code
    assert told in result.output.replace("\n", " ")
    assert refused(model_fmu, model, ModelOptions())
    assert not (tmp_path / "x.fmu").exists()


def test_a_warning_of_mujoco_is_reported_and_no_file_is_left(box, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    odd = Path("odd.xml")
    odd.write_text(box.read_text().replace('ctrl="0.25"', 'ctrl="nan"'))
    result = CliRunner().invoke(app, ["mjcf2fmu", "odd.xml", "--print-interface"])
    assert result.exit_code == 0
    assert "odd.xml: MuJoCo warns: XML contains a 'NaN'" in result.stderr
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_models_that_are_loaded_in_two_threads_leave_the_handler_of_warnings_as_it_was():
    before, is_in = mujoco.get_mju_user_warning(), threading.Event()
    may_leave = [threading.Event(), threading.Event()]

    def take(leave: threading.Event) -> None:
        with taken_warnings():
            is_in.set()
            leave.wait(10)

    first, second = threads = [threading.Thread(target=take, args=(each,)) for each in may_leave]
    first.start()
    assert is_in.wait(10)
    second.start()
    second.join(0.2)  # it comes in now, or waits
    for leave, thread in zip(may_leave, threads, strict=True):
        leave.set()
        thread.join(10)
    assert mujoco.get_mju_user_warning() is before


def test_an_fmu_can_be_made_of_a_compiled_model(box, tmp_path):
    compiled = tmp_path / "box.mjb"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_path(str(box)), str(compiled))
    one, two = (model_fmu(path, ModelOptions()) for path in (box, compiled))
    assert one.digest == two.digest


@pytest.mark.parametrize(
    ("kept", "version", "told"),
    [(1000, mujoco.mj_version(), r"box\.mjb: MuJoCo cannot load it: \w"),
     (None, 4_000_123, r"box\.mjb: compiled by MuJoCo 4\.0\.123, and .* MJCF$")],
)  # fmt: skip
def test_a_compiled_model_of_another_version_or_cut_off_is_refused(
    box, tmp_path, kept, version, told
):
    path = tmp_path / "box.mjb"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_path(str(box)), str(path))
    content = path.read_bytes()
    path.write_bytes((content[:12] + version.to_bytes(4, "little") + content[16:])[:kept])
    assert re.search(told, refused(describe, path, ModelOptions()))


@pytest.mark.parametrize(("jacobian", "solver", "is_hit"), [
    ("sparse", "Newton", True), ("sparse", "CG", False),
])  # fmt: skip
def test_the_fault_of_a_version_is_named_where_the_model_meets_it(
    tmp_path, jacobian, solver, is_hit
):
    option = f'<option jacobian="{jacobian}" solver="{solver}"/>'
    body = '<body><freejoint/><geom size=".1"/></body>'
    model = tmp_path / "ball.xml"
    model.write_text(f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>")
    out, is_hit = tmp_path / "ball.fmu", is_hit and mujoco.__version__ == "4.0.0"
    said = CliRunner().invoke(app, ["mjcf2fmu", str(model), "--out", str(out)])
    assert ("ball.fmu: MuJoCo 4.0.0 computes wrong" in said.output.replace("\n", " ")) == is_hit
    told = CliRunner().invoke(app, ["info", str(out), "--json"])
    assert ("issue 3767" in told.output) == is_hit
    with zipfile.ZipFile(out) as fmu:
        needs = fmu.read("documentation/externalDependencies.txt").decode()
    assert ("issue 3767" in needs) == is_hit


def test_two_engines_beside_each_other_are_refused(monkeypatch):
    versions = {"mujoco": "4.0.0", "mujoco-core": "4.0.1"}
    monkeypatch.setattr(identity, "package_version", versions.get)
    with pytest.raises(CosimError, match=r"mujoco 4\.0\.0 and mujoco-core 4\.0\.1: must be one"):
        identity.mujoco_version()


@pytest.mark.parametrize(("files", "found"), [
    (("linux64/box.so", "aarch64-linux/box.so"), 1), (("linux64/box.so",), 0), ((), None),
    (("aarch64-linux/of_the_tool.so",), 0), (("aarch64-linux/a.so", "aarch64-linux/b.so"), None),
    (("aarch64-linux/box.so", "aarch64-linux/a.so"), 0),
])  # fmt: skip
def test_the_library_is_that_for_the_platform_by_name_or_the_only_one(
    box, tmp_path, monkeypatch, files, found
):
    fmu = Fmu(write(box, tmp_path / "box.fmu", ModelOptions()))
    monkeypatch.setattr(fmpy, "platform_tuple", "aarch64-linux")  # FMPy says linux64 there, too
    places = [tmp_path / "binaries" / file for file in files]
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    if found is None:
        with pytest.raises(InputError, match=r"binary .*; binaries/aarch64-linux/box\.so is miss"):
            library_of(fmu.label, tmp_path, fmu.description)
    else:
        assert library_of(fmu.label, tmp_path, fmu.description) == places[found]


@pytest.mark.parametrize("clamps", [True, False])
def test_controls_start_where_mujoco_clamps_them(box, tmp_path, clamps):
    model, text = tmp_path / "other.xml", box.read_text().replace('"-1 1"', '"0.5 1"')
    option = "" if clamps else '<option><flag clampctrl="disable"/></option>'
    model.write_text(text.replace("<worldbody>", f"{option}<worldbody>"))
    (ctrl,) = (s for s in model_fmu(model, ModelOptions()).interface.scalars() if s.name == "ctrl")
    low, high = (0.5, 1.0) if clamps else (-math.inf, math.inf)
    assert (ctrl.start, ctrl.minimum, ctrl.maximum) == (0.5 * clamps, low, high)


def test_fmi_3_has_a_terminal_with_all_signals(box, tmp_path):
    file = write(box, tmp_path / "box.fmu", ModelOptions(), 3)
    signals = [v.name for v in Fmu(file).description.modelVariables
               if v.causality in ("input", "output")]  # fmt: skip
    with zipfile.ZipFile(file) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    etree.XMLSchema(etree.parse(schema)).assertValid(root)
    assert {"qpos_free", "qpos_free_quat", "qpos_turn"} <= set(signals)
    assert [m.get("variableName") for m in root.iter("TerminalMemberVariable")] == signals


@pytest.mark.own_process
def test_elements_are_named_after_joints_and_actuators(box, tmp_path):
    file = write(box, tmp_path / "box.fmu", ModelOptions(step=0.0005))
    variables = {v.name: v for v in Fmu(file).description.modelVariables}
    assert variables["qpos[3]"].description == "Position z of joint free (box.z)"
    assert variables["qpos[8]"].description == "Angle of joint turn (turn.pos)"
    assert variables["qvel[4]"].description == "Velocity about x of joint free (box.wx)"
    assert variables["ctrl"].description == "Control of actuator turn (turn.ctrl)"
    assert variables["ctrl"].unit == variables["actuator_force"].unit == "N.m"
    experiment = Fmu(file).description.defaultExperiment
    assert (float(experiment.stepSize), float(experiment.stopTime)) == (0.0005, 0.5)
    with pytest.raises(InputError, match=r"--step: value 2\.0; must be above 0 s, and at most 1 s"):
        model_fmu(box, ModelOptions(step=2.0))


def test_a_weld_is_as_soft_as_its_parameter():
    model = FILE.with_name("keyed.xml")
    options = ModelOptions(parameters=["equality w solref", "equality w solimp"])
    starts = {s.name: s.start for s in model_fmu(model, options).interface.scalars()}
    compiled = mujoco.MjModel.from_xml_path(str(model))
    assert [starts[f"w_solref[{i}]"] for i in (1, 2)] == compiled.eq_solref[0].tolist()
    assert [starts[f"w_solimp[{i}]"] for i in range(1, 6)] == compiled.eq_solimp[0].tolist()
