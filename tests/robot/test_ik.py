"""Differential inverse kinematics: rotation error, least squares, dexterity."""

import math
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from panda_cosim.assets.franka import Q_MAX, Q_MIN
from panda_cosim.controller import ik, singularity
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.linalg import damped_factor
from panda_cosim.controller.model import ArmModel, load_arm
from panda_cosim.task.rotations import Array

ANGLE_TOLERANCE = 1e-9  # rad
SOLUTION_TOLERANCE = 1e-7  # rad/s, of the solver's and of the pseudo-inverse's rounding

part = st.floats(-1.0, 1.0)
vectors = st.tuples(part, part, part).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def unit(q: Array) -> Array:
    return q / np.linalg.norm(q)


quaternions = (
    st.tuples(part, part, part, part)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(unit)
)


def turn(axis_angle: Array, q: Array) -> Array:
    """Return q turned in the world frame by a rotation vector [rad]."""
    by, turned = np.zeros(4), np.zeros(4)
    angle = float(np.linalg.norm(axis_angle))
    mujoco.mju_axisAngle2Quat(by, axis_angle / angle if angle else np.array([1.0, 0, 0]), angle)
    mujoco.mju_mulQuat(turned, by, q)
    return turned


def error_between(command: Array, hand: Array) -> Array:
    """Return the rotation from hand to command [rad], in the world frame."""
    return ik.pose_error(np.zeros(3), command, np.zeros(3), hand)[3:]


@cache
def arm() -> tuple[Any, Any]:
    """Return MuJoCo's model of the arm and its data."""
    model = load_arm()
    return model, mujoco.MjData(model)


def jacobian(q: Array) -> Array:
    """Return the hand's Jacobian (6, 7) from MuJoCo."""
    model, data = arm()
    data.qpos[:7] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jac = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jac[:3], jac[3:], model.body("hand").id)
    return jac[:, :7].copy()


def random_posture(seed: int) -> Array:
    return np.random.default_rng(seed).uniform(Q_MIN, Q_MAX)


def solve(jac: Array, twist: Array, damping: float, rate: Array) -> Array:
    """Return the joint velocities for a wanted twist and null-space rate."""
    return ik.damped_least_squares(jac, damped_factor(jac, damping), twist, rate)


# Pose error.


@given(a=quaternions, b=quaternions)
def test_the_error_brings_the_hand_to_the_command_by_the_shorter_way(a, b):
    error = error_between(a, b)
    reached = turn(error, b)
    assert min(np.abs(reached - a).max(), np.abs(reached + a).max()) <= ANGLE_TOLERANCE
    assert np.linalg.norm(error) <= math.pi + ANGLE_TOLERANCE


# Correction.

rates = st.floats(1e-3, 100.0)


@given(linear=vectors, angular=vectors, scale=rates, speed=rates, braking=rates)
def test_an_error_is_corrected_as_fast_as_can_be_braked(linear, angular, scale, speed, braking):
    gains = Gains(
        linear_correction=speed,
        linear_braking=braking,
        angular_correction=2.0 * speed,
        angular_braking=3.0 * braking,
    )
    error = np.concatenate((scale * linear, angular))
    twist = ik.correcting_twist(error, gains)
    for part, before, most, rate in (
        (twist[:3], error[:3], speed, braking),
        (twist[3:], error[3:], 2.0 * speed, 3.0 * braking),
    ):
        length = np.linalg.norm(before)
        expected = min(gains.ik_gain * length, most, math.sqrt(2.0 * rate * length))
        assert np.linalg.norm(part) == pytest.approx(expected, rel=1e-9, abs=1e-100)
        assert np.abs(np.cross(part, before)).max() <= 1e-9 * length * expected


# Least squares.


@settings(max_examples=50, deadline=None)
@given(seed=seeds, damping=st.floats(0.005, 0.5))
def test_damped_it_is_the_damped_least_squares(seed, damping):
    rng = np.random.default_rng(seed)
    jac, twist, rate = jacobian(random_posture(seed)), rng.normal(size=6), rng.normal(size=7)
    stacked = np.vstack((jac, damping * np.eye(7)))
    expected = np.linalg.lstsq(stacked, np.concatenate((twist, damping * rate)))[0]
    assert np.abs(solve(jac, twist, damping, rate) - expected).max() <= SOLUTION_TOLERANCE


