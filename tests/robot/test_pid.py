"""The seven PIDs are the discrete transfer function that their docstring gives."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim.assets.fields import Buffer
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.pid import PID_STATE, Pid
from panda_cosim.task.rotations import Array

TOLERANCE = 1e-9  # rad: two ways to add up 400 terms
UPDATES = 400
NO_LIMIT = 1e3  # rad
ZERO, ONE = np.zeros(7), np.ones(7)


def responses(gains: Gains, period: float, errors: Array) -> Array:
    """Return the corrections to a row of errors (n, 7) -> (n, 7) [rad]."""
    pid = Pid(gains, period, Buffer(PID_STATE).views)
    pid.reset()
    return np.array([pid.update(error) for error in errors])


def pid_gains(kp: Array, ki: Array, kd: Array, tf: float = 0.0, limit: float = NO_LIMIT) -> Gains:
    """Return gains with these of the PIDs (7,)."""
    each = {name: tuple(g.tolist()) for name, g in (("kp", kp), ("ki", ki), ("kd", kd))}
    return Gains(**each, derivative_filter=tf, integral_limit=(limit,) * 7)


@pytest.mark.parametrize("signal", ["step", "random"])
@pytest.mark.parametrize(
    ("kp", "ki", "kd", "tf"),
    [
        (8.0, 0.0, 0.0, 0.005),  # the default law
        (10.0, 1.0, 0.01, 0.0),  # the tutorial's
        (3.0, 20.0, 0.5, 0.02),
        (0.0, 0.0, 0.2, 0.1),
        (0.0, 5.0, 0.0, 0.0),
    ],
)
@pytest.mark.parametrize("period", [0.001, 0.01])
def test_a_pid_is_its_transfer_function(kp, ki, kd, tf, period, signal):
    gains = pid_gains(kp * ONE, ki * ONE, kd * ONE, tf)
    error = np.ones(UPDATES) if signal == "step" else np.random.default_rng(1).normal(size=UPDATES)
    error[0] = 0.0  # the first update gives no derivative
    answer = responses(gains, period, error[:, None] * ONE)
    z = control.TransferFunction([1, 0], [1], period)
    derivative = (z - 1) / ((tf + period) * z - tf)
    function = kp + ki * period * z / (z - 1) + kd * derivative
    expected = control.forced_response(function, U=error)
    assert np.abs(answer - expected.outputs[:, None]).max() <= TOLERANCE


def test_each_joint_has_its_own_gains():
    numbers = np.arange(1.0, 8.0)
    errors = np.random.default_rng(2).normal(size=(50, 7))
    together = responses(pid_gains(numbers, 2 * numbers, 3 * numbers, 0.01), 0.001, errors)
    for joint, gain in enumerate(numbers):
        alone = pid_gains(gain * ONE, 2 * gain * ONE, 3 * gain * ONE, 0.01)
        assert np.array_equal(responses(alone, 0.001, errors)[:, joint], together[:, joint])


def test_a_start_with_an_error_gives_no_derivative_kick():
    assert not responses(pid_gains(ZERO, ZERO, ONE), 0.001, np.ones((2, 7))).any()


@settings(max_examples=50, deadline=None)
@given(limit=st.floats(0.001, 0.1), errors=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60))
def test_the_integral_never_winds_up(limit, errors):
    """It stays within its limit, and so turns as soon as the error does."""
    gains = pid_gains(ZERO, 50.0 * ONE, ZERO, limit=limit)
    answer = responses(gains, 0.01, np.array(errors)[:, None] * ONE)
    assert np.abs(answer).max() <= limit
