"""One PID a joint, in discrete time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .gains import Gains

Vector = NDArray[np.float64]


class Pid:
    """Seven PIDs side by side, with clamped integral and filtered derivative.

    With T the period, Tf the filter's time constant and e the error, each joint has

        C(z) = kp + ki T z / (z - 1) + kd (z - 1) / ((Tf + T) z - Tf)

    which is backward Euler for both the integral and the filtered derivative. The derivative
    is 0 at the first update, so that a start with an error gives no kick.

    Args:
        kp: Proportional gains (7,) [1].
        ki: Integral gains (7,) [1/s].
        kd: Derivative gains (7,) [s].
        derivative_filter: Tf [s].
        integral_limit: Largest magnitude of the integral part (7,) [rad].
        period: T [s].

    Attributes:
        is_proportional: No integral and no derivative gain is set.
    """

    def __init__(  # noqa: PLR0913 - a PID has this many gains
        self,
        kp: Vector,
        ki: Vector,
        kd: Vector,
        derivative_filter: float,
        integral_limit: Vector,
        period: float,
    ) -> None:
        self._kp = kp
        self._ki_period = ki * period
        self._decay = derivative_filter / (derivative_filter + period)
        self._kd_rate = kd / (derivative_filter + period)
        self._low, self._high = -integral_limit, integral_limit
        self.is_proportional = not (bool(ki.any()) or bool(kd.any()))
        self._correction = np.zeros(7)

    @classmethod
    def of(cls, gains: Gains, period: float) -> Pid:
        """Make those of a set of gains."""
        return cls(
            np.array(gains.kp),
            np.array(gains.ki),
            np.array(gains.kd),
            gains.derivative_filter,
            np.array(gains.integral_limit),
            period,
        )

    def update(self, error: Vector, state: Vector) -> Vector:
        """Advance by one period.

        Args:
            error: Setpoint minus measured (7,) [rad].
            state: Rows integral, derivative and previous error (3, 7) [rad]; changed in
                place. NaN as previous error marks the first update.

        Returns:
            Correction (7,) [rad]; the next call overwrites it.
        """
        correction = self._correction
        np.multiply(self._kp, error, out=correction)
        if self.is_proportional:
            return correction
        integral, derivative, previous = state
        if previous[0] != previous[0]:
            previous[:] = error
        integral += self._ki_period * error
        np.clip(integral, self._low, self._high, out=integral)
        derivative *= self._decay
        derivative += self._kd_rate * (error - previous)
        previous[:] = error
        correction += integral
        correction += derivative
        return correction
