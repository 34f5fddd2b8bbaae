"""The robot's limits: the largest use of each in a run, and the first that bound the controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import Q_MAX, Q_MIN
from ..definition.limits import LIMITS, METRICS, saturated
from ..definition.rates import reference_rates, torque_rates
from ..recording import Recording

Array = NDArray[np.float64]
Shares = dict[str, list[float]]

# Values 1 to 4 of `controller.limit`.
KINDS: Final = ("position", "velocity", "acceleration", "jerk")


def limit_shares(recording: Recording) -> Shares:
    """Largest use of each robot limit, per joint or finger, 1 at the limit.

    Positions, speeds and torques are the plant's. Metrics named `reference_` are those of the
    controller's joint reference: acceleration and jerk are finite differences between its updates.
    The torque rate is that of the servos' torques, without the first two ticks, in which the
    servos are switched on.
    """
    if not len(recording.time):
        return {}
    qpos, qvel = recording["plant.qpos"][:, :7], recording["plant.qvel"]
    torque, reference = recording["plant.actuator_force"][:, :7], recording["controller.qvel_ref"]
    acceleration, jerk = reference_rates(reference, recording.metadata)
    centre, half = (Q_MAX + Q_MIN) / 2, (Q_MAX - Q_MIN) / 2
    return {
        "position_share": _share(qpos - centre, half),
        "velocity_share": _share(qvel[:, :7], LIMITS["velocity"].bound),
        "torque_share": _share(torque, LIMITS["torque"].bound),
        "torque_rate_share": _share(torque_rates(torque), LIMITS["torque rate"].bound),
        "finger_speed_share": _share(qvel[:, 7:9], LIMITS["finger speed"].bound),
        "reference_velocity_share": _share(reference, LIMITS["velocity"].bound),
        "reference_acceleration_share": _share(acceleration, LIMITS["acceleration"].bound),
        "reference_jerk_share": _share(jerk, LIMITS["jerk"].bound),
    }


def _share(values: Array, limits: Array) -> list[float]:
    shares: list[float] = (np.abs(values).max(axis=0, initial=0.0) / limits).tolist()
    return shares


def largest_share(shares: Mapping[str, list[float]]) -> float | None:
    """Largest share of all limits; None if nothing was measured."""
    return max((max(values) for values in shares.values() if values), default=None)


def exceeded(shares: Mapping[str, list[float]]) -> list[str]:
    """List the exceeded limits, such as "torque rate of joint 2 (176%)".

    Args:
        shares: See `limit_shares`.

    Returns:
        One line per kind of limit, for the joint with the largest share.
    """
    found = []
    for key, values in shares.items():
        most = int(np.argmax(values)) if values else 0
        if values and values[most] > 1.0:
            part = "finger" if key == "finger_speed_share" else "joint"
            share = f"{values[most]:.0%}"
            share = "just above 100%" if share == "100%" else share
            found.append(f"{METRICS.get(key, key)} of {part} {most + 1} ({share})")
    return found


def first_limit(recording: Recording) -> dict[str, Any] | None:
    """Return the limit that bound first: one of the controller's, or a servo's torque.

    Returns:
        `time_s`, `joint` (from 1) and `kind` (one of `KINDS`, or "torque"); None if none did.
    """
    kinds = np.zeros((len(recording.time), 7))
    if "plant.actuator_force[7]" in recording:
        kinds[_saturated(recording)] = len(KINDS) + 1
    if "controller.limit" in recording:
        limit = recording["controller.limit"]
        kinds = np.where(limit > 0.0, limit, kinds)
    bound = np.flatnonzero(kinds.any(axis=1))
    if not len(bound):
        return None
    joint = int(np.flatnonzero(kinds[bound[0]])[0])
    kind = (*KINDS, "torque")[int(kinds[bound[0], joint]) - 1]
    return {"time_s": float(recording.time[bound[0]]), "joint": joint + 1, "kind": kind}


def _saturated(recording: Recording) -> NDArray[np.bool_]:
    """Whether each servo gives all the torque that it has in this run, at each tick (n, 7)."""
    plant = recording.metadata.get("parameters", {}).get("plant", {})
    scale = np.array([plant.get(f"torque_limit_scale[{joint}]", 1.0) for joint in range(1, 8)])
    return saturated(recording["plant.actuator_force"][:, :7], scale)


__all__ = ["exceeded", "first_limit", "largest_share", "limit_shares"]
