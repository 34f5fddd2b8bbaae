"""The plant's scene: compiled from MJCF, with the block that the parameters describe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import mujoco

from ..assets import SCENES, asset_files

TABLE_TOP = 0.2  # [m] height of the table's top above the floor (scene files)
TABLE_CENTRE = (0.65, 0.30)  # [m] x and y in the world frame (scene files)
TABLE_HALF_SIZE = (0.2, 0.2)  # [m] (scene files)
BLOCK_HALF_HEIGHT = 0.05  # [m] (scene files)
MASS_RANGE = (0.001, 3.0)  # [kg] up to the arm's rated payload (Franka data sheet)
FRICTION_RANGE = (0.01, 5.0)  # [1] sliding friction; MuJoCo's lower bound is 1e-5
POSITION_RANGE = (-1.0, 1.0)  # [m] the floor's half size (scene files)
YAW_RANGE = (-math.pi, math.pi)  # [rad]
JOINT_FRICTION_RANGE = (0.0, 100.0)  # [N.m]
JOINT_VISCOUS_RANGE = (0.0, 1000.0)  # [N.m.s/rad]
SCALE_RANGE = (0.1, 10.0)  # [1] of what the model has
PAYLOAD_RANGE = (0.0, 5.0)  # [kg]
Seven = tuple[float, float, float, float, float, float, float]
_ZEROS: Seven = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ONES: Seven = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
_RANGES = {
    "joint_friction": (JOINT_FRICTION_RANGE, "N.m"),
    "joint_viscous": (JOINT_VISCOUS_RANGE, "N.m.s/rad"),
    "link_mass_scale": (SCALE_RANGE, "1"),
    "servo_scale": (SCALE_RANGE, "1"),
    "torque_limit_scale": (SCALE_RANGE, "1"),
}


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of a plant.

    Attributes:
        scene: Name of the MJCF scene, one of `assets.SCENES`.
        block_pos: Where the block's centre starts, x and y in the world frame [m].
        block_yaw: Turn of the block about the world's z axis at the start [rad].
        block_mass: Mass of the block [kg].
        block_friction: Sliding friction of each contact of the block [1].
        joint_friction: Coulomb friction that each joint has beyond the model's [N.m].
        joint_viscous: Viscous friction that each joint has beyond the model's [N.m.s/rad].
        link_mass_scale: Mass and inertia of each link, as a share of the model's [1].
        servo_scale: Stiffness and damping of each servo, as a share of the model's [1].
        torque_limit_scale: Largest torque of each servo, as a share of the model's [1].
        payload: Point mass at the hand's centre of mass [kg].

    Raises:
        ValueError: A value is out of its range or the scene is unknown.
    """

    scene: str = "tabletop"
    block_pos: tuple[float, float] = (0.4, -0.2)
    block_yaw: float = 0.0
    block_mass: float = 0.18
    block_friction: float = 1.0
    joint_friction: Seven = _ZEROS
    joint_viscous: Seven = _ZEROS
    link_mass_scale: Seven = _ONES
    servo_scale: Seven = _ONES
    torque_limit_scale: Seven = _ONES
    payload: float = 0.0

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            near = get_close_matches(self.scene, SCENES, n=1, cutoff=0.0)
            raise ValueError(
                f"scene: {self.scene!r} is not a scene; valid: {', '.join(SCENES)} "
                f"(did you mean {near[0]!r}?)"
            )
        _check("block_pos[1]", self.block_pos[0], POSITION_RANGE, "m")
        _check("block_pos[2]", self.block_pos[1], POSITION_RANGE, "m")
        _check("block_yaw", self.block_yaw, YAW_RANGE, "rad")
        _check("block_mass", self.block_mass, MASS_RANGE, "kg")
        _check("block_friction", self.block_friction, FRICTION_RANGE, "1")
        _check("payload", self.payload, PAYLOAD_RANGE, "kg")
        for name, (bounds, unit) in _RANGES.items():
            for i, value in enumerate(getattr(self, name), start=1):
                _check(f"{name}[{i}]", value, bounds, unit)


