"""How small a change a reference notices: against single runs at that change, and none at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from forked import command
from panda_cosim import load_scenario
from panda_cosim.scenarios.definition.new import make_scenario
from panda_cosim.scenarios.definition.scenario import Scenario
from panda_cosim.scenarios.regression.runner import Runner
from panda_cosim.scenarios.regression.sensitivity import LARGEST, parameters, sensitivity

pytestmark = pytest.mark.fmu

TABLE = "time,frame,x,y,z,grip\n0.0,home,0.0,0.0,0.0,0.08\n0.15,home,0.0,0.005,0.0,0.06\n"
RESOLUTION = 1.2  # factor between two shares that bisection tells apart, with some to spare


@pytest.fixture
def short(tmp_path: Path) -> Path:
    folder = tmp_path / "mine" / "short"
    folder.mkdir(parents=True)
    (folder / "scenario.toml").write_text("duration = 0.2\n[success]\ntracking_max = 0.005\n")
    (folder / "trajectory.csv").write_text(TABLE)
    return folder


def test_the_smallest_change_is_noticed_and_a_smaller_one_is_not(
    short: Path, tmp_path: Path
) -> None:
    assert command("regress", short, "--update").returncode == 0
    scenario = Scenario.read(short)
    names = ("controller.gravity_feedforward", "plant.block_friction")
    block, gain = sensitivity(scenario, tmp_path / "runs", 2, only=names)
    assert (gain.name, block.name) == names
    assert (block.change, block.noticed_by) == (None, "")  # nothing touches the block
    assert gain.change is not None
    assert 0.0 < gain.change < LARGEST
    assert "times its tolerance" in gain.noticed_by
    (changed,) = (p for p in parameters(scenario) if p.full_name == names[0])
    for share, verdict in ((gain.change * 1.001, "differs"), (gain.change / RESOLUTION, "same")):
        place = tmp_path / f"run-{verdict}"
        with Runner(place, changed.changed(share)) as runner:
            assert runner.submit(scenario).result().verdict == verdict
    assert not list((tmp_path / "runs").glob("*/*"))  # removed as soon as they are judged


def test_the_parameters_of_a_law_are_changed_too(tmp_path: Path) -> None:
    folder = make_scenario(tmp_path / "mine", controller=True)[0].parent
    names = [parameter.full_name for parameter in parameters(load_scenario(folder))]
    assert {"controller.gain", "controller.damping", "plant.block_mass"} <= set(names)
    assert "controller.kp" not in names


def test_slips_are_reported_in_one_line(short: Path) -> None:
    for arguments, told in (
        ((short,), f"does not exist; `panda-cosim regress {short} --update` makes it"),
        (("push", "jacobi"), "2 scenarios given; must be one"),
        (("push", "--exact"), "can only be combined with"),
    ):
        slip = command("regress", "--sensitivity", *arguments)
        assert slip.returncode == 2
        assert told in slip.stderr
        assert slip.stderr.count("Error:") == 1


def test_every_parameter_can_be_changed_within_its_bounds(short: Path) -> None:
    found = {p.full_name: p for p in parameters(Scenario.read(short))}
    assert {"controller.kp", "controller.limit_share", "plant.block_mass"} <= found.keys()
    assert found["controller.limit_share"].sign == -1  # it may not grow
    assert "controller.period" not in found  # a whole number of ticks
