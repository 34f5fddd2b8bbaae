"""The limits of the joints: the box of the joint velocities, and where looking at it is spared."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from panda_cosim.assets.franka import HOME_Q, Q_MAX, Q_MIN, QD_MAX, QDD_MAX
from panda_cosim.controller.limits import ACCELERATION, POSITION, VELOCITY, Joints, LimitBox

Array = NDArray[np.float64]

PERIOD = 0.001  # s
OVERSHOOT = QDD_MAX * PERIOD**2 / 4  # rad, by what the last, shorter step of a stop may miss
seeds = st.integers(0, 2**32 - 1)


def box_at(q: Array, qd: Array, lag: Array | None = None, lead: float = 0.05) -> LimitBox:
    """Return the box where the reference moves on at the speed that it has had."""
    box = LimitBox(PERIOD, 1.0, lead, Joints(q, qd, qd, np.zeros(7) if lag is None else lag))
    box.update()
    return box


def limits_at(box: LimitBox, qd: Array) -> Array:
    """Return which limits bind at other joint velocities."""
    box._joints.qd[:] = qd
    return box.limits()


def test_at_rest_the_acceleration_limits() -> None:
    box = box_at(np.array(HOME_Q), np.zeros(7))
    assert np.allclose(box.high, QDD_MAX * PERIOD)
    assert np.allclose(box.low, -QDD_MAX * PERIOD)
    assert (limits_at(box, box.high) == ACCELERATION).all()
    assert (limits_at(box, np.zeros(7)) == 0.0).all()


def test_at_full_speed_the_velocity_limits() -> None:
    box = box_at(np.array(HOME_Q), QD_MAX.copy())
    assert np.allclose(box.high, QD_MAX)
    assert (limits_at(box, box.high) == VELOCITY).all()


def test_near_an_end_the_position_limits() -> None:
    distance = 0.01  # rad
    step = QDD_MAX * PERIOD
    braking = np.sqrt(2 * QDD_MAX * distance + step**2 / 4) - step / 2
    box = box_at(Q_MAX - distance, braking)
    assert np.allclose(box.high, braking)
    assert (limits_at(box, box.high) == POSITION).all()


def test_a_reference_that_is_too_far_ahead_comes_back() -> None:
    lag = np.array([0.1, -0.1, 0, 0, 0, 0, 0])
    box = box_at(np.array(HOME_Q), np.zeros(7), lag)
    # As fast as the acceleration allows in one period.
    assert box.high[0] == pytest.approx(box.low[0], abs=1e-8)
    assert box.high[0] < 0.0
    assert box.low[1] == pytest.approx(box.high[1], abs=1e-8)
    assert box.low[1] > 0.0
    assert (box.high[2:] > 0.0).all()
    assert (box.low[2:] < 0.0).all()


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_a_reference_comes_back_within_its_speed_and_its_ends(seed: int) -> None:
    """However far it has run ahead, and wherever its joint is held."""
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(Q_MIN, Q_MAX), np.zeros(7)
    lag = rng.choice([-1.0, 1.0], 7) * rng.uniform(0.0, 2.0, 7)  # rad
    held = q - lag
    box = LimitBox(PERIOD, 1.0, 0.05, Joints(q, qd, qd, lag))
    for _ in range(1500):
        box.update()
        assert (box.low < box.high).all()
        assert (box.high <= QD_MAX + 1e-8).all()
        assert (box.low >= -QD_MAX - 1e-8).all()
        qd[:] = np.where(lag > 0, box.low, box.high)
        q += PERIOD * qd
        lag[:] = q - held
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=8, deadline=None)
@given(seed=seeds, towards=st.booleans())
def test_no_joint_passes_its_end_however_it_is_driven(seed: int, towards: bool) -> None:
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(Q_MIN, Q_MAX), np.zeros(7)
    box = LimitBox(PERIOD, 1.0, 0.05, Joints(q, qd, qd, np.zeros(7)))
    side = rng.choice([-1.0, 1.0], 7)
    for tick in range(1500):
        box.update()
        assert (box.low < box.high).all()
        if not towards and tick % 200 == 0:
            side = rng.choice([-1.0, 1.0], 7)
        before = qd.copy()
        qd[:] = np.where(side > 0, box.high, box.low)
        assert box.holds()
        assert (np.abs(qd - before) <= QDD_MAX * PERIOD * (1 + 1e-6) + 1e-8).all()
        assert (np.abs(qd) <= QD_MAX + 1e-8).all()
        q += PERIOD * qd
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=8, deadline=None)
@given(seed=seeds)
def test_where_the_look_at_the_limits_is_spared_they_do_not_bind(seed: int) -> None:
    """At the edge of what is spared, and also when the ends come nearer unseen."""
    rng = np.random.default_rng(seed)
    q = 0.5 * (Q_MIN + Q_MAX) + rng.uniform(-0.3, 0.3, 7)
    asked, qd, lag = np.zeros((3, 7))
    joints = Joints(q, asked, qd, lag)
    box, careful = LimitBox(PERIOD, 1.0, 0.05, joints), LimitBox(PERIOD, 1.0, 0.05, joints)
    box.update()
    spared = 0
    for tick in range(2000):
        asked[:] = qd + rng.normal(size=7) * rng.choice([0.001, 0.003, 0.01])  # rad/s
        lag[:] = rng.normal(size=7) * 0.02 if tick % 3 else 0.0  # rad
        if tick % 500 < 400:
            asked += 0.002 * np.sign(asked)
        careful.update()
        kept = (
            (np.abs(lag) < box.lead)
            & (np.abs(asked) < box.speed)
            & (np.abs(asked - qd) < box.change)
        )
        if kept.all() and box.spares():
            assert careful.holds()
            assert (np.minimum(q - Q_MIN, Q_MAX - q) > box.room).all()
            spared += 1
        else:
            box.update()
            np.clip(asked, box.low, box.high, out=asked)
        qd[:] = asked
        q += PERIOD * qd
    assert spared > 0
