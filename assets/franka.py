"""The Franka Emika Panda in numbers: limits, servos, start.

Source of the limits: Franka Control Interface documentation, "Robot and interface
specifications" (Panda). Servos and start are those of panda.xml and of the scenes.
"""

from __future__ import annotations

import math
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray


def _constant(*values: float) -> NDArray[np.float64]:
    """Return a read-only array (7,)."""
    array = np.array(values)
    array.flags.writeable = False
    return array


Q_MAX: Final = _constant(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973)  # [rad]
Q_MIN: Final = _constant(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)  # [rad]
QD_MAX: Final = _constant(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)  # [rad/s]
QDD_MAX: Final = _constant(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)  # [rad/s^2]
QDDD_MAX: Final = _constant(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)  # [rad/s^3]
TORQUE_MAX: Final = _constant(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)  # [N.m]
TORQUE_RATE_MAX: Final = _constant(*(1000.0,) * 7)  # [N.m/s]
# Limits of the hand, from the same source; the angular one holds for any axis.
HAND_SPEED_MAX: Final = 1.7  # [m/s]
HAND_ACCELERATION_MAX: Final = 13.0  # [m/s^2]
HAND_TURN_MAX: Final = 2.5  # [rad/s]

OPENING_MAX: Final = 0.08  # [m] between the fingertips (Franka Hand data sheet)
GRIP_FORCE_MAX: Final = 30.0  # [N] per finger; the hand's data sheet: 70 N for both, continuously
GRIP_STIFFNESS: Final = 1000.0  # [N/m] of each finger's servo in tabletop.xml
BLOCK_WIDTH: Final = 0.06  # [m] of the scenes' block, between the fingers
FINGER_SPEED_MAX: Final = 0.05  # [m/s] per finger (Franka Hand data sheet)

Seven = tuple[float, float, float, float, float, float, float]
HOME_Q: Final[Seven] = (0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853)  # [rad] keyframe `home`
HOME_XPOS: Final = (0.554499478, 0.0, 0.624502429)  # [m] hand body at `home`, world frame
HOME_XQUAT: Final = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)  # (w, x, y, z), world frame
CTRL_OPEN: Final = 255.0  # [1] gripper servo target at OPENING_MAX
# Stiffness of the servos [N.m/rad], their damping, and their lag behind a ramp [s]:
# (servo damping + joint damping) / stiffness.
SERVO_STIFFNESS: Final[Seven] = (4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0)
SERVO_DAMPING: Final[Seven] = (450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0)  # [N.m.s/rad]
JOINT_DAMPING: Final = 1.0  # [N.m.s/rad] of each joint
SERVO_LAG = cast(Seven, tuple(0.1 + 1.0 / k for k in SERVO_STIFFNESS))
