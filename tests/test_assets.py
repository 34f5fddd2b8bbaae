"""The MJCF models carry the arm's published numbers and have clean contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from assets import SCENES, asset_path

HOME_POSITION = (0.554499478, 0.0, 0.624502429)  # hand in the world [m]
HOME_ATTITUDE = (0.0, 0.7071, 0.7071, 0.0)  # hand in the world, quaternion w x y z


@pytest.mark.parametrize("scene", SCENES)
def test_scene_has_the_tasks_sizes_and_home_pose(scene: str) -> None:
    """The scene has nq 16, nv 15, nu 8, and at `home` the hand is where the task has it."""
    model = mujoco.MjModel.from_xml_path(str(asset_path(f"{scene}.xml")))
    data = mujoco.MjData(model)
    assert (model.nq, model.nv, model.nu) == (16, 15, 8)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("hand").xpos, HOME_POSITION, atol=1e-9)
    np.testing.assert_allclose(data.body("hand").xquat, HOME_ATTITUDE, atol=1e-4)
