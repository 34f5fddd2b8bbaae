"""The robots in numbers: limits, servos, start.

The limits are those of `limits.py`; the rest is of the MJCF files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from .limits import RobotLimits, robot_limits

DEFAULT_ROBOT: Final = "panda"
PANDA: Final = robot_limits("fer")
ROBOTS: Final[Mapping[str, RobotLimits]] = {"panda": PANDA, "fr3": robot_limits("fr3")}
Q_MAX, Q_MIN, QD_MAX = PANDA.q_max, PANDA.q_min, PANDA.velocity  # of the default robot
QDD_MAX, QDDD_MAX = PANDA.acceleration, PANDA.jerk
# Of either robot.
TORQUE_MAX: Final = PANDA.torque  # [N.m]
TORQUE_RATE_MAX: Final = PANDA.torque_rate  # [N.m/s]

OPENING_MAX: Final = 0.08  # [m] between the fingertips (Franka Hand data sheet)
GRIP_FORCE_MAX: Final = 30.0  # [N] per finger; the hand's data sheet: 70 N for both, continuously
GRIP_STIFFNESS: Final = 1000.0  # [N/m] of each finger's servo in tabletop.xml
BLOCK_WIDTH: Final = 0.06  # [m] of the scenes' block, between the fingers
FINGER_SPEED_MAX: Final = 0.05  # [m/s] per finger (Franka Hand data sheet)

Seven = tuple[float, ...]  # one of each joint
HOME_Q: Final[Seven] = (0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853)  # [rad] keyframe `home`
# The hand's body there, world frame: [m], and (w, x, y, z), 0.1 mrad off a half turn.
HOME_XPOS: Final = (0.5544994780317353, 0.0, 0.6245024294875894)
HOME_XQUAT: Final = (0.0, 0.707141498682236, 0.7070720619862167, 0.0)
CTRL_OPEN: Final = 255.0  # [1] gripper servo target at OPENING_MAX
# Stiffness of the servos [N.m/rad], their damping, and their lag behind a ramp [s]:
# (servo damping + the Panda's joint damping) / stiffness.
SERVO_STIFFNESS: Final[Seven] = (4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0)
SERVO_DAMPING: Final[Seven] = (450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0)  # [N.m.s/rad]
JOINT_DAMPING: Final = {"panda": 1.0, "fr3": 0.21}  # [N.m.s/rad] of each joint
SERVO_LAG: Final[Seven] = tuple(0.1 + 1.0 / k for k in SERVO_STIFFNESS)
