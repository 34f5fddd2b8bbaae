"""The limits of the joints: the box of the joint velocities, and where no limit is near."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_moves import run_moves

from panda_cosim.assets.franka import HOME_Q, Q_MAX, Q_MIN, QD_MAX, QDD_MAX, QDDD_MAX
from panda_cosim.controller import limits
from panda_cosim.task.rotations import Array

PERIOD = 0.001  # s
OVERSHOOT = QDD_MAX * PERIOD**2 / 4  # rad, by what the last, shorter step of a stop may miss
seeds = st.integers(0, 2**32 - 1)


LIMITS = limits.JointLimits(share=1.0, lead=0.05, period=PERIOD)
pull_from_ends = LIMITS.pull_from_ends
NONE = np.zeros(7)
HOME = np.array(HOME_Q)


def box_at(q: Array, qd: Array, qdd: Array = NONE, lag: Array = NONE) -> tuple[Array, Array]:
    """Return the lowest and highest velocities where the reference moves at qd and qdd."""
    low, high = LIMITS.velocity_box(limits.Motion(q, qd, qdd, lag))
    return low, high


def binding(choice: int, q: Array, qd: Array, qdd: Array = NONE) -> Array:
    """Tell what binds at the lowest (0) or highest (1) velocity of the box."""
    box = box_at(q, qd, qdd)
    return LIMITS.binding(box[choice], limits.Motion(q, qd, qdd, NONE), np.stack(box))


def test_at_rest_the_jerk_limits_then_acceleration_speed_and_near_an_end_the_position():
    low, high = box = box_at(HOME, NONE)
    assert np.allclose(high, QDDD_MAX * PERIOD**2)
    assert np.allclose(low, -QDDD_MAX * PERIOD**2)
    assert (binding(1, HOME, NONE) == limits.JERK).all()
    assert (LIMITS.binding(NONE, limits.Motion(HOME, NONE, NONE, NONE), np.stack(box)) == 0.0).all()
    for qd, qdd, most, kind in (
        (NONE, QDD_MAX, QDD_MAX * PERIOD, limits.ACCELERATION),
        (QD_MAX, NONE, QD_MAX, limits.VELOCITY),
    ):
        assert np.allclose(box_at(HOME, qd, qdd)[1], most)
        assert (binding(1, HOME, qd, qdd) == kind).all()
    close, speed = Q_MAX - limits.END_MARGIN - 2e-5, 0.01 * QD_MAX  # rad, rad/s
    assert (box_at(close, speed)[1] < speed).all()
    assert (binding(1, close, speed) == limits.POSITION).all()


def test_joints_come_gradually_to_their_ends():
    q, qd, qdd, jerks = HOME, NONE, NONE, list[Array]()
    for _ in range(3500):
        before, qd = qd, box_at(q, qd, qdd)[1]
        jerks.append(((qd - before) / PERIOD - qdd) / PERIOD)
        qdd = (qd - before) / PERIOD
        q = q + PERIOD * qd
        close = Q_MAX - q < 0.1  # rad
        assert (np.abs(jerks[-1])[close] <= 0.1 * QDDD_MAX[close]).all()
    assert np.allclose(q, Q_MAX - limits.END_MARGIN, atol=1e-3)
    assert (np.max(jerks, axis=0) > 0.9 * QDDD_MAX).all()  # where there is room


def test_joints_are_pulled_away_from_their_ends_and_nowhere_else():
    assert not pull_from_ends(HOME).any()
    assert not pull_from_ends(0.5 * (Q_MIN + Q_MAX)).any()
    assert pull_from_ends(Q_MIN)[3] == pull_from_ends(Q_MAX)[3] == 0.0  # the stretched arm
    pulled = [0, 1, 2, 4, 5, 6]  # not joint 4
    assert np.allclose(pull_from_ends(Q_MIN)[pulled], limits.END_SPEED)
    assert np.allclose(pull_from_ends(Q_MAX)[pulled], -limits.END_SPEED)
    for closer, further in ((0.63, 0.7), (0.7, 0.79)):  # rad
        up, weaker_up = (pull_from_ends(Q_MIN + room)[pulled] for room in (closer, further))
        down, weaker_down = (pull_from_ends(Q_MAX - room)[pulled] for room in (closer, further))
        assert ((up > weaker_up) & (weaker_up > 0.0)).all()
        assert ((down < weaker_down) & (weaker_down < 0.0)).all()


@settings(max_examples=5, deadline=None)
@given(seed=seeds)
def test_a_reference_comes_back_within_its_speed_and_its_ends(seed):
    """However far it has run ahead, and wherever its joint is held."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(Q_MIN, Q_MAX), NONE, NONE
    lag = rng.choice([-1.0, 1.0], 7) * rng.uniform(0.0, 2.0, 7)  # rad
    held = q - lag
    for _ in range(700):
        low, high = box_at(q, qd, qdd, lag)
        assert (low < high).all()
        assert (high <= QD_MAX + 1e-8).all()
        assert (low >= -QD_MAX - 1e-8).all()
        before, qd = qd, np.where(lag > 0, low, high)
        qdd = (qd - before) / PERIOD
        q = q + PERIOD * qd
        lag = q - held
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=5, deadline=None)
@given(seed=seeds, towards=st.booleans())
def test_no_joint_passes_its_end_however_it_is_driven(seed, towards):
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(Q_MIN, Q_MAX), NONE, NONE
    side = rng.choice([-1.0, 1.0], 7)
    for tick in range(700):
        low, high = box_at(q, qd, qdd)
        assert (low < high).all()
        if not towards and tick % 200 == 0:
            side = rng.choice([-1.0, 1.0], 7)
        before, qd = qd, np.where(side > 0, high, low)
        assert limits.within(qd, np.stack((low, high)))
        assert (np.abs(qd - before) <= QDD_MAX * PERIOD * (1 + 1e-6) + 1e-8).all()
        assert (np.abs(qd) <= QD_MAX + 1e-8).all()
        jerk = ((qd - before) / PERIOD - qdd) / PERIOD
        assert (np.abs(jerk) <= QDDD_MAX * (1 + 1e-6)).all()
        qdd = (qd - before) / PERIOD
        q = q + PERIOD * qd
        assert (q <= Q_MAX + OVERSHOOT).all()
        assert (q >= Q_MIN - OVERSHOOT).all()


