"""Bodies by name, users' scenes, torques, and unwanted contacts."""

import math
from pathlib import Path

import numpy as np
import pytest

from fault_support import write_files
from panda_cosim import InputError, Recording, Scenario, SignalCriterion, Success, load_scenario
from panda_cosim.fmus.interface.engine import COUNTED
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.sources.model_fmu import model_part
from panda_cosim.result.judging.signals import check_bodies, judge_bodies, judge_signals
from panda_cosim.result.recording import Column, Recorder
from panda_cosim.run.start import check_criteria
from panda_cosim.run.system.assembly import assemble
from panda_cosim.task.criteria import BodyCriterion

EVENTS: dict[str, float | None] = {"start": 0.0, "end": 1.0, "release": None}
ROUNDING = 1e-12  # m
TILT = 30.0  # deg
POSE = [
    *(f"plant.cup_xpos[{i}]" for i in (1, 2, 3)),
    *(f"plant.cup_xquat[{i}]" for i in range(1, 5)),
]
UNITS = {"time": "s", **dict.fromkeys(POSE[:3], "m"), **dict.fromkeys(POSE[3:], "1")}
SCENE = """
<mujoco>
  <include file="tabletop.xml"/>
  <worldbody>
    <body name="cup" pos="0.6 0.3 0.25">
      <freejoint/>
      <geom class="block" type="box" size="0.03 0.03 0.05"/>
    </body>
  </worldbody>
</mujoco>
"""


