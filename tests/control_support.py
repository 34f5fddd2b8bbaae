"""What several tests of the controller need."""

from panda_cosim.assets.franka import OPENING_MAX
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.plant.plant import Plant
from random_tasks import connect


def hold(plant: Plant, controller: Controller) -> None:
    """Command the hand to stay where it is, with open fingers."""
    connect(plant, controller)
    controller.inputs["pos_cmd"] = plant.outputs["hand_xpos"]
    controller.inputs["quat_cmd"] = plant.outputs["hand_xquat"]
    controller.inputs["vel_cmd"] = controller.inputs["omega_cmd"] = 0.0
    controller.inputs["grip_cmd"] = OPENING_MAX


def started(gains: Gains | None = None, period: float = 0.001) -> tuple[Plant, Controller]:
    """Return a plant at home and a controller that holds it."""
    plant, controller = Plant(), Controller(gains or Gains(), period)
    hold(plant, controller)
    return plant, controller
