"""The plant's scene: compiled from MJCF, with the block that the parameters describe."""

from __future__ import annotations

import math
from typing import Any

import mujoco

from ..assets import ELASTIC, scene_file
from ..assets.arm import read_spec
from .elastic import add_rotors, stretch_springs
from .parameters import PlantParameters, block_start_height


def load_scene(parameters: PlantParameters, *, drawn: bool = False) -> Any:
    """Compile a scene (`mujoco.MjModel`) and make block and arm what the parameters say.

    One that is `drawn`, for a picture of the outputs, has shapes that are only drawn, which cost a
    sixth of `mj_step` and change no bit of it; it has no rotors, as no output tells where they are.
    """
    model = _compiled(parameters, drawn=drawn)
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


def _compiled(parameters: PlantParameters, *, drawn: bool) -> Any:
    spec = read_spec(scene_file(parameters.scene), parameters.robot)
    spec.compiler.discardvisual = not drawn
    if drawn or parameters.scene != ELASTIC:
        return spec.compile()
    add_rotors(spec)
    model = spec.compile()
    stretch_springs(model)
    return model


def _change_arm(model: Any, parameters: PlantParameters) -> None:
    """Change the arm, so that it differs from the controller's model."""
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


def place_block(model: Any, data: Any, parameters: PlantParameters) -> None:
    """Put the block where the parameters say, on floor or table, with the arm at `home`.

    A ValueError refuses a block that would start inside something else.
    """
    joint = data.joint("obj_freejoint")
    x, y = parameters.block_pos
    half_yaw = parameters.block_yaw / 2
    joint.qpos[:3] = x, y, block_start_height(x, y)
    joint.qpos[3:] = math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)
    mujoco.mj_forward(model, data)
    block = model.geom("obj_geom").id
    for contact in data.contact[: data.ncon]:
        if block in contact.geom and contact.dist < -1e-4:  # [m]; resting contact is above it
            other = int(contact.geom[0] if contact.geom[1] == block else contact.geom[1])
            name = model.geom(other).name or model.body(model.geom_bodyid[other]).name
            raise ValueError(
                f"block_pos: the block at ({x:g}, {y:g}) m would start "
                f"{-1000 * contact.dist:.1f} mm inside {name!r}; choose a free place"
            )
