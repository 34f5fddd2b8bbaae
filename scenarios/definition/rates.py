"""Rates that no signal records: of the servos' torques, and of the joint reference's velocity.

Judging and pictures both take them from here, at each tick of a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ...fmus.messages import excerpt

Array = NDArray[np.float64]


def torque_rates(torque: Array) -> Array:
    """Rate of the servos' torques (n, 7) [N.m/s]; 0 while the servos are switched on.

    They are when a torque first differs from 0, and take up what they hold in that tick and the
    next.

    Args:
        torque: At each tick (n, 7) [N.m].
    """
    rates = np.zeros_like(torque)
    on = int(np.append(torque.any(axis=1), True).argmax())
    rates[on + 2 :] = np.diff(torque[on + 1 :], axis=0) / STEP_SIZE
    return rates


def reference_rates(velocity: Array, metadata: Mapping[str, Any]) -> tuple[Array, Array]:
    """Acceleration and jerk of the joint reference, each (n, 7) [rad/s^2], [rad/s^3].

    They are finite differences between the controller's updates, 0 before there are enough of
    them.

    Args:
        velocity: Of the reference at each tick (n, 7) [rad/s].
        metadata: Of the recording; has the controller's period and the coupling.
    """
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
    held = np.maximum(np.arange(len(velocity)) - late, 0) // ticks
    return acceleration[held], jerk[held]
