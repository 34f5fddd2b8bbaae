"""FMUs of any MuJoCo model are what `mj_step` makes of it, and lose or rename nothing."""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_instance import OK, Instance, with_content
from forked import command
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.interface.variables import by_array
from panda_cosim.fmus.sources.model_fmu import ModelOptions, model_fmu
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.recording import Recording
from panda_cosim.run.session import Session
from panda_cosim.study.check.diagnosis import check_folder
from panda_cosim.study.compare.tubes import widths
from panda_cosim.task.scenario import load_scenario

own_process = pytest.mark.own_process
needs_pid = pytest.mark.skipif(not hasattr(mujoco.mjtGain, "mjGAIN_PID"), reason="older MuJoCo")
HINGE = """<body><joint name="h" axis="0 1 0" damping="1"/>
<geom size=".1" mass="1" pos=".3 0 0"/>{}</body>"""
SLIDE = (
    '<body pos="0 1 0"><joint name="s" type="slide" damping="1"/><geom size=".1" mass="1"/></body>'
)
BALL = (
    '<body pos="0 2 0"><joint name="b" type="ball"/><geom size=".1" mass="1" pos=".1 0 0"/></body>'
)
STEP = 0.002  # [s] MuJoCo's own
KEYED = Path(__file__).parents[1] / "mjcf" / "keyed.xml"


def saved(tmp_path, body: str, rest: str = "", option: str = ""):
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco>{option}<worldbody>{body}</worldbody>{rest}</mujoco>")
    return path


def instance(path, tmp_path, version: int = 2, **options) -> Instance:
    described = model_fmu(path, ModelOptions(**options), "Other")
    return Instance(with_content(described, tmp_path / f"fmu{version}", version))


