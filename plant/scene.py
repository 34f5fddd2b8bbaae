"""The plant's scene: compiled from MJCF, with the block that the parameters describe.

Its joints may be elastic: a rotor behind each joint, and a spring between the two. This is Spong's
model of a flexible joint ("Modeling and Control of Elastic Joint Robots", ASME Journal of Dynamic
Systems, Measurement, and Control 109(4), 1987): the servo moves the rotor, which has the inertia
that a rigid joint has as its armature, and the spring moves the link. The rotors come after all
else, so that a rigid scene's positions, velocities and bodies keep their places.
"""

from __future__ import annotations

import math
from copy import copy
from typing import Any, Final

import mujoco

from ..assets import ELASTIC, scene_file
from ..assets.arm import read_spec
from ..assets.fields import as_arrays
from .parameters import BLOCK, MOVING_LINKS, PlantParameters, block_start_height

STIFFNESS: Final = 10_000.0  # [N.m/rad] of each joint
DAMPING: Final = 10.0  # [N.m.s/rad] of each spring
_MASS, _INERTIA = 1e-3, 1e-9  # [kg], [kg.m^2] of a rotor's body; its inertia is the armature


def add_rotors(spec: Any) -> None:
    """Put a rotor and a spring between each servo and its joint of a scene (`mujoco.MjSpec`)."""
    for number in range(1, 8):
        joint, servo = spec.joint(f"joint{number}"), spec.actuator(f"actuator{number}")
        rotor = spec.worldbody.add_body(name=f"rotor{number}")
        rotor.mass, rotor.inertia, rotor.ipos = _MASS, [_INERTIA] * 3, [0, 0, 0]
        rotor.explicitinertial = True
        rotor.add_joint(name=f"rotor_joint{number}", axis=[0, 0, 1], armature=joint.armature)
        joint.armature = 0.0
        servo.target = f"rotor_joint{number}"
        spring = spec.add_tendon(name=f"spring{number}", springlength=[0, 0])
        spring.stiffness, spring.damping = [STIFFNESS, 0, 0], [DAMPING, 0, 0]  # linear
        spring.wrap_joint(f"joint{number}", 1.0)
        spring.wrap_joint(f"rotor_joint{number}", -1.0)
    home = spec.key("home")
    positions = list(home.qpos)
    home.qpos = [*positions, *positions[:7]]


def stretch_springs(model: Any) -> None:
    """Turn the rotors of the keyframe `home` so far that the springs carry the arm's weight."""
    data = mujoco.MjData(model)
    home = model.key("home")
    mujoco.mj_resetDataKeyframe(model, data, home.id)
    mujoco.mj_forward(model, data)
    home.qpos[-7:] = home.qpos[:7] + data.qfrc_bias[:7] / STIFFNESS


def load_scene(parameters: PlantParameters, *, drawn: bool = False) -> Any:
    """Compile a scene (`mujoco.MjModel`) and make block and arm what the parameters say."""
    # A `drawn` one has shapes that are only drawn, which cost a sixth of `mj_step` and change no
    # bit of it; it has no rotors, as no output tells where they are.
    _, model = compiled_scene(parameters, drawn=drawn)
    body, geom = model.body(BLOCK).id, model.geom("obj_geom").id
    # A box's inertia is proportional to its mass.
    model.body_inertia[body] *= parameters.block_mass / model.body_mass[body]
    model.body_mass[body] = parameters.block_mass
    # The block's geom has priority over all others, so its friction applies to all its contacts.
    model.geom_friction[geom, 0] = parameters.block_friction
    _change_arm(model, parameters)
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # the inverse weights that the solver scales by
    return model


def compiled_scene(parameters: PlantParameters, *, drawn: bool = False) -> tuple[Any, Any]:
    """Compile a scene as its file has it; returns `mujoco.MjSpec` and `mujoco.MjModel`."""
    spec = read_spec(scene_file(parameters.scene), parameters.robot)
    spec.compiler.discardvisual = not drawn
    if drawn or parameters.scene != ELASTIC:
        return spec, spec.compile()
    add_rotors(spec)
    model = spec.compile()
    stretch_springs(model)
    return spec, model


def _change_arm(model: Any, parameters: PlantParameters) -> None:
    """Change the arm, so that it differs from the controller's model."""
    given = as_arrays(parameters)
    model.dof_frictionloss[:7] += given.joint_friction
    model.dof_damping[:7] += given.joint_viscous
    links = [model.body(name).id for name in MOVING_LINKS]
    model.body_mass[links] *= given.link_mass_scale
    model.body_inertia[links] *= given.link_mass_scale[:, None]
    model.actuator_gainprm[:7] *= given.servo_scale[:, None]
    model.actuator_biasprm[:7] *= given.servo_scale[:, None]
    model.actuator_forcerange[:7] *= given.torque_limit_scale[:, None]
    model.body_mass[model.body("hand").id] += given.payload


def place_block(model: Any, data: Any, parameters: PlantParameters) -> None:
    """Put the block on floor or table, with the arm at `home`; refuses a place inside something."""
    joint = data.joint("obj_freejoint")
    x, y = parameters.block_pos
    half_yaw = parameters.block_yaw / 2
    joint.qpos[:3] = x, y, block_start_height(x, y)
    joint.qpos[3:] = math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)
    tried = copy(data)  # so that `data` has no forces yet
    mujoco.mj_forward(model, tried)
    block = model.geom("obj_geom").id
    for contact in tried.contact[: tried.ncon]:
        if block in contact.geom and contact.dist < -1e-4:  # [m]; resting contact is above it
            other = int(contact.geom[0] if contact.geom[1] == block else contact.geom[1])
            name = model.geom(other).name or model.body(model.geom_bodyid[other]).name
            raise ValueError(
                f"block_pos: the block at ({x:g}, {y:g}) m would start "
                f"{-1000 * contact.dist:.1f} mm inside {name!r}; choose a free place"
            )
