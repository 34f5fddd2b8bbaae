"""The interface of PandaController."""

from __future__ import annotations

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT, OPENING_MAX, ROBOTS
from ...controller.gains import RANGES, REACTIONS, Gains
from .plant import CTRL_PARTS, FORCE_MAX, FORCE_PARTS, JAC_PARTS, ROBOT
from .variables import JAC_UNITS, Interface, Variability, Variable, held, input_, joints

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

_GAINS = Gains()
_WRENCH_UNITS = (*["N"] * 3, *["N.m"] * 3), (*["N/m"] * 3, *["N.m/rad"] * 3)
# Upper bounds below those of `controller.gains.RANGES`: the FMU never exceeds the robot's limits.
MOST = {"limit_share": 1.0}


def _gain(
    name: str,
    unit: str | tuple[str, ...],
    description: str,
    variability: Variability = "tunable",
    parts: tuple[tuple[str, int, str], ...] = (),
) -> Variable:
    """Return a parameter that starts at its value in the default gains."""
    start = getattr(_GAINS, name)
    shape = (len(start),) if isinstance(start, tuple) else ()
    low, high = RANGES[name]
    high = MOST.get(name, high)
    return Variable(
        name, shape, unit, "parameter", variability, description, start, low, high, parts=parts
    )


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
        input_("jac", (6, 7), JAC_UNITS, "Jacobian of the hand body's origin by the arm's joints, "
               "world axes; rows 1-3 linear, 4-6 angular", 0.0, parts=JAC_PARTS),
        input_("qpos", (7,), "rad", "Measured joint positions", HOME_Q),
        input_("qvel", (7,), "rad/s", "Measured joint velocities", 0.0),
        input_("qfrc_bias", (7,), "N.m", "Gravity, Coriolis and centrifugal forces of the arm",
               0.0),
        input_("actuator_force", (8,), joints("N.m", "N"), "Torques of the servos during the last "
               "step, then the force of the gripper's tendon; only the observer reads it", 0.0,
               parts=FORCE_PARTS),
        input_("force_cmd", (3,), "N", "Force that the hand adds to its springs if impedance is "
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
        held("external_torque", (7,), "N.m", "Torques of others on the joints, by a momentum "
             "observer; 0 without observer and reaction", on_request=True),
        held("external_force", (6,), (*["N"] * 3, *["N.m"] * 3), "Force and torque at the hand "
             "body's origin, world frame, that would exert external_torque", on_request=True,
             parts=_EXTERNAL_PARTS),
        held("joint_contact", (7,), "1", "Of each joint: 0 free, 1 contact, external_torque above "
             "the lower threshold, 2 collision, it has been above the upper one", on_request=True),
        held("motor_torque", (7,), "N.m", "Torques of the arm's motors if impedance is true, else "
             "0", on_request=True),
        Variable("period", (), "s", "parameter", "fixed", "Time between two updates; outputs are "
                 "held in between", STEP_SIZE, STEP_SIZE, 1.0, multiple_of=STEP_SIZE),
        Variable("use_reference", (), "", "parameter", "tunable", "Integrate a joint reference; "
                 "false: the tutorial's law", _GAINS.use_reference, kind="Boolean"),
        _gain("kp", "1", "Proportional gain of each joint's PID"),
        _gain("ki", "1/s", "Integral gain of each joint's PID"),
        _gain("kd", "s", "Derivative gain of each joint's PID"),
        _gain("derivative_filter", "s", "Time constant of the derivative's low-pass; 0: none"),
        _gain("integral_limit", "rad", "Largest magnitude of the PID's integral part"),
        _gain("base_ctrl", "rad", "Servo targets that the PID's output is added to if "
              "use_reference is false"),
        _gain("ik_gain", "1/s", "Rate at which a pose error is driven to zero"),
        _gain("error_filter", "s", "Time constant of the pose error's low-pass; 0: none"),
        _gain("ik_damping", "1", "Damping of the least squares where joint limits bind"),
        _gain("singular_damping", "1", "Damping at a singularity"),
        _gain("singular_value", "1", "Smallest singular value of the Jacobian below which damping "
              "grows"),
        _gain("linear_correction", "m/s", "Largest speed of the correction of a position error"),
        _gain("linear_braking", "m/s2", "Deceleration as the position error goes to zero"),
        _gain("angular_correction", "rad/s", "Largest speed of the correction of an orientation "
              "error"),
        _gain("angular_braking", "rad/s2", "Deceleration as the orientation error goes to zero"),
        _gain("posture", "rad", "Joint positions that the null space is pulled to"),
        _gain("posture_gain", "1/s", "Rate at which the null space is pulled to the posture"),
        _gain("servo_lag", "s", "Lag of each servo behind a ramp, fed forward"),
        _gain("servo_stiffness", "N.m/rad", "Stiffness of each servo"),
        _gain("gravity_feedforward", "1", "Share of the bias force that is fed forward"),
        _gain("inertia_feedforward", "1", "Share of the inertia force that is fed forward"),
        _gain("limit_share", "1", "Share of the robot's limits that the joint reference may use"),
        _gain("reference_lead", "rad", "How far the joint reference may run ahead of a blocked "
              "joint"),
        _gain("finger_speed", "m/s", "Speed of each finger's command; 0: unlimited"),
        _gain("grip_force", "N", "Force of each finger wherever the commanded opening is less than "
              "grip_width; 0: the fingers go to the opening"),
        _gain("grip_width", "m", "Width of what is held"),
        _gain("grip_stiffness", "N/m", "Stiffness of each finger's servo"),
        _gain("reading_delay", "s", "Age of the measured inputs, to the nearest period; they are "
              "compared with the command and the reference of their own time", "fixed"),
        Variable("follow_posture", (), "", "parameter", "fixed", "The null space follows "
                 "posture_cmd, instead of the pulls to posture and away from the joints' ends",
                 _GAINS.follow_posture, kind="Boolean"),
        _gain("posture_follow_gain", "1/s", "Rate at which an error of the commanded posture goes "
              "to zero"),
        Variable("observer", (), "", "parameter", "tunable", "Compute external_torque, "
                 "external_force and joint_contact, also without a reaction", _GAINS.observer,
                 kind="Boolean"),
        _gain("observer_gain", "1/s", "Inverse of the observer's time constant"),
        _gain("lower_torque_threshold", "N.m", "External torque above which a joint is in contact"),
        _gain("upper_torque_threshold", "N.m", "External torque above which a joint collides"),
        Variable("reaction", (), "", "parameter", "tunable", "What the arm does once a joint has "
                 "collided, until it is none: none; stop (hold the joints where they are); yield "
                 "(give way, held up against gravity alone); with impedance always none",
                 _GAINS.reaction, kind="Enumeration", choices=REACTIONS),
        Variable("robot", (), "", "parameter", "fixed", "Arm whose model and limits are used: "
                 "panda (Franka Emika Panda) or fr3 (Franka Research 3)", _GAINS.robot,
                 kind="Enumeration", choices=tuple(ROBOTS)),
        Variable("impedance", (), "", "parameter", "fixed", "Torques of a Cartesian impedance for "
                 "the scene motors, instead of servo targets", _GAINS.impedance, kind="Boolean"),
        _gain("stiffness", _WRENCH_UNITS[1], "Of the hand, along and about the world's axes",
              parts=(("stiffness", 3, "Of the hand, along the world's axes"),
                     ("angular_stiffness", 3, "Of the hand, about the world's axes"))),
        _gain("spring_force", "N", "Largest force of these springs"),
        _gain("spring_torque", "N.m", "Largest torque of these springs"),
        _gain("damping_ratio", "1", "Of each mode of the hand on these springs"),
        _gain("offset_rate", "1/s", "Rate at which the wrench that the law's model lacks is found, "
              "but not along axes of a commanded force"),
        _gain("offset_limit", _WRENCH_UNITS[0], "Largest such wrench",
              parts=(("offset_limit", 3, "Largest such force"),
                     ("offset_moment_limit", 3, "Largest such moment"))),
        _gain("posture_stiffness", "N.m/rad", "Of each joint to the posture, in the null space"),
        _gain("posture_damping", "N.m.s/rad", "Of each joint, in the null space"),
    ),
    {"robot": ROBOT, "command": COMMANDS},
)  # fmt: skip
