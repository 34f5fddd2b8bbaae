"""A red run names what it was made with differently, before its signals."""

import json
import re
import shutil
from html import unescape

import mujoco
import pytest

from forked import command
from panda_cosim.study.compare.causes import changed, elements, named
from panda_cosim.task.scenario import load_scenario

BALL = """<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1" friction="0.8 0.005 0.0001"/>
    <body name="ball" pos="0 0 0.3">
      <freejoint/>
      <geom name="shell" size="0.05" mass="0.1"/>
    </body>
    <body pos="0.5 0 0.5">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.2"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="hinge" kp="5"/></actuator>
</mujoco>"""


def cause(before: str, now: str, **settings: tuple[str, str]) -> str:
    """What is said of two models, and of other settings before and now."""
    made = [
        {"models": {"ball": elements(mujoco.MjModel.from_xml_string(text))}}
        | {key: value[number] for key, value in settings.items()}
        for number, text in enumerate((before, now))
    ]
    return named(changed(*made))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('mass="0.1"', 'mass="0.11"', "ball: body ball mass 0.1 -> 0.11 kg"),
        ('friction="0.8', 'friction="0.4', "ball: geom floor friction[1] 0.8 -> 0.4"),
        ('kp="5"', 'kp="4"', "ball: actuator servo gainprm[1] 5 -> 4"),
        ('damping="0.1"', 'damping="0.2"', "ball: joint hinge damping 0.1 -> 0.2"),
        ('pos="0 0 0.3"', 'pos="0 0 0.31"', "ball: body ball pos[3] 0.3 -> 0.31 m"),
        ('"0.001"/>', '"0.001" integrator="RK4"/>', "ball: option integrator 0 -> 1"),
        ('axis="0 1 0"', 'axis="1 0 0"', "ball: other fields of its compiled model"),
        ("", "", ""),
    ],
)
def test_the_element_and_field_of_a_model_are_named_with_both_values(old, new, said):
    assert cause(BALL, BALL.replace(old, new)).startswith(said)
    assert bool(cause(BALL, BALL.replace(old, new))) == bool(said)


def test_parameters_come_first_and_versions_before_code():
    told = cause(
        BALL, BALL.replace('mass="0.1"', 'mass="0.2"'),
        fmus=({"law": {"sha256": "a"}, "ball": {"sha256": "b"}},
              {"law": {"sha256": "c"}, "ball": {"sha256": "d"}}),
        versions=({"numpy": "2.4"}, {"numpy": "2.5"}),
        parameters=({"plant": {"block_mass": 0.18}}, {"plant": {"block_mass": 0.21}}),
    )  # fmt: skip
    order = "plant.block_mass 0.18 -> 0.21 kg.*ball: body ball mass.*numpy 2.4 -> 2.5"
    assert re.search(order, told)
    assert "FMU 'ball'" not in told  # its model says what it is
    law = cause(BALL, BALL, fmus=({"law": {"sha256": "a"}}, {"law": {"sha256": "b"}}))
    assert law == "the code or files of FMU 'law'"


def test_another_engine_alone_is_the_cause_of_another_compiled_model():
    engines = ({"mujoco": "4.0.0"}, {"mujoco": "3.10.0"})
    told = cause(BALL, BALL.replace('axis="0 1 0"', 'axis="1 0 0"'), versions=engines)
    assert told == "mujoco 4.0.0 -> 3.10.0"
    more = cause(BALL, BALL.replace('damping="0.1"', 'damping="0.1000000000001"'), versions=engines)
    assert more == told  # its rounding
    more = cause(BALL, BALL.replace('damping="0.1"', 'damping="0.11"'), versions=engines)
    assert more == f"{told}, ball: joint hinge damping 0.1 -> 0.11"


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """The command for a user's model that has changed since its reference."""
    folder = tmp_path_factory.mktemp("suite")
    (folder / "ball").mkdir()
    (folder / "ball" / "ball.xml").write_text(BALL)
    (folder / "ball" / "scenario.toml").write_text('duration = 0.2\n[fmus]\nball = "ball.xml"\n')
    regress = ("regress", "--scenarios", folder)
    command(*regress, "ball", "--update", "--yes", code=0)
    (folder / "ball" / "ball.xml").write_text(BALL.replace('mass="0.1"', 'mass="0.11"'))
    return regress


def test_every_door_names_the_cause_first(suite, tmp_path):
    said = "changed: ball: body ball mass 0.1 -> 0.11 kg"
    told = command(*suite, "ball", "--json", "--report", tmp_path, code=1)
    (red,) = json.loads(told.stdout)["scenarios"]
    assert red["verdict"] == "differs"
    assert red["reason"].startswith(said)
    xml, page = ((tmp_path / name).read_text() for name in ("junit.xml", "report.html"))
    assert f'message="{said}' in unescape(xml)
    page = unescape(page)
    assert said in page
    assert page.index(said) < page.index("ball.qfrc_bias")


def test_changed_criteria_and_parameters_are_named_by_a_red_and_by_a_green_run(tmp_path):
    push = shutil.copytree(load_scenario("push").folder, tmp_path / "push") / "scenario.toml"
    text, regress, friction = push.read_text(), ("regress", push.parent), "plant.block_friction"
    for old, new, code, said, *more in (
        ("_max = 0.02", "_max = 1e-4", 1, "success.tracking_max 0.02 -> 0.0001 m"),
        ("max_u", "max_tilt = 9\nmax_u", 0, "success.max_tilt \u2013 -> 9 deg; results match"),
        ('"recovery_time"', '"hash"', 0, "success.recovery_time 0.15 s -> \u2013, success.hash"),
        ("", "", 0, f"{friction} 1 -> 0.9; results match", "--set", f"{friction}=0.9"),
    ):
        push.write_text(text.replace(old, new))
        told = json.loads(command(*regress, *more, "--json", code=code).stdout)["scenarios"][0]
        assert told["cause"].startswith(f"changed: {said}")
    push.write_text(text.replace("max_unwanted_force", "# max_unwanted_force"))
    assert "judged by other criteria" in command(*regress, "--update", "--yes").stdout