@settings(max_examples=300, deadline=None)
@given(seed=seeds, size=st.sampled_from([0.5, 0.9, 1.0, 1.5]))
def test_where_limits_are_inactive_the_box_contains_the_velocities(seed, size):
    """The glance at the limits is never wrong, and spares the box in the middle of things."""
    rng = np.random.default_rng(seed)
    q_ref = 0.5 * (Q_MIN + Q_MAX) + size * rng.uniform(-1.0, 1.0, 7)  # rad
    qd_before = size * rng.uniform(-1.0, 1.0) * QD_MAX
    qdd_before = size * rng.uniform(-1.0, 1.0, 7) * QDD_MAX
    step = size * rng.uniform(-1.0, 1.0, 7) * QDDD_MAX * PERIOD**2
    qd = qd_before + qdd_before * PERIOD + step
    lag = size * rng.uniform(-0.05, 0.05, 7)  # rad
    before = limits.Motion(q_ref, qd_before, qdd_before, lag)
    if LIMITS.inactive(qd, before):
        assert limits.within(qd, LIMITS.velocity_box(before))
    else:
        assert size > 0.5


# Random straight moves end at their goals, near singularities, too.


def test_random_moves_end_at_their_goals_within_the_limits():
    """The second one is near a singularity, and once missed its goal by 2 mm."""
    moves = run_moves(24, only=(1, 2))
    assert all(move.ok for move in moves)
    assert moves[0].rms <= 5e-5  # m


@pytest.mark.long
def test_a_joint_at_its_end_is_refused():
    (move,) = run_moves(55, only=(55,), timing_share=0.95)
    at_limits = [joint for joint, kind in enumerate(move.limit, 1) if kind]
    assert any(f"row 2: joint {n} reaches the end of its range" in move.refused for n in at_limits)
    assert not move.keeps_all