def _check(name: str, value: float, bounds: tuple[float, float], unit: str) -> None:
    """Refuse a value that is not finite or not within its bounds."""
    low, high = bounds
    if not low <= value <= high:  # false for NaN, too
        raise ValueError(f"{name}: {value!r} {unit} is out of range [{low:g}, {high:g}] {unit}")


def load_scene(parameters: PlantParameters) -> Any:
    """Compile a scene and make block and arm what the parameters say.

    Args:
        parameters: What block and arm are.

    Returns:
        The `mujoco.MjModel`.
    """
    name = f"{parameters.scene}.xml"
    files = asset_files()
    model = mujoco.MjModel.from_xml_string(files[name].decode(), assets=files)
    body, geom = model.body("obj").id, model.geom("obj_geom").id
    # A box's inertia is proportional to its mass.
    model.body_inertia[body] *= parameters.block_mass / model.body_mass[body]
    model.body_mass[body] = parameters.block_mass
    # The block's geom has priority over all others, so its friction applies to all its contacts.
    model.geom_friction[geom, 0] = parameters.block_friction
    _change_arm(model, parameters)
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # the inverse weights that the solver scales by
    return model


def _change_arm(model: Any, parameters: PlantParameters) -> None:
    """Make the arm another than the one that the controller's model describes."""
    model.dof_frictionloss[:7] += parameters.joint_friction
    model.dof_damping[:7] += parameters.joint_viscous
    for joint in range(7):
        link = model.body(f"link{joint + 1}").id
        servo = model.actuator(f"actuator{joint + 1}").id
        model.body_mass[link] *= parameters.link_mass_scale[joint]
        model.body_inertia[link] *= parameters.link_mass_scale[joint]
        model.actuator_gainprm[servo] *= parameters.servo_scale[joint]
        model.actuator_biasprm[servo] *= parameters.servo_scale[joint]
        model.actuator_forcerange[servo] *= parameters.torque_limit_scale[joint]
    model.body_mass[model.body("hand").id] += parameters.payload


def block_start_height(x: float, y: float) -> float:
    """Height of the block's centre at the start [m], standing on the floor or on the table.

    Args:
        x: World position of its centre [m].
        y: World position of its centre [m].
    """
    over_table = all(
        abs(place - centre) <= half
        for place, centre, half in zip((x, y), TABLE_CENTRE, TABLE_HALF_SIZE, strict=True)
    )
    return BLOCK_HALF_HEIGHT + (TABLE_TOP if over_table else 0.0)


def place_block(model: Any, data: Any, parameters: PlantParameters) -> None:
    """Put the block where the parameters say, on the floor or on the table.

    Args:
        model: The scene.
        data: Its data, at the keyframe `home`; changed in place and forwarded.
        parameters: Where the block starts.

    Raises:
        ValueError: The block would start inside something else.
    """
    joint = data.joint("obj_freejoint")
    x, y = parameters.block_pos
    half_yaw = parameters.block_yaw / 2
    joint.qpos[:3] = x, y, block_start_height(x, y)
    joint.qpos[3:] = math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)
    mujoco.mj_forward(model, data)
    _refuse_overlap(model, data)


def _refuse_overlap(model: Any, data: Any) -> None:
    """Refuse a start in which the block stands inside something."""
    block = model.geom("obj_geom").id
    for contact in data.contact[: data.ncon]:
        if block in contact.geom and contact.dist < -1e-4:  # [m]; resting contact is above it
            other = int(contact.geom[0] if contact.geom[1] == block else contact.geom[1])
            name = model.geom(other).name or model.body(model.geom_bodyid[other]).name
            x, y = data.qpos[9:11]
            raise ValueError(
                f"block_pos: the block at ({x:g}, {y:g}) m would start "
                f"{-1000 * contact.dist:.1f} mm inside {name!r}; choose a free place"
            )
