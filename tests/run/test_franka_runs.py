"""Programs of a real robot in scenarios: they pick the block, and are stopped by reflexes."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from forked import QUIET, command
from franka_support import needs_clients
from panda_cosim import Recording, Session, load_scenario, shipped_scenarios
from panda_cosim.controller.franka.wire import ERRORS
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.prepare import prepare
from panda_cosim.task.writer import make_scenario
from refusals import refused

UP = "robot.move(CartesianMotion(above(0.17), **SLOW))"
ALONG_THE_HAND = "CartesianMotion(Affine([0.0, 0.0, 0.15]), ReferenceType.Relative, **SLOW)"


@pytest.fixture(scope="module")
def pick(tmp_path_factory):
    """The scenario that `new --franka` makes."""
    folder = tmp_path_factory.mktemp("franka") / "pick"
    make_scenario(folder, ["franka"])
    return folder


@needs_clients
@pytest.mark.parametrize("runs", [1, pytest.param(2, marks=pytest.mark.long)])
def test_the_program_of_a_new_scenario_picks_the_block_with_equal_bits(pick, tmp_path, runs):
    bits = set()
    for number in range(runs):
        done = command("run", pick, *QUIET, "--out", tmp_path / f"{number}", code=0)
        assert "lifted, 60.0 mm between the fingers" in done.stderr
        recording = Recording.open(tmp_path / f"{number}")
        bits.add(recording.sha256())
    assert recording.complete
    assert len(bits) == 1
    lift = recording["plant.qpos[12]"]
    assert lift.max() - lift[0] > 0.1  # m
    # It commands poses, so that no rate of commanded torques is measured, and none is green.
    found = Summary.open(tmp_path / "0").preflight
    assert (found["interface"], found["torque_refusals"], found["refusals"]) == ("arm", None, 0)
    assert found["torque_rate_share"] is None


@needs_clients
@pytest.mark.long
def test_a_lift_the_wrong_way_is_stopped_by_the_reflex_that_the_robot_has(tmp_path):
    """The hand's frame points down: along its z axis, the block is pressed onto the floor."""
    folder = tmp_path / "wrong"
    shutil.copytree(shipped_scenarios()["franky_pick"], folder)
    program = (folder / "pick.py").read_text()
    assert UP in program
    program = program.replace(UP, f"robot.move({ALONG_THE_HAND})")
    (folder / "pick.py").write_text(
        program.replace("import Affine", "import ReferenceType, Affine")
    )
    done = command("run", folder, *QUIET, "--out", tmp_path / "run", code=1)
    told = r"Error: at t = \d\.\d{3} s, in FMU 'controller': the client ended with exit code 1: .*"
    assert re.search(told + r'ControlException: .*\["cartesian_reflex"\]', done.stderr), done.stderr
    recording = Recording.open(tmp_path / "run")
    assert not recording.complete
    reflex = 2 ** ERRORS.index("cartesian_reflex")
    assert {*np.unique(recording["controller.errors"])} == {0, reflex}


@needs_clients
def test_a_state_of_a_program_cannot_be_saved(pick, tmp_path):
    with Session(pick, tmp_path / "run") as session:
        session.step(1)
        assert "controller cannot restore its state" in refused(session.save)


@needs_clients
def test_delay_and_dropout_act_on_the_line_and_other_errors_on_the_sensors(pick):
    errors = {"mismatch.delay": 0.002, "mismatch.dropout": 0.1, "mismatch.seed": 4}
    values = prepare(load_scenario(pick).changed(errors)).values
    line = {name: values["controller"][name] for name in ("delay", "dropout", "seed")}
    assert line == {"delay": 0.002, "dropout": 0.1, "seed": 4.0}
    assert "sensors" not in values
    prepared = prepare(load_scenario(pick).changed(errors | {"mismatch.joint_offset": 1e-3}))
    assert prepared.values["sensors"]["delay"] == 0.0
    sources = {str(c.target[1]): c.source for c in prepared.assembly.connections}
    assert sources["qpos[7]"] == ("sensors", "qpos_measured[7]")
    assert sources["qpos[8]"] == ("plant", "qpos[8]")  # a finger, which no sensor measures


@pytest.mark.parametrize(("line", "new", "problem"), [
    ('robot = "fr3"', "", "robot: value 'panda'; must be \"fr3\" with the FMU franka"),
    ('scene = "motors"', "", 'scene "motors" takes torques'),
    ('controller = "franka"', "", "trajectory.csv: no such file"),
    ('"franka"', '"franca"', "[fmus] controller: value 'franca'; must be LAW.py:CLASS"),
    ('"franka"', '"franca"', "did you mean 'franka'?"),
])  # fmt: skip
def test_what_the_interface_needs_is_said(tmp_path, line, new, problem):
    make_scenario(tmp_path / "pick", ["franka"])
    path: Path = tmp_path / "pick" / "scenario.toml"
    text = path.read_text()
    assert line in text
    path.write_text(text.replace(line, new))
    assert problem in command("check", path.parent, code=2).stdout
