"""Rates that no signal records: of the servos' torques, and of the joint reference's velocity.

Judging and pictures both take them from here, at each tick of a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ...fmus.messages import excerpt

Array = NDArray[np.float64]

SWITCHING_ON: Final = 2  # [ticks] from the start, in which the servos take up what they hold


def torque_rates(torque: Array) -> Array:
    """Rate of the servos' torques (n, 7) [N.m/s]; 0 while the servos are switched on.

    Args:
        torque: At each tick (n, 7) [N.m].
    """
    rates = np.zeros_like(torque)
    rates[SWITCHING_ON + 1 :] = np.diff(torque[SWITCHING_ON:], axis=0) / STEP_SIZE
    return rates


def reference_rates(velocity: Array, metadata: Mapping[str, Any]) -> tuple[Array, Array]:
    """Acceleration and jerk of the joint reference, each (n, 7) [rad/s^2], [rad/s^3].

    They are finite differences between the controller's updates, 0 before there are enough of
    them.

    Args:
        velocity: Of the reference at each tick (n, 7) [rad/s].
        metadata: Of the recording; has the controller's period and the coupling.
    """
    if metadata.get("coupling") != "jacobi" and len(velocity) > 1:
        # With Gauss-Seidel coupling the controller is not updated in the last tick: its outputs
        # are repeated there, which is no stop of the reference.
        acceleration, jerk = _rates(velocity[:-1], metadata)
        return acceleration[[*range(len(acceleration)), -1]], jerk[[*range(len(jerk)), -1]]
    return _rates(velocity, metadata)


def _rates(velocity: Array, metadata: Mapping[str, Any]) -> tuple[Array, Array]:
    """Acceleration and jerk where the last row is an update, or is held since one."""
    parameters = metadata.get("parameters", {}).get("controller", {})
    period = parameters.get("period", STEP_SIZE)
    if not (isinstance(period, int | float) and period > 0.0):
        raise InputError(f"metadata: controller.period: value {excerpt(period)}; must be above 0 s")
    ticks = max(round(period / STEP_SIZE), 1)
    updates = velocity[::ticks]  # outputs are held between updates
    acceleration, jerk = np.zeros_like(updates), np.zeros_like(updates)
    acceleration[1:] = np.diff(updates, axis=0) / period
    jerk[2:] = np.diff(acceleration[1:], axis=0) / period
    held = np.arange(len(velocity)) // ticks
    return acceleration[held], jerk[held]


__all__ = ["reference_rates", "torque_rates"]
