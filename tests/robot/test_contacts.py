"""Contacts that nobody wants: in the plant, in the summary, and in what is advised."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fake_recording import FakeRecording
from panda_cosim import Scenario, Success, load_scenario, run_scenario
from panda_cosim.assets.franka import HOME_Q
from panda_cosim.plant.contacts import SUPPORT, UNWANTED, contacts_of, kinds_of
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import Plant
from panda_cosim.plant.scene import load_scene
from panda_cosim.result.judging.advice import advise
from panda_cosim.result.judging.contacts import unwanted_contacts
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.summary import summarize
from random_tasks import run_plain

SLACK = 0.0015  # [s] more than a tick
STRUCK = {"block_pos": (0.367, 0.607), "block_yaw": 0.333}  # the fingers strike the table
EDGED = {"block_pos": (0.760, 0.011)}  # the table's edge pushes the block through the fingers
WALL = """<mujoco model="walled">
  <include file="tabletop.xml"/>
  <worldbody>
    <geom name="wall" class="surroundings" type="box" size="0.1 0.01 0.145" pos="0.49 0.05 0.145"/>
  </worldbody>
</mujoco>
"""


def shortened() -> Scenario:
    """As far as both places are met; both bounds are exceeded all the same."""
    scenario = load_scenario("pick_and_place")
    success = Success(min_lift=0.1, max_unwanted_force=0.1)
    return replace(scenario, duration=4.0, success=success)


def said(run: FakeRecording, summary: Summary) -> str:
    return "\n".join(advise(run, summary))


def test_a_block_that_stands_is_carried_by_its_weight_and_touched_by_nothing_else():
    for place in ((0.4, -0.2), (0.65, 0.3)):  # on the floor, on the table
        plant = Plant(PlantParameters(block_pos=place, block_mass=0.5))
        assert plant.outputs["support_force"] == 0.0, "nothing before the first step"
        plant.step(500)
        assert plant.outputs["support_force"] == pytest.approx(0.5 * 9.81, abs=1e-6)
        assert plant.outputs["unwanted_contact_force"] == 0.0


def test_a_block_that_is_pushed_against_a_side_is_an_unwanted_contact():
    plant = Plant(PlantParameters(block_pos=(0.6, 0.06), block_friction=0.01))
    plant.step(200)
    plant.inputs["block_force"] = 0.0, 5.0, 0.0
    plant.step(600)  # it slides to the table's side
    assert plant.outputs["unwanted_contact_force"] == pytest.approx(5.0, abs=0.2)
    assert plant.outputs["support_force"] == pytest.approx(0.18 * 9.81, abs=0.1)
    assert plant.outputs["contact_force"] == 0.0


@pytest.mark.parametrize(
    ("turn", "kind"), [(0.0, SUPPORT), (44.0, SUPPORT), (46.0, UNWANTED), (90.0, UNWANTED)]
)
def test_45_deg_from_vertical_parts_what_carries_from_what_pushes(turn, kind):
    """The floor tilts, and the block with it."""
    model = load_scene(PlantParameters())
    half = np.radians(turn) / 2
    quaternion = np.array([np.cos(half), np.sin(half), 0.0, 0.0])
    model.geom("floor").quat = quaternion
    data = mujoco.MjData(model)
    up = np.empty(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 0.0499]), quaternion)
    data.qpos[:16] = [*HOME_Q, 0.04, 0.04, *up, *quaternion]
    mujoco.mj_forward(model, data)
    block = model.geom("obj_geom").id
    kinds = contacts_of(kinds_of(model), data)
    assert kind in [k for k, geoms in zip(kinds, data.contact.geom, strict=True) if block in geoms]


@pytest.mark.parametrize(
    ("plant", "pair", "from_s"),
    [(STRUCK, ["left_finger", "table"], 0.916), (EDGED, ["block", "table"], 3.457)],
)
def test_contacts_are_named_before_any_other_advice_with_bodies_time_and_force(plant, pair, from_s):
    run = run_plain(shortened().changed({f"plant.{k}": value for k, value in plant.items()}))
    told = unwanted_contacts(run)
    force, first = run["plant.unwanted_contact_force"], told["unwanted"][0]
    assert first["bodies"] == tuple(pair)
    assert first["time_s"] == pytest.approx(from_s, abs=SLACK)
    assert told["unwanted_force_N"] == force.max() > 10.0
    during = (run.time >= first["time_s"]) & (run.time <= first["end_s"])
    assert first["force_N"] == force[during].max()
    assert first["time_s"] == run.time[np.flatnonzero(force)[0]]
    summary = summarize(run, shortened())
    assert [c.name for c in summary.criteria if not c.ok] == ["max_unwanted_force"]
    lines = said(run, summary)
    assert "more time" not in lines
    assert "carry less" not in lines
    assert "the path must avoid this" in lines
    needed = tuple(replace(each, bound=each.value) for each in summary.criteria)  # as of a peg
    assert "must avoid" not in said(run, replace(summary, criteria=needed))
    assert lines.index(" touch ") < lines.index("torque rate")


def test_a_wall_of_ones_own_is_named_where_the_block_strikes_it(tmp_path):
    (tmp_path / "wall.xml").write_text(WALL)
    more = 'name = "Walled"\nextends = "PandaPlant"\nkeyframe = "home"\n'
    (tmp_path / "wall.toml").write_text(more)
    changes = {"duration": 4.0, "fmus.plant": str(tmp_path / "wall.xml")}
    run = run_scenario("pick_and_place", tmp_path / "run", values=changes)
    summary = run.summary
    assert ("block", "wall") in {tuple(c["bodies"]) for c in summary.contact["unwanted"]}
    assert "carry less" not in " ".join(advise(run.recording, summary, ours=False))
    assert not next(c for c in summary.criteria if c.name == "max_unwanted_force").ok
