"""The interface of PandaPlant; `plant.toml` says what its variables are."""

from __future__ import annotations

import numpy as np

from ...assets.franka import CTRL_OPEN, HOME_Q, ROBOTS, TORQUE_MAX
from ...plant.parameters import MOVING_LINKS, PlantParameters
from ...plant.signals import INPUTS, OUTPUTS
from .engine import COUNTED
from .own import Values, parameters, read_table, signals
from .variables import Interface

# Input by pushed body.
FORCES = {"hand": "push_force", "block": "block_force"} | {n: f"{n}_force" for n in MOVING_LINKS}
FORCE_MAX = 1000.0  # [N] far above any realistic push
HOME_CTRL = (*HOME_Q, CTRL_OPEN)  # keyframe `home` of the scenes
CTRL_MIN = (*np.min([robot.q_min for robot in ROBOTS.values()], axis=0).tolist(), 0.0)
CTRL_MAX = (*np.max([robot.q_max for robot in ROBOTS.values()], axis=0).tolist(), CTRL_OPEN)
# What plant and controller exchange.
ROBOT = ("hand_xpos", "hand_xquat", "jac", "qpos", "qvel", "qfrc_bias", "ctrl")

_TABLE = read_table("plant")
_VALUES: dict[str, Values] = {
    "ctrl": (HOME_CTRL, CTRL_MIN, CTRL_MAX),
    "torque": (0.0, tuple((-TORQUE_MAX).tolist()), tuple(TORQUE_MAX.tolist())),
    **dict.fromkeys(FORCES.values(), (0.0, -FORCE_MAX, FORCE_MAX)),
}
PLANT = Interface(
    "PandaPlant",
    _TABLE["description"],
    (
        *signals(_TABLE["input"], INPUTS, "input", _VALUES),
        *signals(_TABLE["output"], OUTPUTS, "output"),
        *parameters(_TABLE["parameter"], PlantParameters, fixed=_TABLE["parameter"]),
        COUNTED,
    ),
    {"robot": ROBOT},
    is_model=True,
)
