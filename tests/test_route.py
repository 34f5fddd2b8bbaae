"""Planned routes: the block is grasped and set down, and nothing else is touched."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from fmu_support import in_process
from forked import command
from panda_cosim import Recording, load_scenario, run_scenario
from panda_cosim.assets.franka import Q_MAX, Q_MIN, QD_MAX, QDD_MAX
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.scene import load_scene
from panda_cosim.scenarios.route.scene import Load, RouteScene

pytest.importorskip("ompl")

BEHIND = "plant.block_pos=-0.4,0.3"  # where the shipped table does not lead
POSTURE_TOLERANCE = 1e-3  # rad between the arm and its plan


@pytest.fixture(scope="module")
def routed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("route") / "behind"
    result = command("route", "pick_and_place", "--out", folder, "--set", BEHIND)
    assert result.returncode == 0, result.stderr
    return folder


def record(folder: str, out: str) -> bool | None:
    return run_scenario(load_scenario(Path(folder)), out).summary.success


@pytest.mark.fmu
def test_a_block_behind_the_arm_is_set_down_within_all_limits(routed: Path, tmp_path: Path) -> None:
    assert in_process(record, str(routed), str(tmp_path / "run"))
    recording = Recording.open(tmp_path / "run")
    q, rate = recording["plant.qpos"][:, :7], recording["controller.qvel_ref"]
    assert recording["plant.unwanted_contact_force"].max() == 0.0
    assert not recording["controller.limit"].any()
    assert (np.minimum(q - Q_MIN, Q_MAX - q) > 0.05).all()
    assert (np.abs(rate) <= 0.9 * QD_MAX).all()
    assert (np.abs(np.diff(rate, axis=0)) / 0.001 <= 0.9 * QDD_MAX).all()
    assert np.abs(q - recording["controller.posture_cmd"]).max() < POSTURE_TOLERANCE


def test_the_same_input_gives_the_same_bytes(routed: Path, tmp_path: Path) -> None:
    command("route", "pick_and_place", "--out", tmp_path / "again", "--set", BEHIND)
    for file in ("scenario.toml", "trajectory.csv"):
        assert (tmp_path / "again" / file).read_bytes() == (routed / file).read_bytes()


def test_a_block_out_of_reach_is_refused_with_a_place_that_works(tmp_path: Path) -> None:
    words = ("route", "pick_and_place", "--out", tmp_path / "a", "--set")
    far = command(*words, "plant.block_pos=0.9,0.4")
    assert far.returncode == 2
    assert not (tmp_path / "a").exists()
    assert "no posture of the arm grasps and lifts the block" in far.stderr
    nearest = re.search(r"plant\.block_pos=[-\d.,]+", far.stderr)
    assert nearest
    near = command(*words, nearest.group())
    assert near.returncode == 0, near.stderr


def test_what_may_be_near_depends_on_where_the_block_is() -> None:
    """The fingers 1 mm from the block's sides, and the block 1 mm above the table."""
    model = load_scene(PlantParameters())
    data = mujoco.MjData(model)
    scene = RouteScene(model, np.array([0.6, 0.3, 0.251, 1.0, 0.0, 0.0, 0.0]))
    scene.opening = 0.062  # m; the block is 60 mm wide
    above = np.array([0.6, 0.3, 0.251 + 0.135, 0.0, 0.5**0.5, 0.5**0.5, 0.0])
    q = scene.posture(np.array([0.4, 0.3, 0.0, -2.0, 0.0, 2.3, -0.3]), above)
    assert q is not None
    data.qpos[:7] = q
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("hand").xpos, above[:3], atol=1e-6)
    scene.grasp(q)
    np.testing.assert_allclose(scene.held_block(q), scene.block, atol=1e-9)
    free = {load.name for load in Load if scene.is_free(q, load)}
    assert free == {"GRASPED", "SET_DOWN"}
