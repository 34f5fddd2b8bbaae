"""The control law in C gives the bits of the law in Python."""

import ctypes
from dataclasses import fields, replace
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_support import INPUTS, LawInC, compile_law, replay
from panda_cosim.assets import franka, limits
from panda_cosim.controller.controller import LAWS, Controller
from panda_cosim.controller.gains import RANGES, REACTIONS, Gains
from panda_cosim.controller.presets import PRESETS, preset
from panda_cosim.task.rotations import Array

SEVERAL = 60  # updates of a random sequence
PLAIN_FIELDS = [f.name for f in fields(Gains) if f.name in RANGES]


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    return compile_law(tmp_path_factory.mktemp("law"))


def random_gains(rng: np.random.Generator) -> Gains:
    """Return gains near those that are shipped, some of them anywhere in their range."""
    gains = preset(rng.choice([*PRESETS]), robot=str(rng.choice([*franka.ROBOTS])))
    for name in rng.choice(PLAIN_FIELDS, 4):
        low, high = RANGES[name]
        value = getattr(gains, name)
        if isinstance(value, tuple):
            gains = replace(gains, **{name: tuple(rng.uniform(low, high, len(value)).tolist())})
        else:
            gains = replace(gains, **{name: float(rng.uniform(low, high))})
    # Switches, and how often each is on.
    switches = {"use_reference": 0.7, "follow_posture": 0.3, "observer": 0.5}
    chosen = {name: bool(rng.random() < on) for name, on in switches.items()}
    return replace(gains, reaction=str(rng.choice(REACTIONS, p=[0.8, 0.1, 0.1])), **chosen)


def random_inputs(rng: np.random.Generator, size: float) -> Array:
    """Return inputs of a few updates (n, 109), smooth or wild."""
    rows = np.empty((SEVERAL, INPUTS.itemsize // 8))
    named = rows.view(INPUTS)[:, 0]
    walk = size * rng.normal(size=rows.shape).cumsum(axis=0)
    rows[:] = rng.normal(size=rows.shape[1]) + walk
    named["qpos"] = rng.uniform(franka.Q_MIN, franka.Q_MAX) + walk[:, :7]
    for name in ("quat_cmd", "hand_xquat"):
        named[name] /= np.linalg.norm(named[name], axis=1, keepdims=True)
    if rng.random() < 0.5:
        named["force_cmd"] = 0.0
    if rng.random() < 0.3:
        named["jac"][:, rng.integers(6)] = 0.0  # singular
    return rows


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-5, 1e-3, 0.1, 10.0]))
def test_random_gains_and_inputs_have_the_same_bits(library, seed, size):
    """Where limits bind, near singularities, and beyond what any robot does."""
    rng = np.random.default_rng(seed)
    gains, rows = random_gains(rng), random_inputs(rng, size)
    period = float(rng.choice([0.001, 0.002, 0.01]))
    python, law = Controller(gains, period), LawInC(library, gains, period)
    np.testing.assert_array_equal(replay(law, rows), replay(python, rows))
    assert np.array_equal(law.state_values, python.state_values, equal_nan=True)
    python.gains = law.gains = replace(
        random_gains(rng), use_reference=not gains.use_reference, robot=gains.robot
    )
    np.testing.assert_array_equal(replay(law, rows[::-1]), replay(python, rows[::-1]))


def test_each_law_has_a_preset_so_that_random_gains_draw_it():
    assert {gains.law for gains in PRESETS.values()} == {*LAWS}


def test_the_robots_limits_are_those_of_the_assets(library):
    law, expected = ctypes.CDLL(str(library)), []
    anywhere = {"low": [-inf] * 7, "high": [inf] * 7, "braking": [1.0] * 7, "offset": [0.0] * 7}
    for name, robot in franka.ROBOTS.items():
        approach = robot.approach or anywhere
        expected += [*robot.q_min, *robot.q_max, *robot.velocity, *robot.acceleration, *robot.jerk]
        expected += [number for key in anywhere for number in approach[key]]
        expected += [franka.JOINT_DAMPING[name]]
    assert list((ctypes.c_double * len(expected)).in_dll(law, "CONTROLLER_ROBOTS")) == expected
    common = [franka.OPENING_MAX, franka.CTRL_OPEN, *franka.SERVO_DAMPING, limits.LEAST]
    common += [*franka.TORQUE_MAX, franka.TORQUE_RATE_MAX[0]]
    assert list((ctypes.c_double * len(common)).in_dll(law, "CONTROLLER_COMMON")) == common
