"""The interface of PandaPlant."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...assets import SCENES
from ...assets.franka import CTRL_OPEN, HOME_Q, ROBOTS, TORQUE_MAX
from ...plant.parameters import (
    ARM_AND_PALM,
    ARM_JOINTS,
    BLOCK,
    FINGERS,
    MOVING_LINKS,
    RANGES,
    UNITS,
    PlantParameters,
)
from .variables import JAC_UNITS, Interface, Variable, input_, joints, output

# Input by pushed body.
FORCES = {"hand": "push_force", "block": "block_force"} | {n: f"{n}_force" for n in MOVING_LINKS}
FORCE_MAX = 1000.0  # [N] far above any realistic push
HOME_CTRL = (*HOME_Q, CTRL_OPEN)  # keyframe `home` of the scenes
CTRL_MIN = (*np.min([robot.q_min for robot in ROBOTS.values()], axis=0).tolist(), 0.0)
CTRL_MAX = (*np.max([robot.q_max for robot in ROBOTS.values()], axis=0).tolist(), CTRL_OPEN)
# What plant and controller exchange.
ROBOT = ("hand_xpos", "hand_xquat", "jac", "qpos", "qvel", "qfrc_bias", "ctrl")
_CTRL_UNITS = joints("rad", "1")
# Arrays of FMI 3.0, which have one unit each.
CTRL_PARTS = (
    ("ctrl", 7, "Servo targets of the arm's joints"),
    ("ctrl_gripper", 1, "Servo target of the gripper, 0 (closed) to 255 (open)"),
)
_QPOS_PARTS = (
    ("qpos", 7, "Positions of the arm's joints"),
    ("qpos_fingers", 2, "Positions of the fingers"),
    ("qpos_block", 3, "Block's centre, world frame"),
    ("qpos_block_quat", 4, "Block's orientation, world frame, (w, x, y, z)"),
)
_QVEL_PARTS = (
    ("qvel", 7, "Velocities of the arm's joints"),
    ("qvel_fingers", 2, "Velocities of the fingers"),
    ("qvel_block", 3, "Velocity of the block's centre, world frame"),
    ("qvel_block_omega", 3, "Angular velocity of the block, in its own frame"),
)
FORCE_PARTS = (
    ("actuator_force", 7, "Torques of the arm's servos during the last step"),
    ("actuator_force_gripper", 1, "Force of the gripper's tendon during the last step"),
)
_JAC = "of the Jacobian of the hand body's origin with respect to the arm's joints, world axes"
JAC_PARTS = (("jac", 3, f"Linear rows {_JAC}"), ("jac_angular", 3, f"Angular rows {_JAC}"))
_BLOCK = PlantParameters()
_TOUCHING = " ".join((BLOCK, *FINGERS, *ARM_AND_PALM))
_LINKS = " ".join(MOVING_LINKS)
_SERVOS = " ".join(f"actuator{i}" for i in range(1, 8))


def _parameter(name: str, source: str, description: str) -> Variable:
    """Return a parameter of the plant, or one with a value per joint."""
    start: Any = getattr(_BLOCK, name)
    shape = (len(start),) if isinstance(start, tuple) else ()
    return Variable(name, shape, UNITS[name], "parameter", "fixed", description, start,
                    *RANGES[name], source=source)  # fmt: skip


PLANT = Interface(
    "PandaPlant",
    "Franka Emika Panda with gripper, table and block, simulated by MuJoCo at 1 ms",
    (
        input_("ctrl", (8,), _CTRL_UNITS, "Servo targets: seven joint angles, then the gripper, "
               "0 (closed) to 255 (open)", HOME_CTRL, CTRL_MIN, CTRL_MAX, source="ctrl",
               parts=CTRL_PARTS),
        input_("push_force", (3,), "N", "Force that pushes the hand at its centre of mass, "
               "world frame", 0.0, -FORCE_MAX, FORCE_MAX, source="body hand force"),
        input_("block_force", (3,), "N", "Force that pushes the block at its centre, world frame",
               0.0, -FORCE_MAX, FORCE_MAX, source="body obj force"),
        input_("torque", (7,), "N.m", "Torques of the arm's motors, in the scene `motors`, where "
               "ctrl moves the gripper alone", 0.0, tuple((-TORQUE_MAX).tolist()),
               tuple(TORQUE_MAX.tolist()), source="motors"),
        *(input_(FORCES[link], (3,), "N", f"Force that pushes {link} at its centre of mass, world "
                 "frame", 0.0, -FORCE_MAX, FORCE_MAX, source=f"body {link} force")
          for link in MOVING_LINKS),
        output("qpos", (16,), joints("rad", *"mmmmm1111"), "MuJoCo positions: 7 arm joints, 2 "
                "fingers, block centre in the world frame, block quaternion (w, x, y, z)",
                source="qpos", parts=_QPOS_PARTS),
        output("qvel", (15,), joints("rad/s", *["m/s"] * 5, *["rad/s"] * 3), "MuJoCo velocities: "
                "7 arm joints, 2 fingers, block linear in the world frame, block angular in its "
                "own frame", source="qvel", parts=_QVEL_PARTS),
        output("hand_xpos", (3,), "m", "Origin of the hand body, world frame",
                source="body hand xpos"),
        output("hand_xquat", (4,), "1", "Orientation of the hand body, world frame, (w, x, y, z)",
                source="body hand xquat"),
        output("target_xpos", (3,), "m", "Centre of the block's top face, world frame",
                source="site target xpos"),
        output("target_xmat", (9,), "1", "Rotation matrix of the block, row by row, world frame",
                source="site target xmat"),
        output("jac", (6, 7), JAC_UNITS, "Jacobian of the hand body's origin with respect to the "
                "arm's joints, world axes; rows 1-3 linear, 4-6 angular",
                source=f"body hand jacobian {' '.join(ARM_JOINTS)}", parts=JAC_PARTS),
        output("qfrc_bias", (7,), "N.m", "Gravity, Coriolis and centrifugal forces of the arm",
                source="qfrc_bias"),
        output("actuator_force", (8,), joints("N.m", "N"), "Forces of the actuators during the "
                "last step: seven joints, gripper tendon", source="actuator_force",
                parts=FORCE_PARTS),
        output("contact_force", (), "N", "Total normal force of the fingers on the block during "
                "the last step",
                source="contact_sensors left_finger_contact right_finger_contact"),
        output("unwanted_contact_force", (), "N", "Total normal force, during the last step, of "
                "arm and palm on anything, of the fingers on what cannot move, and of anything but "
                "fingers on the block's sides (normal more than 45 deg from vertical)",
                source=f"unwanted_contacts {_TOUCHING}"),
        output("support_force", (), "N", "Total normal force of the block's other contacts, "
                "without the fingers', during the last step: what carries it",
                source=f"support_contacts {_TOUCHING}"),
        output("table_force", (), "N", "Total normal force of the fingers on the table during "
                "the last step", source="contact_bodies work_space left_finger right_finger",
                on_request=True),
        output("mass_matrix", (7, 7), "kg.m2", "Joint-space inertia matrix of the arm, rotor "
                "inertia included", source=f"mass_matrix {' '.join(ARM_JOINTS)}",
                on_request=True),
        Variable("scene", (), "", "parameter", "fixed", "MJCF scene: tabletop (strong gripper, "
                 "firm contacts), tutorial (the published task's numbers), motors (tabletop with "
                 "torque-driven joints) or elastic (tabletop with a spring of 10 kN.m/rad in each "
                 "joint)", _BLOCK.scene,
                 kind="Enumeration", choices=SCENES, source="scene"),
        Variable("robot", (), "", "parameter", "fixed", "The arm: panda (Franka Emika "
                 "Panda) or fr3 (Franka Research 3)", _BLOCK.robot,
                 kind="Enumeration", choices=tuple(ROBOTS), source="scene"),
        _parameter("block_pos", "body obj free_xy clear stand floor table", "Start position of the "
                   "block's centre, x and y, world frame"),
        _parameter("block_yaw", "body obj free_yaw", "Rotation of the block about the world's z "
                   "axis at the start"),
        _parameter("block_mass", "body obj mass", "Mass of the block"),
        _parameter("block_friction", "geom obj_geom friction", "Sliding friction coefficient of "
                   "all contacts of the block"),
        _parameter("joint_friction", "added dof_frictionloss 0 7", "Coulomb friction of each joint "
                   "in addition to the model's"),
        _parameter("joint_viscous", "added dof_damping 0 7", "Viscous friction of each joint in "
                   "addition to the model's"),
        _parameter("link_mass_scale", f"scaled_mass {_LINKS}", "Mass and inertia of each link, "
                   "relative to the model's"),
        _parameter("servo_scale", f"scaled_servo {_SERVOS}", "Stiffness and damping of each servo, "
                   "relative to the model's"),
        _parameter("torque_limit_scale", f"scaled_force {_SERVOS}", "Largest torque of each servo, "
                   "relative to the model's"),
        _parameter("payload", "body hand added_mass", "Point mass at the hand's centre of mass, "
                   "unknown to the controller"),
    ),
    {"robot": ROBOT},
    is_model=True,
)  # fmt: skip
