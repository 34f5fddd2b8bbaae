"""Plans the table of a scenario with `route = "auto"`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from ...fmus.errors import InputError
from ...plant.parameters import BLOCK_HALF_HEIGHT, PlantParameters
from ...plant.scene import load_scene
from .. import rotations
from ..route.route import route
from ..route.scene import RouteScene
from ..scenario.scenario import Scenario
from .folder import model_in
from .start import start_pose

if TYPE_CHECKING:
    from .prepare import Prepared


def routed(prepared: Prepared) -> Scenario:
    """Return the scenario with its table, for the block where the camera sees it."""
    scenario, plant = prepared.scenario, prepared.values["plant"]
    mass = float(plant.get("block_mass", 0.0))
    start = start_pose(plant, prepared.values.get("sensors"))
    centre = np.array(start.target_position) - np.array([0.0, 0.0, BLOCK_HALF_HEIGHT])
    block = np.concatenate((centre, rotations.about_z(start.block_yaw)))
    if "plant" not in scenario.fmus:
        # No route depends on what the scenes differ in.
        model = load_scene(PlantParameters(robot=scenario.robot))
        qpos = model.key("home").qpos
        return route(scenario, RouteScene(model, qpos, block, scenario.robot), mass)
    outputs = prepared.assembly.interfaces["plant"]
    content = model_in(prepared.assembly.system.fmus["plant"])
    if not content or "block_mass" not in plant:
        raise InputError(
            f"[fmus] plant: value {scenario.fmus['plant']!r}; must be a MuJoCo model that extends "
            "PandaPlant, for a route to be planned in it"
        )
    names = outputs.variable("qpos").names()
    qpos = np.empty((1, len(names)))
    with prepared.open([]) as system:
        system.slaves["plant"].bind_get(names, qpos)(0)
    model = mujoco.MjModel.from_binary_path("plant.mjb", {"plant.mjb": content})
    return route(scenario, RouteScene(model, qpos[0], block, scenario.robot), mass)
