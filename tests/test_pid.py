"""The seven PIDs are the discrete transfer function that their docstring gives."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from panda_cosim.controller.pid import Pid

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # rad: two ways to add up 400 terms
UPDATES = 400
NO_LIMIT = np.full(7, 1e9)  # rad


def responses(pid: Pid, errors: Array) -> Array:
    """Return the corrections to a row of errors (n, 7) -> (n, 7) [rad]."""
    state = np.zeros((3, 7))
    state[2] = np.nan
    return np.array([pid.update(error, state).copy() for error in errors])


def transfer_function(
    kp: float, ki: float, kd: float, tf: float, period: float
) -> control.TransferFunction:
    z = control.TransferFunction([1, 0], [1], period)
    derivative = (z - 1) / ((tf + period) * z - tf)
    return kp + ki * period * z / (z - 1) + kd * derivative


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
def test_a_pid_is_its_transfer_function(
    kp: float, ki: float, kd: float, tf: float, period: float, signal: str
) -> None:
    seven = np.ones(7)
    pid = Pid(kp * seven, ki * seven, kd * seven, tf, NO_LIMIT, period)
    error = np.ones(UPDATES) if signal == "step" else np.random.default_rng(1).normal(size=UPDATES)
    error[0] = 0.0  # the first update gives no derivative
    answer = responses(pid, error[:, None] * seven)

    expected = control.forced_response(transfer_function(kp, ki, kd, tf, period), U=error)
    assert np.abs(answer - expected.outputs[:, None]).max() <= TOLERANCE


def test_each_joint_has_its_own_gains() -> None:
    numbers = np.arange(1.0, 8.0)
    pid = Pid(numbers, 2 * numbers, 3 * numbers, 0.01, NO_LIMIT, 0.001)
    errors = np.random.default_rng(2).normal(size=(50, 7))
    together = responses(pid, errors)
    for joint, gain in enumerate(numbers):
        seven = np.ones(7)
        alone = Pid(gain * seven, 2 * gain * seven, 3 * gain * seven, 0.01, NO_LIMIT, 0.001)
        assert np.array_equal(responses(alone, errors)[:, joint], together[:, joint])


def test_a_start_with_an_error_gives_no_derivative_kick() -> None:
    pid = Pid(np.zeros(7), np.zeros(7), np.ones(7), 0.0, NO_LIMIT, 0.001)
    assert not responses(pid, np.ones((2, 7))).any()


@settings(max_examples=50, deadline=None)
@given(
    limit=st.floats(0.001, 0.1),
    errors=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60),
)
def test_the_integral_never_winds_up(limit: float, errors: list[float]) -> None:
    """It stays within its limit, and so turns as soon as the error does."""
    pid = Pid(np.zeros(7), np.full(7, 50.0), np.zeros(7), 0.0, np.full(7, limit), 0.01)
    answer = responses(pid, np.array(errors)[:, None] * np.ones(7))
    assert np.abs(answer).max() <= limit


def test_a_pid_without_integral_and_derivative_keeps_no_state() -> None:
    pid = Pid(np.ones(7), np.zeros(7), np.zeros(7), 0.005, NO_LIMIT, 0.001)
    state = np.zeros((3, 7))
    pid.update(np.ones(7), state)
    assert pid.is_proportional
    assert not state.any()