def loaded(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    return model, mujoco.MjData(model)


def steps(it: Instance, model, data, count: int) -> None:
    """Step both; positions and velocities have the same bits."""
    first = round(data.time / STEP)
    for i in range(first, first + count):
        mujoco.mj_step(model, data)
        assert it.step(i * STEP, STEP) == OK, it.messages()
    assert it.get("qpos") == data.qpos.tolist()
    assert it.get("qvel") == data.qvel.tolist()


def units(path, **options) -> dict[str, str]:
    return {s.name: s.unit for s in model_fmu(path, ModelOptions(**options)).interface.scalars()}


@own_process
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("own", ["", "up"])
@pytest.mark.parametrize("key", [-1, 0, 1])
def test_a_keyframe_brings_controls_activations_and_mocap_poses(tmp_path, version, own, key):
    model, data = loaded(KEYED)
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
    data.ctrl[1] = min(data.ctrl[1], 1.0)  # its range
    options = {"keyframe": own, "inputs": ["body m mocap_pos"]}
    it = instance(KEYED, tmp_path, version, **options).start({"keyframe": [key + 2]})
    assert it.get("ctrl") == data.ctrl.tolist()
    assert it.get("m_mocap_pos") == data.mocap_pos[0].tolist()
    assert it.get("act") == data.act.tolist()
    steps(it, model, data, 50)
    if version == 2:  # what is set, one control alone, stays
        assert it("Reset") == OK
        it.set_references([it.fmu.rows["ctrl"].reference], [0.125])
        it.start({"keyframe": [key + 2]})
        assert it.get("ctrl") == [0.125, *data.ctrl[1:]]


@own_process
def test_a_session_begins_with_the_controls_of_the_keyframe(tmp_path):
    text = f'purpose = "Keys"\nduration = 0.02\nstep = {STEP}\n[fmus]\nplant = "{KEYED}"\n'
    (tmp_path / "scenario.toml").write_text(f'{text}[plant]\nkeyframe = "up"\n')
    model, data = loaded(KEYED)
    mujoco.mj_resetDataKeyframe(model, data, 1)
    data.ctrl[1] = 1.0  # its range
    with Session(tmp_path, tmp_path / "run") as session:
        for _ in range(10):
            session.step()
            mujoco.mj_step(model, data)
        row = dict(zip(session.signals, session.row(), strict=True))
    assert [row[f"plant.ctrl[{i}]"] for i in (1, 2, 3)] == data.ctrl.tolist()
    assert [row[f"plant.qpos[{i + 1}]"] for i in range(model.nq)] == data.qpos.tolist()


PID = '<pid name="p" joint="{}" kp="50" kv="2" input="pos vel"/>'
ACTUATORS = {
    PID.format("h") + '<motor name="m" joint="s" ctrllimited="true" ctrlrange="-2 2"/>': (
        "rad", "rad/s", "N"),
    '<dcmotor name="dc" joint="h" motorconst=".05" resistance="1" input="none"/>'
    + PID.format("s"): ("m", "m/s"),
    '<pid name="p" joint="s" kp="5" input="pos vel ff"/>'
    '<orientation name="o" joint="b" kp="2"/><motor joint="s" gear="3"/>': (
        "m", "m/s", "N", "rad", "rad", "rad", ""),
    '<dcmotor name="dc" joint="h" motorconst=".05" resistance="1"/>': ("V",),
}  # fmt: skip


@own_process
@needs_pid
@pytest.mark.parametrize("xml", ACTUATORS)
def test_actuators_may_have_several_controls_or_none(tmp_path, xml):
    path = saved(tmp_path, HINGE.format("") + SLIDE + BALL, f"<actuator>{xml}</actuator>")
    model, data = loaded(path)
    expected = ACTUATORS[xml]
    found = units(path)
    names = ["ctrl"] if len(expected) == 1 else [f"ctrl[{i + 1}]" for i in range(model.nu)]
    assert tuple(found[name] for name in names) == expected
    it, source = instance(path, tmp_path).start(), np.random.default_rng(1)
    for _ in range(20):
        data.ctrl = source.uniform(-1, 1, model.nu)
        assert it.set("ctrl", *data.ctrl) == OK
        steps(it, model, data, 5)
    assert it.get("actuator_force") == data.actuator_force.tolist()


NAMES = st.lists(st.text("ab-_.' 1ü", min_size=0, max_size=3) | st.sampled_from(
    ["time", "ctrl", "qpos", "gravity", "sensor_1", "2"]), max_size=8)  # fmt: skip


@settings(max_examples=50, deadline=None)
@given(NAMES)
def test_no_sensor_is_lost_and_all_names_differ(tmp_path_factory, names):
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_joint(name="h")
    body.add_geom(size=[0.1, 0, 0])
    kinds = mujoco.mjtSensor
    for i, name in enumerate(names):
        kind = (kinds.mjSENS_JOINTPOS, kinds.mjSENS_JOINTVEL)[i % 2]
        unique = name if name not in names[:i] else ""
        spec.add_sensor(name=unique, type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname="h")
    path = tmp_path_factory.mktemp("names") / "model.xml"
    spec.compile()
    path.write_text(spec.to_xml())
    interface = model_fmu(path, ModelOptions()).interface
    sensors = [v for v in interface.variables if v.source.startswith("data sensordata")]
    assert sorted(int(v.source.split()[2]) for v in sensors) == list(range(len(names)))
    assert [v.unit[0] for v in sensors] == ["rad/s" if i % 2 else "rad" for i in range(len(names))]
    assert all(v.description.endswith(" of joint h") for v in sensors)
    every = [v.name for v in interface.variables]
    assert len(set(every)) == len(every)
    assert all(name.isidentifier() and name.isascii() for name in every)


@pytest.mark.parametrize("source", ["actuator m ctrl", "data ctrl 0 1"])
def test_two_inputs_for_one_control_are_refused(tmp_path, source):
    path = saved(tmp_path, HINGE.format(""), '<actuator><motor name="m" joint="h"/></actuator>')
    with pytest.raises(
        InputError, match=r"model\.xml: inputs ctrl and \w+ both set Control of act"
    ):
        model_fmu(path, ModelOptions(inputs=[source]))


MOVED = """<tendon><fixed name="t"><joint joint="h" coef=".5"/><joint joint="h2" coef="2"/></fixed>
<fixed name="mix"><joint joint="h" coef="1"/><joint joint="s" coef="1"/></fixed>
<spatial name="rope"><site site="w"/><site site="p"/></spatial></tendon><actuator>
<position name="tp" tendon="t" kp="10"/><motor name="geared" joint="h" gear="100"/>
<position name="back" joint="h" gear="-1" kp="5"/><motor name="pull" tendon="rope"/>
<motor name="both" tendon="mix"/><motor joint="h"/><motor joint="s"/><position joint="h" kp="9"/>
<position joint="s" kp="9"/><velocity joint="h"/><velocity joint="s"/>
<general joint="h" gainprm="3"/><intvelocity joint="h" kp="5" actrange="0 1"/></actuator><sensor>
<tendonpos name="turned" tendon="t"/><tendonvel name="drawn" tendon="rope"/>
<actuatorpos name="ap" actuator="back"/><actuatorfrc name="af" actuator="geared"/>
<actuatorfrc name="pf" actuator="pull"/><jointactuatorfrc name="jaf" joint="s"/>
<clock name="now"/><e_kinetic name="ek"/></sensor>"""


def test_units_follow_the_joints_behind_tendons_and_gears(tmp_path):
    second = '<body><joint name="h2" axis="0 1 0"/><geom size=".05"/><site name="p"/></body>'
    body = HINGE.format(second) + SLIDE + '<site name="w" pos="0 0 2"/>'
    path = saved(tmp_path, body, MOVED)
    found = units(path, outputs=["tendon t length", "tendon rope velocity", "energy"])
    expected = {"ctrl[1]": "rad", "ctrl[2]": "", "ctrl[3]": "rad", "ctrl[4]": "N", "ctrl[5]": "",
                "actuator_force[1]": "N.m", "actuator_force[2]": "", "actuator_force[4]": "N",
                "turned": "rad", "drawn": "m/s", "ap": "rad", "af": "", "pf": "N", "jaf": "N",
                "now": "s", "ek": "J", "t_length": "rad", "rope_velocity": "m/s",
                "energy[1]": "J"}  # fmt: skip
    controls = ("N.m", "N", "rad", "m", "rad/s", "m/s", "", "")
    forces = ("N.m", "N", "N.m", "N", "N.m", "N", "N.m", "N.m")
    expected |= {f"ctrl[{i}]": unit for i, unit in enumerate(controls, 6)}
    expected |= {f"actuator_force[{i}]": unit for i, unit in enumerate(forces, 6)}
    assert {name: found[name] for name in expected} == expected


@own_process
@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_forces_and_accelerations_belong_to_the_last_step(tmp_path, integrator):
    body = HINGE.format('<site name="x" pos=".4 0 0"/>')
    rest = (
        '<actuator><position name="p" joint="h" kp="40"/></actuator><sensor>'
        '<accelerometer name="acc" site="x"/><jointpos name="now" joint="h"/></sensor>'
    )
    path = saved(tmp_path, body, rest, f'<option integrator="{integrator}"/>')
    model, data = loaded(path)
    it = instance(path, tmp_path).start({"ctrl": [0.8]})
    data.ctrl[0] = 0.8
    for _ in range(100):
        steps(it, model, data, 1)
        assert it.get("acc") == data.sensordata[:3].tolist()
        assert it.get("actuator_force") == data.actuator_force.tolist()
        assert it.get("now") == data.qpos.tolist()


@own_process
@pytest.mark.parametrize(
    ("source", "field", "values"),
    [("body m mocap_pos", "mocap_pos", [(0.0, 0.01 * i, 2.0) for i in range(30)]),
     ("equality w active", "eq_active", [False, True])],
)  # fmt: skip
def test_what_is_put_between_steps_acts_in_the_next_one(tmp_path, source, field, values):
    model, data = loaded(KEYED)
    it, name = instance(KEYED, tmp_path, inputs=[source]).start(), "_".join(source.split()[1:])
    place = getattr(data, field)
    assert it.get(name) == np.ravel(place[0]).tolist()
    for value in values:
        place[0] = value
        assert it.set(name, *np.ravel(value).tolist()) == OK
        steps(it, model, data, 10)


DOMINO = '<body pos="{} 0 .12"><freejoint/><geom type="box" size=".02 .06 .1"/></body>'


@own_process
def test_the_state_of_what_sleeps_is_exact(tmp_path):
    dominoes = "".join(DOMINO.format(0.1 * i) for i in range(6))
    tilted = DOMINO.replace("pos=", 'euler="0 20 0" pos=').format(-0.11)
    far = '<body pos="3 0 .05"><freejoint/><geom type="box" size=".05 .05 .05"/></body>'
    floor = '<geom type="plane" size="9 9 1"/>'
    option = '<option><flag sleep="enable"/></option>'
    path = saved(tmp_path, floor + dominoes + tilted + far, "", option)
    model, data = loaded(path)
    it = instance(path, tmp_path).start()
    asleep = []
    for _ in range(12):
        steps(it, model, data, 25)
        asleep.append(int((data.tree_asleep >= 0).sum()))
        other = Instance(it.fmu).start()
        status, state = other.deserialize(it.serialize(it.save()))
        assert (status, other.load(state)) == (OK, OK), other.messages()
        it = other  # which goes on
    assert max(asleep) > 0
    assert any(one != two for one, two in pairwise(asleep))
    wrong = bytearray(it.serialize(it.save()))
    wrong[200] ^= 1
    assert it.deserialize(bytes(wrong))[0] != OK


def test_objects_without_names_have_numbers(tmp_path):
    body = (
        "<body><joint/><geom size='.1'/><body pos='1 0 0'><joint/><geom size='.1'/></body></body>"
    )
    path = saved(tmp_path, body)
    found = model_fmu(path, ModelOptions(outputs=["body #3 xpos", "joint #2 qpos"])).interface
    assert found.variable("joint_2_qpos").source == "data qpos 1"
    assert found.variable("body_3_xpos").description == "Origin of body 3, world frame"
    assert [s.name for s in by_array(found.scalars())["qpos"]] == ["qpos[1]", "qpos[2]"]


def test_a_model_with_plugins_is_refused_with_their_names(tmp_path):
    rest = ('<extension><plugin plugin="mujoco.pid"/></extension><actuator><plugin name="a" '
            'joint="h" plugin="mujoco.pid"/></actuator>')  # fmt: skip
    with pytest.raises(
        InputError, match=r"model\.xml: uses plugins, mujoco\.pid, which FMUs cannot"
    ):
        model_fmu(saved(tmp_path, HINGE.format(""), rest), ModelOptions())


BOXES = '<geom type="plane" size="5 5 1"/>' + "".join(
    f'<body pos="{0.3 * i} 0 .09"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    for i in range(8)
)


@pytest.mark.parametrize(("memory", "isolate"), [("10K", ()), ("30K", ("--isolate",)), ("1M", ())])
def test_warnings_of_the_engine_are_counted_and_fail_a_run(tmp_path, memory, isolate):
    path, count = saved(tmp_path, BOXES, f'<size memory="{memory}"/>'), 10
    model, data = loaded(path)
    for _ in range(count + 1):  # the instants of as many rows
        mujoco.mj_step(model, data)
    kinds = [data.warning[i].number for i in range(3)]
    assert any(kinds) == (memory != "1M")
    head = f'purpose = "Boxes"\nduration = {count * STEP}\nstep = {STEP}\n'
    for bound, verdict in (("", 3 if any(kinds) else 0), ("max_engine_warnings = 99", 0)):
        text = f'{head}[fmus]\nplant = "model.xml"\n[success]\n{bound}\n'
        (tmp_path / "scenario.toml").write_text(text)
        out = tmp_path / f"run{len(bound)}"
        words = ("run", tmp_path, "--no-video", "--no-view", "--out", out, *isolate)
        assert command(*words).returncode == verdict
        run = Summary.open(out)
        assert dict(run.numbers())["engine.warnings"] == sum(kinds)
        counted = Recording.open(out).metadata["engine"]
        assert [*counted.values()] == kinds, counted


def test_a_step_that_the_models_does_not_divide_is_told(tmp_path):
    saved(tmp_path, HINGE.format(""))
    for step, is_told in ((0.001, True), (0.002, False), (0.003, True), (0.004, False)):
        text = f'purpose = "A step"\nduration = 0.012\nstep = {step}\n[fmus]\nplant = "model.xml"\n'
        (tmp_path / "scenario.toml").write_text(text)
        told = "\n".join(each.text for each in check_folder(tmp_path))
        assert ("plant: steps itself by 0.002 s" in told) == is_told, told


ADDRESSED = """purpose = "Names"
duration = 0.02
step = 0.002
not_finite = ["plant.ball.vz"]
[regression]
"plant.ball.z" = 0.25
[fmus]
plant = "{file}"
law = "law.py:Law"
[connect]
"law.height" = "plant.lift.pos"
"plant.motor.ctrl" = "law.ctrl"
[inputs]
"plant.push.ctrl" = 0.25
[[success.signal]]
name = "high"
signal = "plant.ball.z"
reduce = "max"
below = 9.0
"""
LIFTED = (
    '<body name="ball" pos="0 0 2"><freejoint/><geom size=".1" mass="1"/></body><body pos="0 1 0">'
    '<joint name="lift" type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>'
)


@pytest.mark.parametrize("file", ["model.xml", "model.fmu"])
def test_signals_can_be_named_by_joint_body_or_actuator(tmp_path, file):
    motors = '<motor name="motor" joint="lift"/><motor name="push" joint="lift"/>'
    path = saved(tmp_path, LIFTED, f"<actuator>{motors}</actuator>")
    (tmp_path / "model.fmu").write_bytes(Target().make(model_fmu(path, ModelOptions())))
    law = "class Law:\n    def update(self, time, height):\n        return 10.0 - height\n"
    (tmp_path / "law.py").write_text(law)
    (tmp_path / "scenario.toml").write_text(ADDRESSED.format(file=file))
    out = tmp_path / "run"
    done = command("run", tmp_path, "--no-video", "--no-view", "--out", out)
    assert done.returncode == 0, done.stderr
    run = Recording.open(out)
    assert (run["plant.lift.pos"] == run["plant.qpos[8]"]).all()
    assert (run["plant.ball.vz"] == run["plant.qvel[3]"]).all()
    assert run.descriptions["plant.qpos[3]"] == "Position z of joint 1 (ball.z)"
    assert run["plant.ball.z"][-1] < run["plant.ball.z"][0]
    forces = 10.0 - run["plant.lift.pos"][:-1] + 0.25
    assert run["plant.motor.force"][1:] + run["plant.push.force"][1:] == pytest.approx(forces)
    assert not [d.text for d in check_folder(tmp_path) if d.level == "wrong" or "[reg" in d.text]
    half = widths(run, load_scenario(tmp_path).regression)
    assert half["plant.qpos[3]"] == 0.25
    assert half["plant.qpos[2]"] < 0.25
