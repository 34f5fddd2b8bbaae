"""The plant: outputs of one instant, parameters that act, states that restore exactly."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim.assets import SCENES, TORQUE_DRIVEN
from panda_cosim.assets.franka import HOME_XPOS, HOME_XQUAT, SERVO_DAMPING
from panda_cosim.fmus.interface.plant import FORCES
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import DivergenceError, Plant

HOME_CTRL = (0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853, 255.0)


def excite(plant: Plant, ticks: int, seed: int = 0) -> None:
    """Move the arm about by changing servo targets."""
    rng = np.random.default_rng(seed)
    for k in range(ticks):
        if k % 20 == 0:
            plant.inputs["ctrl"][:7] = np.array(HOME_CTRL[:7]) + rng.uniform(-0.1, 0.1, 7)
            plant.inputs["ctrl"][7] = rng.uniform(0.0, 255.0)
        plant.step()


@pytest.fixture(params=SCENES)
def plant(request):
    """A plant of each scene."""
    return Plant(PlantParameters(scene=request.param))


def test_a_plant_starts_at_home(plant):
    np.testing.assert_allclose(plant.outputs["hand_xpos"], HOME_XPOS, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(plant.outputs["hand_xquat"], HOME_XQUAT, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(plant.inputs["ctrl"], HOME_CTRL)
    assert not plant.inputs["push_force"].any()
    assert not plant.outputs["qvel"].any()
    assert not plant.outputs["actuator_force"].any()
    assert plant.outputs["contact_force"] == 0.0
    assert plant.data.time == 0.0


def test_outputs_are_those_of_one_instant(plant):
    """All that follows from qpos and qvel is what a fresh forward pass gives for them."""
    for seed in range(5):
        excite(plant, 40, seed)
        fresh = mujoco.MjData(plant.model)
        fresh.qpos[:], fresh.qvel[:] = plant.data.qpos, plant.data.qvel
        mujoco.mj_forward(plant.model, fresh)
        hand, target = fresh.body("hand"), fresh.site("target")
        jac = np.zeros((6, plant.model.nv))
        mujoco.mj_jacBody(plant.model, fresh, jac[:3], jac[3:], hand.id)
        expected = {
            "hand_xpos": hand.xpos,
            "hand_xquat": hand.xquat,
            "target_xpos": target.xpos,
            "target_xmat": target.xmat,
            "jac": jac[:, :7],
            "qfrc_bias": fresh.qfrc_bias[:7],
        }
        for name, value in expected.items():
            np.testing.assert_allclose(plant.outputs[name], value, rtol=0, atol=1e-12)


def test_a_step_is_one_of_mujoco_bit_for_bit(plant):
    """Stepping by mj_step2 and mj_step1 changes nothing in the physics."""
    reference = mujoco.MjData(plant.model)
    reference.qpos[:], reference.ctrl[:] = plant.data.qpos, plant.inputs["ctrl"]
    rng = np.random.default_rng(1)
    for k in range(300):
        if k % 10 == 0:
            plant.inputs["ctrl"][:7] += rng.uniform(-0.01, 0.01, 7)
            plant.inputs["torque"] = rng.uniform(-5.0, 5.0, 7)
        reference.ctrl[:] = plant.inputs["ctrl"]
        if plant.parameters.scene == TORQUE_DRIVEN:
            reference.ctrl[:7] = plant.inputs["torque"]
        plant.step()
        mujoco.mj_step(plant.model, reference)
        np.testing.assert_array_equal(plant.outputs["qpos"], reference.qpos[:16])
        np.testing.assert_array_equal(plant.outputs["qvel"], reference.qvel[:15])
        np.testing.assert_array_equal(plant.outputs["actuator_force"], reference.actuator_force)


def test_the_blocks_force_lifts_the_block_and_leaves_the_arm_alone():
    free, pushed = Plant(), Plant()
    weight = 9.81 * PlantParameters().block_mass  # N
    pushed.inputs["block_force"][2] = 2 * weight
    free.step(100)
    pushed.step(100)
    moved = pushed.outputs["qpos"] - free.outputs["qpos"]
    assert moved[11] == pytest.approx(9.81 * 0.1**2 / 2, rel=0.05)  # m
    np.testing.assert_allclose(moved[:9], 0.0, atol=1e-9)


@pytest.mark.parametrize("body", sorted(FORCES.keys() - {"block"}))
def test_a_bodys_force_acts_at_its_centre_of_mass(body):
    free, pushed = Plant(), Plant()
    pushed.inputs[FORCES[body]] = force = np.array([30.0, -20.0, 10.0])  # N
    model, data, jac = free.model, free.data, np.zeros((3, free.model.nv))
    mujoco.mj_jacBodyCom(model, data, jac, None, model.body(body).id)
    damping = np.array(SERVO_DAMPING) + model.dof_damping[:7]
    inertia = free.outputs["mass_matrix"] + 1e-3 * np.diag(damping)  # implicit in the velocities
    change = np.linalg.solve(inertia, 1e-3 * jac[:, :7].T @ force)  # [rad/s]
    free.step()
    pushed.step()
    faster = pushed.outputs["qvel"] - free.outputs["qvel"]
    np.testing.assert_allclose(faster[:7], change, rtol=1e-3, atol=1e-6)


states = st.tuples(st.integers(0, 80), st.integers(0, 2**32 - 1), st.sampled_from(SCENES))


@given(states, st.lists(st.floats(-0.2, 0.2), min_size=10, max_size=10))
@settings(max_examples=8, deadline=None)
def test_a_replay_from_a_restored_state_gives_the_same_bits(start, pushes):
    ticks, seed, name = start
    plant = Plant(PlantParameters(scene=name))
    other = Plant(PlantParameters(scene=name))
    excite(plant, ticks, seed)
    excite(other, 3, seed + 1)
    state = plant.get_state()
    other.set_state(state)
    assert other.get_state().tobytes() == state.tobytes()
    assert other.output_values.tobytes() == plant.output_values.tobytes()
    for push in pushes:
        for each in (plant, other):
            each.inputs["ctrl"][:7] += push / 10
            each.inputs["push_force"][:] = 10 * push
            each.inputs["block_force"][:] = push
            each.step()
        assert other.output_values.tobytes() == plant.output_values.tobytes()


def test_reset_starts_again(plant):
    fresh = Plant(plant.parameters)
    excite(plant, 30)
    plant.reset()
    assert plant.output_values.tobytes() == fresh.output_values.tobytes()
    assert plant.input_values.tobytes() == fresh.input_values.tobytes()
    excite(plant, 30)
    excite(fresh, 30)
    assert plant.output_values.tobytes() == fresh.output_values.tobytes()


@pytest.mark.parametrize("mass", [0.05, 1.0])
def test_the_block_has_the_inertia_of_a_box_of_its_mass(mass):
    model = Plant(PlantParameters(block_mass=mass)).model
    x, y, z = 2 * model.geom("obj_geom").size
    box = mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    assert model.body("obj").mass == mass
    np.testing.assert_allclose(np.sort(model.body("obj").inertia), np.sort(box), rtol=1e-9)


@pytest.mark.parametrize(("x", "y", "height"), [(0.45, -0.3, 0.05), (0.6, 0.35, 0.25)])
def test_the_block_starts_where_it_should_on_floor_or_table(x, y, height):
    outputs = Plant(PlantParameters(block_pos=(x, y), block_yaw=0.5)).outputs
    pose = (x, y, height, math.cos(0.25), 0, 0, math.sin(0.25))
    np.testing.assert_allclose(outputs["qpos"][9:], pose, atol=1e-12)
    np.testing.assert_allclose(outputs["target_xpos"], (x, y, height + 0.05), atol=1e-12)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.44, 0.3)])
def test_a_block_inside_something_is_refused(place):
    with pytest.raises(ValueError, match=r"block_pos: the block at .* inside"):
        Plant(PlantParameters(block_pos=place))


@pytest.mark.parametrize("harm", ["velocity", "position", "command"])
def test_divergence_is_an_error_that_says_when(plant, harm, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its log of warnings
    plant.step(10)
    if harm == "velocity":
        plant.data.qvel[:] = 1e12
    elif harm == "position":
        plant.data.qpos[3] = math.nan
    else:
        plant.inputs["ctrl"][2] = plant.inputs["torque"][2] = math.nan
    with pytest.raises(DivergenceError, match=r"diverged at t = 0\.01\d s: BAD"):
        plant.step(3)


ARM = {
    "joint_friction": (0.5,) * 7,
    "joint_viscous": (2.0,) * 7,
    "link_mass_scale": (1.2,) * 7,
    "servo_scale": (0.9,) * 7,
    "torque_limit_scale": (0.8,) * 7,
    "payload": 2.0,
}


def test_the_arms_parameters_change_what_they_say_and_nothing_else():
    plain, changed = (Plant(PlantParameters(**given)).model for given in ({}, ARM))
    equal = np.testing.assert_array_equal
    equal(changed.dof_frictionloss[:8], [0.5] * 7 + [0.0])
    equal(changed.dof_damping[:7], plain.dof_damping[:7] + 2.0)
    equal(changed.actuator_gainprm[:7, 0], 0.9 * plain.actuator_gainprm[:7, 0])
    equal(changed.actuator_forcerange[:7], 0.8 * plain.actuator_forcerange[:7])
    equal(changed.actuator_gainprm[7], plain.actuator_gainprm[7])
    for name in ("link1", "link7"):
        assert changed.body(name).mass == 1.2 * plain.body(name).mass
        equal(changed.body(name).inertia, 1.2 * plain.body(name).inertia)
    assert changed.body("hand").mass == plain.body("hand").mass + 2.0
    assert changed.body("obj").mass == plain.body("obj").mass
