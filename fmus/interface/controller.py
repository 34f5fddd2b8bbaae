"""The interface of PandaController."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import Field, fields
from typing import Any

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT, OPENING_MAX
from ...controller.gains import WRENCH_UNITS, Gains
from .plant import CTRL_PARTS, FORCE_MAX, FORCE_PARTS, JAC_PARTS, ROBOT
from .variables import JAC_UNITS, Interface, Kind, Variability, Variable, held, input_, joints

# The inputs that command the hand's motion, and those of the posture; the others are measured.
COMMANDS = ("pos_cmd", "quat_cmd", "vel_cmd", "omega_cmd", "grip_cmd")
POSTURE_COMMANDS = ("posture_cmd", "posture_vel_cmd")
FORCE_COMMAND = "force_cmd"

# Outputs of the observer.
OBSERVED = ("external_torque", "external_force", "joint_contact")
_EXERTS = "at the hand body's origin, world frame, that would exert external_torque"
_EXTERNAL_PARTS = (
    ("external_force", 3, f"Force {_EXERTS}"), ("external_moment", 3, f"Moment {_EXERTS}"),
)  # fmt: skip

# Upper bounds below those of the gains: the FMU never exceeds the robot's limits.
MOST = {"limit_share": 1.0}
FIXED = ("reading_delay", "follow_posture", "robot", "impedance")  # from the start on
# Arrays of FMI 3.0, which have one unit each.
_PARTS = {
    "stiffness": (("stiffness", 3, "Stiffness of the hand along the world's axes"),
                  ("angular_stiffness", 3, "Stiffness of the hand about the world's axes")),
    "offset_limit": (("offset_limit", 3, "Largest force of the estimated wrench"),
                     ("offset_moment_limit", 3, "Largest moment of the estimated wrench")),
}  # fmt: skip


def parameter_of(entry: Field[Any], fixed: Collection[str] = FIXED) -> Variable:
    """Return the parameter that sets a gain, an error or a switch; it starts at its default."""
    name, about = entry.name, entry.metadata
    start: Any = entry.default
    shape = (len(start),) if isinstance(start, tuple) else ()
    variability: Variability = "fixed" if name in fixed else "tunable"
    if "range" not in about:
        kind: Kind = "Boolean" if isinstance(start, bool) else "Enumeration"
        return Variable(name, shape, "", "parameter", variability, about["text"], start, kind=kind,
                        choices=about["choices"])  # fmt: skip
    low, high = about["range"]
    start = start if shape else float(start)
    return Variable(name, shape, about["unit"], "parameter", variability, about["text"], start, low,
                    MOST.get(name, high), multiple_of=about.get("multiple_of"),
                    parts=_PARTS.get(name, ()))  # fmt: skip


CONTROLLER = Interface(
    "PandaController",
    "Differential inverse kinematics and one PID per joint, for the Panda's position servos",
    (
        input_("pos_cmd", (3,), "m", "Commanded position of the hand body's origin, world frame",
               HOME_XPOS),
        input_("quat_cmd", (4,), "1", "Commanded orientation of the hand body, world frame, "
               "(w, x, y, z)", HOME_XQUAT),
        input_("vel_cmd", (3,), "m/s", "Commanded velocity of the hand body's origin, world frame",
               0.0),
        input_("omega_cmd", (3,), "rad/s", "Commanded angular velocity of the hand body, world "
               "frame", 0.0),
        input_("grip_cmd", (), "m", "Commanded opening between the fingertips", OPENING_MAX, 0.0,
               OPENING_MAX),
        input_("posture_cmd", (7,), "rad", "Commanded joint positions, which the null space "
               "follows if follow_posture is true", HOME_Q),
        input_("posture_vel_cmd", (7,), "rad/s", "Rate of posture_cmd", 0.0),
        input_("hand_xpos", (3,), "m", "Measured position of the hand body's origin, world frame",
               HOME_XPOS),
        input_("hand_xquat", (4,), "1", "Measured orientation of the hand body, world frame, "
               "(w, x, y, z)", HOME_XQUAT),
        input_("jac", (6, 7), JAC_UNITS, "Jacobian of the hand body's origin with respect to the "
               "arm's joints, world axes; rows 1-3 linear, 4-6 angular", 0.0, parts=JAC_PARTS),
        input_("qpos", (7,), "rad", "Measured joint positions", HOME_Q),
        input_("qvel", (7,), "rad/s", "Measured joint velocities", 0.0),
        input_("qfrc_bias", (7,), "N.m", "Gravity, Coriolis and centrifugal forces of the arm",
               0.0),
        input_("actuator_force", (8,), joints("N.m", "N"), "Torques of the servos during the last "
               "step, then the force of the gripper's tendon; only the observer reads it", 0.0,
               parts=FORCE_PARTS),
        input_("force_cmd", (3,), "N", "Force added to that of the hand's springs if impedance is "
               "true, world frame", 0.0, -FORCE_MAX, FORCE_MAX),
        held("ctrl", (8,), joints("rad", "1"), "Servo targets: seven joint angles, then the "
             "gripper, 0 (closed) to 255 (open)", parts=CTRL_PARTS),
        held("dq", (7,), "rad", "Joint error that the PIDs act on"),
        held("qpos_ref", (7,), "rad", "Joint position reference"),
        held("qvel_ref", (7,), "rad/s", "Velocity of the joint reference"),
        held("manipulability", (), "1", "Yoshikawa's manipulability sqrt(det(J J^T))"),
        held("singular", (), "1", "1 while damping is raised near a singularity, else 0"),
        held("limit", (7,), "1", "Limit that binds each joint's reference: 0 none, 1 position, "
              "2 velocity, 3 acceleration, 4 jerk; with impedance, of its motor: 5 torque, 6 "
              "torque rate"),
        held("external_torque", (7,), "N.m", "External torques on the joints, estimated by a "
             "momentum observer; 0 without observer and reaction", on_request=True),
        held("external_force", (6,), WRENCH_UNITS, "Force and torque at the hand "
             "body's origin, world frame, that would exert external_torque", on_request=True,
             parts=_EXTERNAL_PARTS),
        held("joint_contact", (7,), "1", "State of each joint: 0 free; 1 contact (external_torque "
             "above the lower threshold); 2 collision (it has been above the upper one)",
             on_request=True),
        held("motor_torque", (7,), "N.m", "Torques of the arm's motors if impedance is true, else "
             "0", on_request=True),
        Variable("period", (), "s", "parameter", "fixed", "Time between two updates; outputs are "
                 "held in between", STEP_SIZE, STEP_SIZE, 1.0, multiple_of=STEP_SIZE),
        *map(parameter_of, fields(Gains)),
    ),
    {"robot": ROBOT, "command": COMMANDS},
)  # fmt: skip
