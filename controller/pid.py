"""One PID per joint, in discrete time."""

from __future__ import annotations

import math

import numpy as np

from ..assets.fields import Vector, Views
from .gains import Gains
from .limits import clamp

PID_STATE = np.dtype([("integral", float, 7), ("derivative", float, 7), ("error_before", float, 7)])


class Pid:
    """Seven PIDs side by side, with clamped integral and filtered derivative.

    With T the period, Tf the filter's time constant and e the error, each joint has

        C(z) = kp + ki T z / (z - 1) + kd (z - 1) / ((Tf + T) z - Tf)

    which is backward Euler for both the integral and the filtered derivative. The derivative
    is 0 at the first update, so that starting with an error gives no kick.
    """

    def __init__(self, gains: Gains, period: float, state: Views) -> None:
        self._kp = np.array(gains.kp)
        self._ki_period = np.array(gains.ki) * period
        self._kd_rate = np.array(gains.kd) / (gains.derivative_filter + period)
        self._decay = np.array(gains.derivative_filter / (gains.derivative_filter + period))
        self._high = np.array(gains.integral_limit)
        self._low = -self._high
        self._state = state

    def reset(self) -> None:
        """Forget all errors."""
        self._state.integral[:], self._state.derivative[:] = 0.0, 0.0
        self._state.error_before[:] = math.nan  # marks the first update

    def update(self, error: Vector) -> Vector:
        """Advance by one period: from setpoint minus measured (7,) to the correction (7,) [rad]."""
        state = self._state
        if math.isnan(state.error_before[0]):
            state.error_before[:] = error
        change = error - state.error_before
        integral = clamp(state.integral + self._ki_period * error, self._low, self._high)
        derivative = self._decay * state.derivative + self._kd_rate * change
        state.integral[...], state.derivative[...] = integral, derivative
        state.error_before[...] = error
        return np.asarray(self._kp * error + integral + derivative)
