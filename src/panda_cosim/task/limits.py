"""The robot's limits in one table, the metrics of how much a run uses, and rates they are about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..assets import STEP_SIZE, franka
from ..fmus.errors import InputError, excerpt

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Limit:
    """A limit of the robot."""

    bound: Array  # largest magnitude, one per joint (7,), finger (2,) or hand (1,)
    unit: str


# Joint positions have a range instead, `Q_MIN` to `Q_MAX`.
LIMITS_OF: Final = {
    name: {
        "velocity": Limit(robot.velocity, "rad/s"),  # at any position; see `RobotLimits.speed`
        "acceleration": Limit(robot.acceleration, "rad/s^2"),
        "jerk": Limit(robot.jerk, "rad/s^3"),
        "torque": Limit(franka.TORQUE_MAX, "N.m"),
        "torque rate": Limit(franka.TORQUE_RATE_MAX, "N.m/s"),
        "finger speed": Limit(np.full(2, franka.FINGER_SPEED_MAX), "m/s"),
        "hand speed": Limit(np.full(1, robot.translation[0]), "m/s"),
        "hand acceleration": Limit(np.full(1, robot.translation[1]), "m/s^2"),
        "hand turn": Limit(np.full(1, robot.rotation[0]), "rad/s"),
    }
    for name, robot in franka.ROBOTS.items()
}
LIMITS: Final = LIMITS_OF[franka.DEFAULT_ROBOT]

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


def shares(quantity: str, values: Array, robot: str = franka.DEFAULT_ROBOT) -> Array:
    """Return values (n, joints, fingers or 1), in a limit's unit, as shares of it [1]."""
    return values / LIMITS_OF[robot][quantity].bound


def robot_of(metadata: Mapping[str, Any]) -> str:
    """Return the name of a recording's robot; older ones do not tell, as there was but one."""
    return str(metadata.get("robot", franka.DEFAULT_ROBOT))


def saturated(torque: Array, scale: Array | float = 1.0) -> NDArray[np.bool_]:
    """Whether a servo gives all the torque (n, 7) [N.m] that it has, times its `scale`."""
    most = (1.0 - _ROUNDING) * scale * LIMITS["torque"].bound
    full: NDArray[np.bool_] = np.abs(torque) >= most
    return full


def torque_rates(torque: Array, on: int | None = None) -> Array:
    """Rate of the servos' torques (n, 7) [N.m/s]; 0 while the servos are switched on."""
    # They are in row `on`, when a torque first differs from 0, and take up what they hold in that
    # tick and the next. With `on`, the torque may be that of one servo (n,).
    rates = np.zeros_like(torque)
    on = int(np.append(torque.any(axis=1), True).argmax()) if on is None else on
    rates[on + 2 :] = np.diff(torque[on + 1 :], axis=0) / STEP_SIZE
    return rates


def reference_rates(velocity: Array, metadata: Mapping[str, Any]) -> tuple[Array, Array]:
    """Acceleration and jerk of the joint reference, each (n, 7) [rad/s^2], [rad/s^3]."""
    # They are finite differences of its velocity (n, 7), or a joint's (n,) [rad/s], between the
    # controller's updates, 0 before there are enough of them, and held as outputs are. The metadata
    # has the controller's period and the coupling.
    parameters = metadata.get("parameters", {}).get("controller", {})
    period = parameters.get("period", STEP_SIZE)
    if not (isinstance(period, int | float) and period > 0.0):
        raise InputError(f"metadata: controller.period: value {excerpt(period)}; must be above 0 s")
    ticks = max(round(period / STEP_SIZE), 1)
    late = int(metadata.get("coupling") == "jacobi" and len(velocity) > 1)  # [ticks] of the first
    updates = velocity[late::ticks]  # outputs are held between updates
    acceleration, jerk = np.zeros_like(updates), np.zeros_like(updates)
    acceleration[1:] = np.diff(updates, axis=0) / period
    jerk[2:] = np.diff(acceleration[1:], axis=0) / period
    update = np.maximum(np.arange(len(velocity)) - late, 0) // ticks
    return acceleration[update], jerk[update]
