"""Plans the table of a scenario with `route = "auto"`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ...fmus.errors import InputError
from ...plant.parameters import PlantParameters
from ...plant.scene import BLOCK_HALF_HEIGHT, load_scene
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
    scenario, values = prepared.scenario, prepared.values
    start = start_pose(values["plant"], values.get("sensors"))
    centre = np.array(start.target_position) - np.array([0.0, 0.0, BLOCK_HALF_HEIGHT])
    block = np.concatenate((centre, rotations.about_z(start.block_yaw)))
    model, qpos = _scene(prepared)
    mass = float(values["plant"].get("block_mass", 0.0))
    return route(scenario, RouteScene(model, qpos, block), mass)


def _scene(prepared: Prepared) -> tuple[Any, Any]:
    """Return the plant's model, and where everything in it is at the start, qpos."""
    if "plant" not in prepared.scenario.fmus:
        model = load_scene(PlantParameters())  # the scenes differ in what no route depends on
        return model, model.key("home").qpos
    plant = prepared.assembly.interfaces["plant"]
    content = model_in(prepared.assembly.system.fmus["plant"])
    if not content or not any(v.name == "block_pos" for v in plant.variables):
        raise InputError(
            f"[fmus] plant: value {prepared.scenario.fmus['plant']!r}; must be a MuJoCo model that "
            "extends PandaPlant, for a route to be planned in it"
        )
    with prepared.open([]) as system:
        qpos = system.slaves["plant"].get_real(plant.variable("qpos").names())
    return mujoco.MjModel.from_binary_path("plant.mjb", {"plant.mjb": content}), qpos
