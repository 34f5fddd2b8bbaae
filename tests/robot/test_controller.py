"""The controller: start, state, period, switches, messages."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from control_support import started
from law_support import replay
from panda_cosim.assets.franka import HOME_Q, OPENING_MAX, Q_MAX, Q_MIN
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.model import ArmModel
from panda_cosim.controller.presets import preset
from panda_cosim.task.rotations import Array, exp, multiply
from random_tasks import connect

TICKS = 400
ANGLE_TOLERANCE = 1e-12  # rad
LAW_TOLERANCE = 1e-8  # rad and rad/s, of rounding where accelerations are made from a millisecond
PERIOD = 0.001  # s


def recorded_inputs() -> Array:
    """Return the inputs of a controller that follows a winding command (n, 109)."""
    plant, controller = started()
    home = plant.outputs["hand_xpos"].copy()
    rows = []
    for tick in range(TICKS):
        connect(plant, controller)
        t = 0.001 * tick
        controller.inputs["pos_cmd"] = home + 0.05 * np.sin([3 * t, 5 * t, 4 * t])
        controller.inputs["vel_cmd"] = 0.05 * np.array([3, 5, 4]) * np.cos([3 * t, 5 * t, 4 * t])
        controller.inputs["grip_cmd"] = 0.02
        rows.append(controller.input_values.copy())
        controller.update()
        plant.inputs["ctrl"] = controller.outputs["ctrl"]
        plant.step()
    return np.array(rows)


INPUT_ROWS = recorded_inputs()
ALL_GAINS = [
    preset("default"),
    preset("tutorial"),
    preset("default", ki=(2.0,) * 7, kd=(0.05,) * 7),
    preset("default", singular_value=1.0, limit_share=0.05),  # damped and limited all the time
]


@pytest.mark.parametrize("name", ["default", "tutorial"])
def test_at_rest_without_an_error_the_arm_stays(name):
    _, controller = started(preset(name))
    controller.update()
    ctrl, gains = controller.outputs["ctrl"], controller.gains
    feedforward = controller.inputs["qfrc_bias"] * gains.gravity_feedforward
    expected = HOME_Q + feedforward / gains.servo_stiffness
    assert np.abs(ctrl[:7] - np.clip(expected, Q_MIN, Q_MAX)).max() <= ANGLE_TOLERANCE
    assert ctrl[7] == 255.0
    assert np.abs(controller.outputs["dq"]).max() <= ANGLE_TOLERANCE
    assert controller.outputs["manipulability"] == pytest.approx(0.0898, abs=1e-4)
    assert not controller.outputs["singular"]
    assert not controller.outputs["limit"].any()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), has_pid=st.booleans(), gentle=st.booleans())
def test_the_law_is_the_one_that_is_written_down(seed, has_pid, gentle):
    """Far from limits and singularities, at the third update, in plain formulas.

    Moves are so gentle that no limit can bind in the next millisecond, or there are no limits.
    """
    rng, size = np.random.default_rng(seed), 0.005 if gentle else 1.0

    def seven(low: float, high: float) -> tuple[float, ...]:
        return tuple(rng.uniform(low, high, 7).tolist())

    gains = preset(
        "default",
        kp=seven(0.0, 10.0),
        posture_gain=seven(0.0, 0.05 * size),
        **{name: seven(0.0, 1.0) for name in ("ki", "kd") if has_pid},
        posture=seven(-1.0, 1.0),
        servo_lag=seven(0.0, 0.1),
        servo_stiffness=seven(1000.0, 5000.0),
        gravity_feedforward=seven(0.0, 1.0),
        inertia_feedforward=seven(0.0, 1.0),
        derivative_filter=0.0,
        singular_value=0.0,
        limit_share=1.0 if gentle else 100.0,
        reference_lead=10.0,
        integral_limit=(1e3,) * 7,
    )
    controller, inputs = Controller(gains), Controller().inputs
    q_start = 0.5 * (Q_MIN + Q_MAX) + rng.uniform(-0.2, 0.2, 7)  # rad
    twists, q_refs, qds, dqs = [], [], [], []
    for _ in range(3):
        inputs["jac"] = rng.normal(size=(6, 7))
        assume(np.linalg.svd(inputs["jac"])[1][-1] > 0.2)
        inputs["qpos"] = q_start + 0.01 * rng.normal(size=7)
        inputs["qvel"], inputs["qfrc_bias"] = 0.01 * size * rng.normal(size=(2, 7))
        inputs["qfrc_bias"] *= 1000.0 / size  # N.m
        inputs["hand_xpos"] = rng.normal(size=3)
        inputs["pos_cmd"] = inputs["hand_xpos"] + 1e-5 * size * rng.normal(size=3)
        turn = 1e-5 * size * rng.normal(size=3)
        quat = rng.normal(size=4)
        inputs["hand_xquat"] = quat / np.linalg.norm(quat)
        inputs["quat_cmd"] = multiply(exp(turn), inputs["hand_xquat"])
        inputs["vel_cmd"], inputs["omega_cmd"] = 0.02 * size * rng.normal(size=(2, 3))
        replay(controller, np.frombuffer(inputs.tobytes())[np.newaxis])
        assume(gentle or not controller.outputs["limit"].any())
        twists.append(np.concatenate((inputs["vel_cmd"], inputs["omega_cmd"])))
        q_refs.append(controller.outputs["qpos_ref"].copy())
        qds.append(controller.outputs["qvel_ref"].copy())
        dqs.append(q_refs[-1] - inputs["qpos"])
        if len(twists) == 1:
            assert np.array_equal(q_refs[0], inputs["qpos"])
    error = np.concatenate((inputs["pos_cmd"] - inputs["hand_xpos"], turn))
    twist = 1.5 * twists[2] - 0.5 * twists[1] + gains.ik_gain * error
    drift = np.array(gains.posture_gain) * (gains.posture - q_refs[2])
    inverse = np.linalg.pinv(inputs["jac"])
    qd = inverse @ twist + drift - inverse @ (inputs["jac"] @ drift)
    torque = inputs["qfrc_bias"] * gains.gravity_feedforward
    inertia_force = ArmModel().inertia_force(inputs["qpos"], (qd - qds[1]) / PERIOD)
    torque += inertia_force * gains.inertia_feedforward
    correction = np.array(gains.kp) * dqs[2]
    if has_pid:
        correction += np.array(gains.ki) * PERIOD * sum(dqs)
        correction += np.array(gains.kd) * (dqs[2] - dqs[1]) / PERIOD
    ctrl = q_refs[2] + gains.servo_lag * qd + torque / gains.servo_stiffness + correction
    outputs = controller.outputs
    assert np.abs(q_refs[2] - (q_refs[1] + PERIOD * qds[1])).max() <= LAW_TOLERANCE
    assert np.abs(outputs["qvel_ref"] - qd).max() <= LAW_TOLERANCE
    assert np.array_equal(outputs["dq"], dqs[2])
    assert np.abs(outputs["ctrl"][:7] - np.clip(ctrl, Q_MIN, Q_MAX)).max() <= LAW_TOLERANCE


@pytest.mark.parametrize("gains", ALL_GAINS)
@pytest.mark.parametrize("instant", [1, 350])
def test_a_restored_state_replays_bit_for_bit(gains, instant):
    original = Controller(gains)
    replay(original, INPUT_ROWS[:instant])
    state = original.get_state()
    expected = replay(original, INPUT_ROWS[instant:])

    other = Controller(gains)
    replay(other, INPUT_ROWS[::-1][:50])  # somewhere else
    other.set_state(state)
    assert np.array_equal(replay(other, INPUT_ROWS[instant:]), expected)
    original.set_state(state)
    assert np.array_equal(replay(original, INPUT_ROWS[instant:]), expected)


@pytest.mark.parametrize("period", [0.001, 0.002, 0.005])
def test_the_reference_covers_the_commanded_way_at_any_period(period):
    """A command that speeds up evenly is followed as far as it went, with no feedback."""
    _, controller = started(preset("default", ik_gain=0.0, reference_lead=1.0), period)
    jac = controller.inputs["jac"]
    start, acceleration, ticks = controller.inputs["qpos"].copy(), 0.2, 40
    for tick in range(ticks + 1):
        controller.inputs["vel_cmd"] = acceleration * period * tick, 0.0, 0.0
        controller.update()
    moved = jac @ (controller.outputs["qpos_ref"] - start)
    way = 0.5 * acceleration * (ticks * period) ** 2
    # The first period does not know of the acceleration.
    assert moved[0] == pytest.approx(way, rel=1e-9, abs=acceleration * period**2)
    assert np.abs(moved[1:]).max() <= 1e-9 * way


def test_the_reference_of_an_arm_that_is_held_fast_waits():
    """It does not wind up, and comes back as soon as the command does."""
    plant, controller = started()
    home, lead = plant.outputs["hand_xpos"].copy(), controller.gains.reference_lead
    ahead = []
    for tick in range(2000):
        controller.inputs["pos_cmd"] = home + ((0.3, 0.2, -0.1) if tick < 1500 else (0.0, 0.0, 0.0))
        controller.update()
        ahead.append(np.abs(controller.outputs["dq"]).max())
        assert np.abs(controller.outputs["qvel_ref"]).max() <= 0.6  # rad/s
    assert max(ahead) <= 2.2 * lead
    assert ahead[-1] <= 2 * lead
    assert controller.outputs["limit"].max() <= 3.0


def test_the_finger_speed_is_kept_and_an_unlimited_one_is_not():
    for speed, ticks in ((0.047, 10), (0.0, 10)):
        _, controller = started(preset("default", finger_speed=speed))
        controller.update()
        controller.inputs["grip_cmd"] = -1.0  # as closed as can be
        for _ in range(ticks):
            controller.update()
        opening = OPENING_MAX - 2 * speed * 0.001 * ticks if speed else 0.0
        assert controller.outputs["ctrl"][7] == pytest.approx(255 * opening / OPENING_MAX)


@pytest.mark.parametrize("names", [("default", "tutorial"), ("tutorial", "default")])
def test_a_law_begins_as_if_there_had_been_no_other(names):
    """Switching the law resets its outputs and its PIDs."""
    tuned = {name: preset(name, ki=(1.0,) * 7, kd=(0.01,) * 7, limit_share=0.05) for name in names}
    controller, fresh = Controller(tuned[names[0]]), Controller(tuned[names[1]])
    replay(controller, INPUT_ROWS[:300])
    controller.gains = tuned[names[1]]
    controller.inputs["grip_cmd"] = fresh.inputs["grip_cmd"] = 0.02
    assert np.array_equal(
        replay(controller, INPUT_ROWS[300:320]), replay(fresh, INPUT_ROWS[300:320])
    )


def test_a_jacobian_beyond_all_bounds_leaves_nothing_behind():
    """The search for singularities starts afresh after numbers that overflow."""
    controller, fresh = Controller(), Controller()
    rows = INPUT_ROWS[:50].copy()
    replay(controller, rows[:1])
    controller.inputs["jac"] = 1e200
    controller.update()
    jac = np.zeros((6, 7))
    jac[:, :6] = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1e-3])
    for each in (controller, fresh):
        for _ in range(20):
            each.inputs["jac"] = jac
            each.update()
        assert each.outputs["singular"] == 1.0
    assert np.isfinite(controller.output_values).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_any_command_leaves_finite_outputs_within_the_joints_ranges(scale):
    rng = np.random.default_rng(3)
    _, controller = started()
    controller.update()
    for _ in range(300):
        controller.inputs["pos_cmd"] = scale * rng.normal(size=3)
        quat = rng.normal(size=4)
        controller.inputs["quat_cmd"] = quat / np.linalg.norm(quat)
        controller.inputs["vel_cmd"] = scale * rng.normal(size=3)
        controller.inputs["omega_cmd"] = scale * rng.normal(size=3)
        controller.inputs["grip_cmd"] = scale * rng.normal()
        controller.update()
        assert np.isfinite(controller.output_values).all()
        ctrl = controller.outputs["ctrl"]
        assert (ctrl[:7] <= Q_MAX).all()
        assert (ctrl[:7] >= Q_MIN).all()
        assert 0 <= ctrl[7] <= 255
