"""The robot's limits in one table, and the metrics that say how much of them a run uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import (
    FINGER_SPEED_MAX,
    HAND_ACCELERATION_MAX,
    HAND_SPEED_MAX,
    HAND_TURN_MAX,
    QD_MAX,
    QDD_MAX,
    QDDD_MAX,
    TORQUE_MAX,
    TORQUE_RATE_MAX,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Limit:
    """A limit of the robot.

    Attributes:
        bound: Largest magnitude, one per joint (7,), finger (2,) or hand (1,).
        unit: Its unit.
    """

    bound: Array
    unit: str


# Joint positions have a range instead, `Q_MIN` to `Q_MAX`.
LIMITS: Final = {
    "velocity": Limit(QD_MAX, "rad/s"),
    "acceleration": Limit(QDD_MAX, "rad/s^2"),
    "jerk": Limit(QDDD_MAX, "rad/s^3"),
    "torque": Limit(TORQUE_MAX, "N.m"),
    "torque rate": Limit(TORQUE_RATE_MAX, "N.m/s"),
    "finger speed": Limit(np.full(2, FINGER_SPEED_MAX), "m/s"),
    "hand speed": Limit(np.full(1, HAND_SPEED_MAX), "m/s"),
    "hand acceleration": Limit(np.full(1, HAND_ACCELERATION_MAX), "m/s^2"),
    "hand turn": Limit(np.full(1, HAND_TURN_MAX), "rad/s"),
}

_ROUNDING: Final = 1e-9  # of a torque at its limit

# Names of the metrics under `limits` in summary.json.
METRICS: Final = {
    "position_share": "joint position",
    "velocity_share": "joint velocity",
    "torque_share": "joint torque",
    "torque_rate_share": "torque rate",
    "finger_speed_share": "finger speed",
    "reference_velocity_share": "joint-reference velocity",
    "reference_acceleration_share": "joint-reference acceleration",
    "reference_jerk_share": "joint-reference jerk",
}


def shares(quantity: str, values: Array) -> Array:
    """Return values as shares of a limit [1].

    Args:
        quantity: Key of `LIMITS`.
        values: The values (n, joints, fingers or 1), in the limit's unit.
    """
    return values / LIMITS[quantity].bound


def saturated(torque: Array, scale: Array | float = 1.0) -> NDArray[np.bool_]:
    """Whether a servo gives all the torque that it has, at each tick (n, 7).

    Args:
        torque: Of the servos (n, 7) [N.m].
        scale: `torque_limit_scale` of the plant [1].
    """
    most = (1.0 - _ROUNDING) * scale * LIMITS["torque"].bound
    full: NDArray[np.bool_] = np.abs(torque) >= most
    return full