def lifted(folder: Path, step: float) -> Recording:
    """The cup rises by 0.2 m within ten steps, and leans over by 30 deg in the last row."""
    share, zero = np.linspace(0.0, 1.0, 11), np.zeros(11)
    half = np.where(share < 1.0, 0.0, math.radians(TILT) / 2)
    rows = (step * np.arange(11), zero + 0.6, zero, 0.1 + 0.2 * share, np.cos(half), np.sin(half),
            zero, zero)  # fmt: skip
    with Recorder(folder, [Column(n, u) for n, u in UNITS.items()], {}) as out:
        out.append(np.column_stack(rows))
        out.close(complete=True)
    return Recording.open(folder)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The cup of `lifted`, in 1 s."""
    return lifted(tmp_path_factory.mktemp("run"), 0.1)


def judged(recording: Recording, **keys: object) -> dict[str, tuple[float | None, bool]]:
    criterion = BodyCriterion(body="cup", **keys)  # type: ignore[arg-type]
    return {c.name: (c.value, c.ok) for c in judge_bodies([criterion], recording, EVENTS)}


def test_a_body_is_judged_where_it_is_at_the_end(recording):
    bounds = {"max_tilt": 29.0, "max_shift": 0.21, "min_lift": 0.2}
    found = judged(recording, position=(0.6, 0.0, 0.31), tolerance=0.02, **bounds)
    assert found["cup position"] == (pytest.approx(0.01, abs=ROUNDING), True)
    assert found["cup max_tilt"] == (pytest.approx(TILT), False)
    assert found["cup max_shift"] == (pytest.approx(0.2, abs=ROUNDING), True)
    assert found["cup min_lift"][0] == pytest.approx(0.2, abs=ROUNDING)


@pytest.mark.parametrize("step", [1e-9, 1e-5, 0.1])
def test_instants_are_told_apart_at_any_step(tmp_path, step):
    recording = lifted(tmp_path, step)
    for row in range(11):
        ((height, _),) = judged(recording, min_lift=0.0, at=row * step).values()
        assert height == pytest.approx(0.02 * row, abs=ROUNDING)
        window = SignalCriterion(POSE[2], "range", from_=row * step, below=1.0)
        (criterion,) = judge_signals([window], recording, EVENTS | {"end": 10 * step})
        assert criterion.value == pytest.approx(0.2 - 0.02 * row, abs=ROUNDING)


def test_a_body_is_judged_at_another_instant(recording):
    assert judged(recording, min_lift=0.0, at=0.5)["cup min_lift at 0.5 s"][0] == pytest.approx(0.1)
    assert judged(recording, max_tilt=1.0, at=0.5)["cup max_tilt at 0.5 s"] == (0.0, True)
    for at, name in (("release", "release"), (1.5, "1.5 s")):
        assert judged(recording, max_tilt=1.0, at=at) == {f"cup max_tilt at {name}": (None, False)}
    again = (BodyCriterion(body="cup", max_tilt=tilt) for tilt in (1.0, 2.0))
    with pytest.raises(InputError, match="name 'cup max_tilt' is taken; must be unique"):
        Success(body=tuple(again))


@pytest.mark.parametrize(("text", "told"), [
    ('[[success.body]]\nbody = "cup"', "no bound; must have at least one of tolerance"),
    ('[[success.body]]\nbody = "cup"\ntolerance = 0.1', "position and tolerance"),
    ('[[success.body]]\nbody = "cup"\nmax_tilt = 200', "from 0 to 180 deg"),
    ('[[success.body]]\nbody = "cup"\nmax_tilt = 2\nat = "grasped"', "did you mean 'grasp'"),
    ("[[success.body]]\nmax_tilt = 2", "body is missing"),
    ('[[success.body]]\nbody = "obj"\nmax_tlt = 2', "did you mean 'max_tilt'"),
    ('scene = "motors"', "must come with a controller that gives torques"),
])  # fmt: skip
def test_bad_criteria_are_refused_in_a_line(tmp_path, text, told):
    write_files(tmp_path, f"duration = 1.0\n{text}\n")
    with pytest.raises(InputError, match=told):
        Scenario.read(tmp_path)


def test_a_body_whose_pose_is_not_recorded_is_refused():
    criterion = BodyCriterion(body="cub", max_tilt=1.0)
    with pytest.raises(InputError, match=r"\[\[success.body\]\] 1: body: value 'cub'; .*'cup'"):
        check_bodies([criterion], UNITS)
    check_bodies([BodyCriterion(body="cup", max_tilt=1.0)], UNITS)


def test_a_scene_of_ones_own_has_all_of_the_plant_and_its_bodies(tmp_path):
    (tmp_path / "cup.xml").write_text(SCENE)
    (tmp_path / "cup.toml").write_text('name = "Cup"\nextends = "PandaPlant"\nkeyframe = "home"\n')
    found = {v.name: v for v in model_part(tmp_path / "cup.xml").interface.variables}
    ours = {v.name for v in PLANT.variables} - {"scene", "robot"}
    poses = {"cup_xpos", "cup_xquat", "obj_xpos", "obj_xquat"}
    assert found.keys() == ours | poses | {COUNTED.name}
    assert (found["qpos"].shape, found["qvel"].shape) == ((23,), (21,))
    assert found["qpos"].unit[16:20] == ("m", "m", "m", "1")
    (tmp_path / "cup.toml").write_text('extends = "PandaPlnt"\n')
    with pytest.raises(InputError, match="extends: value 'PandaPlnt'; must be one of PandaPlant"):
        model_part(tmp_path / "cup.xml")


def test_what_stands_before_the_robot_in_a_scene_is_refused(tmp_path):
    """The controller would take its position for that of joint 1."""
    door = '<worldbody><body name="door" pos="2 2 1"><joint/><geom size="0.1"/></body></worldbody>'
    (tmp_path / "door.toml").write_text('extends = "PandaPlant"\n')
    (tmp_path / "door.xml").write_text(SCENE.replace("<mujoco>", f"<mujoco>{door}"))
    with pytest.raises(InputError, match=r"joint 'joint1' must be number 1 .* put the <include>"):
        model_part(tmp_path / "door.xml")
    (tmp_path / "door.xml").write_text(SCENE.replace("</mujoco>", f"{door}</mujoco>"))
    assert model_part(tmp_path / "door.xml").interface.variable("qpos").shape == (24,)


def test_a_controller_gives_torques_where_the_arm_has_motors_and_a_criterion_what_is_recorded():
    assembly = assemble(load_scenario("draw_circle"))
    wires = {c.target: c.source for c in assembly.connections}
    for i in range(1, 8):
        assert wires["plant", f"torque[{i}]"] == ("controller", f"ctrl[{i}]")
        assert ("plant", f"ctrl[{i}]") not in wires
    assert wires["plant", "ctrl[8]"] == ("controller", "ctrl[8]")
    assert wires["controller", "mass_matrix[7,7]"] == ("plant", "mass_matrix[7,7]")
    recorded = {column.name for column in assembly.recorded()}
    assert {"plant.table_force", "plant.mass_matrix[1,1]"} <= recorded
    scenario = load_scenario("stack_blocks")
    recorded = {column.name for column in assemble(scenario).recorded()}
    assert "plant.unwanted_contact_force" in recorded
    assert not {"plant.table_force", "plant.mass_matrix[1,1]"} & recorded
    check_criteria(scenario, assemble(scenario))
