"""The limits of the joints: the box of the joint velocities, and where no limit is near."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from panda_cosim.assets.franka import HOME_Q, Q_MAX, Q_MIN, QD_MAX, QDD_MAX
from panda_cosim.controller.limits import (
    ACCELERATION,
    END_MARGIN,
    POSITION,
    VELOCITY,
    JointLimits,
    within,
)

Array = NDArray[np.float64]

PERIOD = 0.001  # s
OVERSHOOT = QDD_MAX * PERIOD**2 / 4  # rad, by what the last, shorter step of a stop may miss
seeds = st.integers(0, 2**32 - 1)


LIMITS = JointLimits(share=1.0, lead=0.05, period=PERIOD)
NO_LAG = np.zeros(7)


def box_at(q: Array, qd: Array, lag: Array = NO_LAG) -> tuple[Array, Array]:
    """Return the lowest and highest velocities where the reference moves at qd."""
    low, high = LIMITS.velocity_box(q, qd, lag)
    return low, high


def test_at_rest_the_acceleration_limits() -> None:
    rest = np.zeros(7)
    low, high = box = box_at(np.array(HOME_Q), rest)
    assert np.allclose(high, QDD_MAX * PERIOD)
    assert np.allclose(low, -QDD_MAX * PERIOD)
    assert (LIMITS.binding(high, rest, np.stack(box)) == ACCELERATION).all()
    assert (LIMITS.binding(rest, rest, np.stack(box)) == 0.0).all()


def test_at_full_speed_the_velocity_limits() -> None:
    box = box_at(np.array(HOME_Q), QD_MAX)
    assert np.allclose(box[1], QD_MAX)
    assert (LIMITS.binding(box[1], QD_MAX, np.stack(box)) == VELOCITY).all()


def test_near_an_end_the_position_limits() -> None:
    distance = 0.01  # rad
    step = QDD_MAX * PERIOD
    braking = np.sqrt(2 * QDD_MAX * distance + step**2 / 4) - step / 2
    box = box_at(Q_MAX - END_MARGIN - distance, braking)
    assert np.allclose(box[1], braking)
    assert (LIMITS.binding(box[1], braking, np.stack(box)) == POSITION).all()


def test_a_reference_that_is_too_far_ahead_comes_back() -> None:
    lag = np.array([0.1, -0.1, 0, 0, 0, 0, 0])
    low, high = box_at(np.array(HOME_Q), np.zeros(7), lag)
    # As fast as the acceleration allows in one period.
    assert high[0] == pytest.approx(low[0], abs=1e-8)
    assert high[0] < 0.0
    assert low[1] == pytest.approx(high[1], abs=1e-8)
    assert low[1] > 0.0
    assert (high[2:] > 0.0).all()
    assert (low[2:] < 0.0).all()


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_a_reference_comes_back_within_its_speed_and_its_ends(seed: int) -> None:
    """However far it has run ahead, and wherever its joint is held."""
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(Q_MIN, Q_MAX), np.zeros(7)
    lag = rng.choice([-1.0, 1.0], 7) * rng.uniform(0.0, 2.0, 7)  # rad
    held = q - lag
    for _ in range(1500):
        low, high = box_at(q, qd, lag)
        assert (low < high).all()
        assert (high <= QD_MAX + 1e-8).all()
        assert (low >= -QD_MAX - 1e-8).all()
        qd = np.where(lag > 0, low, high)
        q += PERIOD * qd
        lag = q - held
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=8, deadline=None)
@given(seed=seeds, towards=st.booleans())
def test_no_joint_passes_its_end_however_it_is_driven(seed: int, towards: bool) -> None:
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(Q_MIN, Q_MAX), np.zeros(7)
    side = rng.choice([-1.0, 1.0], 7)
    for tick in range(1500):
        low, high = box_at(q, qd)
        assert (low < high).all()
        if not towards and tick % 200 == 0:
            side = rng.choice([-1.0, 1.0], 7)
        before, qd = qd, np.where(side > 0, high, low)
        assert within(qd, np.stack((low, high)))
        assert (np.abs(qd - before) <= QDD_MAX * PERIOD * (1 + 1e-6) + 1e-8).all()
        assert (np.abs(qd) <= QD_MAX + 1e-8).all()
        q += PERIOD * qd
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=300, deadline=None)
@given(seed=seeds, size=st.sampled_from([0.5, 0.9, 1.0, 1.5]))
def test_where_limits_are_inactive_the_box_contains_the_velocities(seed: int, size: float) -> None:
    """The glance at the limits is never wrong, and spares the box in the middle of things."""
    rng = np.random.default_rng(seed)
    q_ref = 0.5 * (Q_MIN + Q_MAX) + size * rng.uniform(-1.0, 1.0, 7)  # rad
    qd_before = size * rng.uniform(-1.0, 1.0) * QD_MAX
    qd = qd_before + size * rng.uniform(-1.0, 1.0, 7) * QDD_MAX * PERIOD
    lag = size * rng.uniform(-0.05, 0.05, 7)  # rad
    if LIMITS.inactive(qd, q_ref, qd_before, lag):
        assert within(qd, LIMITS.velocity_box(q_ref, qd_before, lag))
    else:
        assert size > 0.5
