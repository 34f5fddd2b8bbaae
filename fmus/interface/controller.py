"""The interface of PandaController; `controller.toml` says what its variables are."""

from __future__ import annotations

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT, OPENING_MAX
from ...controller.gains import Gains
from ...controller.signals import INPUTS, OUTPUTS
from .own import Values, parameters, read_table, signals
from .plant import FORCE_MAX, ROBOT
from .variables import Interface, Variable

# The inputs that command the hand's motion, and those of the posture; the others are measured.
COMMANDS = ("pos_cmd", "quat_cmd", "vel_cmd", "omega_cmd", "grip_cmd")
POSTURE_COMMANDS = ("posture_cmd", "posture_vel_cmd")
FORCE_COMMAND = "force_cmd"
# Outputs of the observer.
OBSERVED = ("external_torque", "external_force", "joint_contact")

FIXED = ("reading_delay", "follow_posture", "robot", "impedance")  # from the start on

_TABLE = read_table("controller")
_VALUES: dict[str, Values] = {
    "pos_cmd": (HOME_XPOS, None, None),
    "quat_cmd": (HOME_XQUAT, None, None),
    "grip_cmd": (OPENING_MAX, 0.0, OPENING_MAX),
    "posture_cmd": (HOME_Q, None, None),
    "hand_xpos": (HOME_XPOS, None, None),
    "hand_xquat": (HOME_XQUAT, None, None),
    "qpos": (HOME_Q, None, None),
    FORCE_COMMAND: (0.0, -FORCE_MAX, FORCE_MAX),
}
PERIOD = Variable(
    "period", (), "s", "parameter", "fixed",
    "Time between two updates; outputs are held in between", STEP_SIZE, STEP_SIZE, 1.0,
    multiple_of=STEP_SIZE,
)  # fmt: skip
CONTROLLER = Interface(
    "PandaController",
    _TABLE["description"],
    (
        *signals(_TABLE["input"], INPUTS, "input", _VALUES),
        *signals(_TABLE["output"], OUTPUTS, "output", variability="discrete"),
        PERIOD,
        *parameters(_TABLE["parameter"], Gains, FIXED),
    ),
    {"robot": ROBOT, "command": COMMANDS},
)
