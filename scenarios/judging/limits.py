"""The robot's limits: the largest use of each in a run, and the first that bound the controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import Q_MAX, Q_MIN
from ..recording import Recording
from ..scenario.limits import LIMITS, METRICS, reference_rates, saturated, torque_rates

Array = NDArray[np.float64]

# Values 1 to 4 of `controller.limit`.
KINDS: Final = ("position", "velocity", "acceleration", "jerk")


def limit_shares(recording: Recording) -> dict[str, Any]:
    """Largest use of each robot limit, per joint or finger, 1 at the limit.

    Positions, speeds and torques are the plant's. Metrics named `reference_` are those of the
    controller's joint reference: acceleration and jerk are finite differences between its updates.
    The torque rate is that of the servos' torques, without their switching on.
    """
    shares: dict[str, Any] = {}
    missing = {}
    for key, (signal, limit, used) in _USES.items():
        if signal not in recording:
            missing[key] = f"{signal.partition('[')[0]} is not recorded"
        elif not len(recording.time):
            missing[key] = "no row is recorded"
        else:
            shares[key] = (np.abs(used(recording)).max(axis=0) / limit).tolist()
    return shares | {"not_measured": missing}


def _torque(recording: Recording) -> Array:
    return recording["plant.actuator_force"][:, :7]


def _reference_rates(recording: Recording) -> tuple[Array, Array]:
    return reference_rates(recording["controller.qvel_ref"], recording.metadata)


_CENTRE: Final = (Q_MAX + Q_MIN) / 2
_Q, _QD, _F, _REF = (
    "plant.qpos[16]",
    "plant.qvel[9]",
    "plant.actuator_force[7]",
    "controller.qvel_ref[7]",
)
# By metric: the signal that it needs, the limit, and what is compared with it (n, joints).
_USES: Final[Mapping[str, tuple[str, Array, Callable[[Recording], Array]]]] = {
    "position_share": (_Q, Q_MAX - _CENTRE, lambda r: r["plant.qpos"][:, :7] - _CENTRE),
    "velocity_share": (_QD, LIMITS["velocity"].bound, lambda r: r["plant.qvel"][:, :7]),
    "torque_share": (_F, LIMITS["torque"].bound, _torque),
    "torque_rate_share": (_F, LIMITS["torque rate"].bound, lambda r: torque_rates(_torque(r))),
    "finger_speed_share": (_QD, LIMITS["finger speed"].bound, lambda r: r["plant.qvel"][:, 7:9]),
    "reference_velocity_share": (
        _REF, LIMITS["velocity"].bound, lambda r: r["controller.qvel_ref"],
    ),
    "reference_acceleration_share": (
        _REF, LIMITS["acceleration"].bound, lambda r: _reference_rates(r)[0],
    ),
    "reference_jerk_share": (_REF, LIMITS["jerk"].bound, lambda r: _reference_rates(r)[1]),
}  # fmt: skip


def largest_share(shares: Mapping[str, Any]) -> float | None:
    """Largest of all `limit_shares`; None if nothing was measured."""
    return max((max(shares[key]) for key in METRICS if key in shares), default=None)


def exceeded(shares: Mapping[str, Any]) -> list[str]:
    """List the exceeded limits, such as "torque rate of joint 2 (176%)".

    One line per kind of limit, for the joint with the largest share.
    """
    lines = []
    for key, metric in METRICS.items():
        values = shares.get(key)
        most = int(np.argmax(values)) if values else 0
        if values and values[most] > 1.0:
            part = "finger" if key == "finger_speed_share" else "joint"
            share = f"{values[most]:.0%}"
            share = "just above 100%" if share == "100%" else share
            lines.append(f"{metric} of {part} {most + 1} ({share})")
    return lines


def first_limit(recording: Recording) -> dict[str, Any] | None:
    """Return `time_s`, `joint` (from 1) and `kind` of the limit that bound first; None: none did.

    The kind is one of the controller's `KINDS`, or "torque" of a servo.
    """
    kinds = np.zeros((len(recording.time), 7))
    if "plant.actuator_force[7]" in recording:
        plant = recording.metadata.get("parameters", {}).get("plant", {})
        scale = [plant.get(f"torque_limit_scale[{joint}]", 1.0) for joint in range(1, 8)]
        kinds[saturated(_torque(recording), np.array(scale))] = len(KINDS) + 1
    if "controller.limit" in recording:
        limit = recording["controller.limit"]
        kinds = np.where(limit > 0.0, limit, kinds)
    bound = np.flatnonzero(kinds.any(axis=1))
    if not len(bound):
        return None
    joint = int(np.flatnonzero(kinds[bound[0]])[0])
    kind = (*KINDS, "torque")[int(kinds[bound[0], joint]) - 1]
    return {"time_s": float(recording.time[bound[0]]), "joint": joint + 1, "kind": kind}