@settings(max_examples=50, deadline=None)
@given(
    seed=seeds, off=st.sampled_from([0.0, 0.003, 0.02, 0.1]), singular=st.sampled_from([0.0, 0.05])
)
@example(seed=15208010, off=0.1, singular=0.0)  # where the solver stopped short at first
def test_within_a_box_scale_and_velocities_are_optimal(seed, off, singular):
    rng = np.random.default_rng(seed)
    jac, free = jacobian(random_posture(seed)), rng.normal(size=7)
    low, high = -rng.uniform(0.05, 1.0, 7), rng.uniform(0.05, 1.0, 7)
    error = off * unit(rng.normal(size=6)) / ik.WEIGHTS
    qd = ik.scaled_least_squares(jac, error, free, 5e-3, singular, np.stack((low, high)))
    assert (qd >= low).all()
    assert (qd <= high).all()
    asked, moved = ik.WEIGHTS * (jac @ free), ik.WEIGHTS * (jac @ qd)
    price = asked @ asked * (ik.OFF_PATH / max(off, ik.LEAST_ERROR)) ** 4
    scale = min(max((asked @ moved + price) / (asked @ asked + price), 0.0), 1.0)
    square = 25e-6 + (singular * min(off / ik.OFF_PATH, 1.0)) ** 2
    gradient = (ik.WEIGHTS[:, None] * jac).T @ (moved - scale * asked) + square * (qd - free)
    inside = (qd > low) & (qd < high)
    assert np.abs(gradient[inside]).max(initial=0.0) <= 2e-6
    assert (gradient[qd == low] >= -1e-6).all()
    assert (gradient[qd == high] <= 1e-6).all()


@settings(max_examples=30, deadline=None)
@given(seed=seeds, half=st.booleans())
def test_a_hand_that_is_late_slows_down_on_its_path(seed, half):
    """In a box that holds the solution it keeps its speed; in half of it, half of it."""
    jac, twist = jacobian(random_posture(seed)), np.random.default_rng(seed).normal(size=6)
    assume(np.linalg.svd(jac)[1][-1] > 0.05)
    free = np.linalg.pinv(jac) @ twist
    width = np.abs(free) / 2.0 if half else np.abs(free) + 1.0
    qd = ik.scaled_least_squares(jac, np.ones(6), free, 0.0, 0.0, np.stack((-width, width)))
    moved, asked = ik.WEIGHTS * (jac @ qd), ik.WEIGHTS * twist
    along = moved @ asked / (asked @ asked)
    assert (0.45 if half else 0.999) <= along <= 1.001
    assert np.linalg.norm(moved - along * asked) <= 0.01 * np.linalg.norm(asked)


def test_without_a_solution_the_joints_brake():
    low, high = np.full(7, -0.2), np.array([-0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    jac, one, free = np.full((6, 7), 1e200), np.ones(6), np.zeros(7)
    qd = ik.scaled_least_squares(jac, one, free, 0.0, 0.0, np.stack((low, high)))
    assert np.array_equal(qd, [-0.1, 0, 0, 0, 0, 0, 0])
    flat = np.full((2, 7), 1e9)  # so fast that a width of 1e-9 is rounded away
    assert (ik.scaled_least_squares(jac, one, free, 0.0, 0.0, flat) == 1e9).all()


# Singularities and inertia.


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_manipulability_and_smallest_singular_value_are_those_of_the_jacobian(seed):
    jac = jacobian(random_posture(seed))
    values = np.linalg.svd(jac)[1]
    assume(values[-1] < 0.9 * values[-2])  # else the direction converges more slowly
    factor = damped_factor(jac, 0.0)
    smallest = singularity.smallest_singular_value(factor, singularity.find_weak_direction(jac))
    assert singularity.manipulability(factor) == pytest.approx(np.prod(values), rel=1e-6, abs=1e-9)
    assert smallest == pytest.approx(values[-1], rel=1e-3, abs=1e-6)


@given(value=st.floats(1e-3, 1.0), damping=st.floats(0.0, 1.0))
def test_the_damping_grows_from_nothing_to_its_most_at_the_singularity(value, damping):
    gains = Gains(singular_value=value, singular_damping=damping)
    course = [singularity.singular_damping(s * value, gains) for s in np.linspace(0.0, 1.2, 25)]
    assert course[0] == damping
    assert course == sorted(course, reverse=True)
    assert course[20] <= 1e-7 * damping  # at the value itself, rounded
    assert not any(course[21:])
    nowhere = Gains(singular_value=0.0, singular_damping=damping)
    assert singularity.singular_damping(0.0, nowhere) == 0.0


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_the_inertia_force_is_that_of_the_arm(seed):
    """As the full dynamics without gravity, velocities and passive forces give it."""
    q, (model, data) = random_posture(seed), arm()
    qdd = np.random.default_rng(seed).normal(size=model.nv)
    qdd[7:] = 0.0  # the fingers rest
    data.qpos[:7], data.qvel[:] = q, 0.0
    mujoco.mj_forward(model, data)
    expected = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, expected, qdd)
    assert np.abs(ArmModel().inertia_force(q, qdd[:7]) - expected[:7]).max() <= 1e-12  # N.m
