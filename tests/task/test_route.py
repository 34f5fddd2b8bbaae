"""Planned routes: the block is grasped and set down, and nothing else is touched."""

import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from bounded import ran
from fmu_support import in_process
from forked import command
from panda_cosim import InputError, Recording, Scenario, load_scenario, run_scenario
from panda_cosim.assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX
from panda_cosim.fmus.sources.targets import build
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.scene import load_scene
from panda_cosim.run.prepare import prepare
from panda_cosim.study.sweep.definition import load_sweep
from panda_cosim.task.route.scene import Load, RouteScene

pytest.importorskip("ompl")

BEHIND = "plant.block_pos=-0.4,0.3"  # where the shipped table does not lead
POSTURE_TOLERANCE = 1e-3  # rad between the arm and its plan


@pytest.fixture(scope="module")
def routed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("route") / "behind"
    command("route", "pick_and_place", "--out", folder, "--set", BEHIND, code=0)
    return folder


def record(folder: str, out: str) -> bool | None:
    return run_scenario(load_scenario(Path(folder)), out).summary.success


def test_a_block_behind_the_arm_is_set_down_within_all_limits(routed, tmp_path):
    assert in_process(record, str(routed), str(tmp_path / "run"))
    recording = Recording.open(tmp_path / "run")
    q, rate = recording["plant.qpos"][:, :7], recording["controller.qvel_ref"]
    assert recording["plant.unwanted_contact_force"].max() == 0.0
    assert not recording["controller.limit"].any()
    assert (np.minimum(q - Q_MIN, Q_MAX - q) > 0.05).all()
    assert (np.abs(rate) <= 0.9 * QD_MAX).all()
    assert (np.abs(np.diff(rate, axis=0)) / 0.001 <= 0.9 * QDD_MAX).all()
    assert np.abs(q - recording["controller.posture_cmd"]).max() < POSTURE_TOLERANCE


def test_the_same_input_gives_the_same_bytes(routed, tmp_path):
    program = [sys.executable, "-m", "panda_cosim", "route", "pick_and_place", "--set", BEHIND]
    done = ran([*program, "--out", str(tmp_path / "again")])
    assert "leaked" not in done.stderr  # OMPL's remains at the end of a process
    for file in ("scenario.toml", "trajectory.csv"):
        assert (tmp_path / "again" / file).read_bytes() == (routed / file).read_bytes()


OUT_OF_REACH = [
    ("plant.block_pos=0.66,0.38", "no posture of the arm grasps and lifts the block"),
    pytest.param(
        "success.block_position=-0.65,0.5,0.05",
        "no posture of the arm sets the block down",
        marks=pytest.mark.long,
    ),
]


@pytest.mark.parametrize(("setting", "reason"), OUT_OF_REACH)
def test_what_is_out_of_reach_is_refused(tmp_path, setting, reason):
    far = command("route", "pick_and_place", "--out", tmp_path / "a", "--set", setting, code=2)
    assert not (tmp_path / "a").exists()
    assert reason in far.stderr


def behind_wall() -> Scenario:
    """The shipped sweep's scenario, whose table is planned."""
    return load_scenario(Path(str(load_sweep("behind_wall").scenario[0])))


def passes(out: str) -> tuple[bool | None, list[str]]:
    run = run_scenario(behind_wall(), out)
    kept = Scenario.read(Path(out) / "scenario")
    return run.summary.success, [row.name for row in kept.table.rows if row.name]


@pytest.mark.long
def test_a_wall_in_a_scene_of_its_own_is_not_touched(tmp_path):
    """The wall stands free: `max_shift` of the scenario would notice a touch of 1 N."""
    success, names = in_process(passes, str(tmp_path / "run"))
    assert success
    assert names[0] == "home"  # what was planned is kept with the run, as an ordinary table
    recording = Recording.open(tmp_path / "run")
    shift = np.ptp(recording["plant.wall_xpos"][:, :2], axis=0)
    assert shift.max() < 1e-5  # m
    assert recording["plant.unwanted_contact_force"].max() == 0.0


@pytest.mark.parametrize("design", ["anywhere", "behind_wall"])
def test_the_shipped_sweeps_of_routes_have_their_blocks_where_they_say(design):
    sweep = load_sweep(design)
    values = np.genfromtxt(sweep.file, delimiter=",", names=True)
    names = ("plantblock_pos1", "plantblock_pos2")
    radius = np.hypot(*(values[name] for name in names))
    assert len(values) == {"anywhere": 200, "behind_wall": 20}[design]
    assert (radius > 0.25).all()
    assert (radius < 0.90).all()
    if design == "behind_wall":  # the wall, 0.3 m wide, crosses the line from block to place
        at = {name: np.stack([values[f"plant{name}_pos{i}"] for i in (1, 2)], 1)
              for name in ("block", "wall")}  # fmt: skip
        block, wall = at["block"], at["wall"]
        way = np.array(behind_wall().success.block_position[:2]) - block
        yaw = values["plantwall_yaw"]
        normal = np.stack((np.cos(yaw), np.sin(yaw)), 1)
        share = ((wall - block) * normal).sum(1) / (way * normal).sum(1)
        crossing = block + share[:, None] * way
        assert ((share > 0.0) & (share < 1.0)).all()
        assert (np.linalg.norm(crossing - wall, axis=1) < 0.15).all()


def test_what_does_not_follow_a_route_is_refused():
    scenario = load_scenario("pick_and_place")
    with pytest.raises(InputError, match=r"must come with \[success\] block_position"):
        Scenario(name="a", table=scenario.table, duration=1.0, route="auto")
    with pytest.raises(InputError, match="the project's own controller"):
        replace(scenario, route="auto", fmus={"controller": "law.py:Law"})
    with pytest.raises(InputError, match="must be left out of the table with gains"):
        prepare(replace(scenario, route="auto", gains="tutorial"))
    plant = str(build(["plant"])["plant"])  # it holds a model for each scene
    with pytest.raises(InputError, match="must be a MuJoCo model that extends PandaPlant"):
        prepare(replace(scenario, route="auto", fmus={"plant": plant}))


def test_what_may_be_near_depends_on_where_the_block_is():
    """The fingers 1 mm from the block's sides, and the block 1 mm above the table."""
    model = load_scene(PlantParameters())
    data = mujoco.MjData(model)
    block = np.array([0.6, 0.3, 0.251, 1.0, 0.0, 0.0, 0.0])
    scene = RouteScene(model, model.key("home").qpos, block)
    scene.opening = 0.062  # m; the block is 60 mm wide
    above = np.array([0.6, 0.3, 0.251 + 0.135, 0.0, 0.5**0.5, 0.5**0.5, 0.0])
    q = scene.posture(np.array([0.4, 0.3, 0.0, -2.0, 0.0, 2.3, -0.3]), above)
    assert q is not None
    data.qpos[:7] = q
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("hand").xpos, above[:3], atol=1e-6)
    scene.grasp(q)
    scene.release(q)
    np.testing.assert_allclose(scene.block, block, atol=1e-9)
    free = {load.name for load in Load if scene.is_free(q, load)}
    assert free == {"GRASPED", "SET_DOWN"}
