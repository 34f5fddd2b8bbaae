"""Elastic joints: a rotor behind each joint, and a spring between the two.

This is Spong's model of a flexible joint ("Modeling and Control of Elastic Joint Robots", ASME
Journal of Dynamic Systems, Measurement, and Control 109(4), 1987): the servo moves the rotor, which
has the inertia that a rigid joint has as its armature, and the spring moves the link. The rotors
come after all else, so that a rigid scene's positions, velocities and bodies keep their places.
"""

from __future__ import annotations

from typing import Any, Final

import mujoco

STIFFNESS: Final = 10_000.0  # [N.m/rad] of each joint
DAMPING: Final = 10.0  # [N.m.s/rad] of each spring
_MASS, _INERTIA = 1e-3, 1e-9  # [kg], [kg.m^2] of a rotor's body; its inertia is the armature


def add_rotors(spec: Any) -> None:
    """Put a rotor and a spring between each servo and its joint of a scene (`mujoco.MjSpec`)."""
    for number in range(1, 8):
        joint, servo = spec.joint(f"joint{number}"), spec.actuator(f"actuator{number}")
        rotor = spec.worldbody.add_body(name=f"rotor{number}")
        rotor.mass, rotor.inertia, rotor.explicitinertial = _MASS, [_INERTIA] * 3, True
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
