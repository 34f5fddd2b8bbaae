"""The MJCF models carry the published numbers, and their contacts are clean."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from panda_cosim.assets import ASSETS, SCENES, TORQUE_DRIVEN, scene_file
from panda_cosim.assets.franka import TORQUE_MAX

BODIES = [*(f"link{i}" for i in range(8)), "hand"]
FINGERS = ("left_finger", "right_finger")
FINGERTIP = 0.1034  # centre of the fingertips along z of the hand [m]
GRASP_HEIGHT = 0.015  # fingertips above the block's centre in a grasp [m]

MENAGERIE = os.environ.get("MENAGERIE_ROOT")
ARM_TOLERANCE = 1e-9  # relative to the quantity's largest entry [1]
CREEP_BOUND = 1e-6  # of a block at rest, over 2 s [m]


@pytest.fixture(params=[name for name in SCENES if name != TORQUE_DRIVEN])
def scene(request):
    """Each complete scene whose arm holds itself."""
    return load(str(request.param))


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(ASSETS / scene_file(name)))


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def put_block(model: mujoco.MjModel, data: mujoco.MjData, position: np.ndarray) -> None:
    start = model.joint("obj_freejoint").qposadr[0]
    data.qpos[start : start + 7] = (*position, 1, 0, 0, 0)
    mujoco.mj_forward(model, data)


def grasped(model: mujoco.MjModel) -> mujoco.MjData:
    """The hand at `home` with the block between its fingers and the gripper told to close."""
    data = at_home(model)
    data.qpos[7:9] = 0.0302
    data.ctrl[7] = 0.0
    put_block(model, data, data.body("hand").xpos - (0, 0, FINGERTIP + GRASP_HEIGHT))
    return data


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[frozenset[str]]:
    """Pairs of bodies that are in contact."""
    return {
        frozenset(model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
        for contact in data.contact
    }


def test_a_scene_is_stepped_by_a_millisecond_and_can_be_drawn_in_1080p(scene):
    assert scene.opt.timestep == 1e-3
    assert scene.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert scene.vis.global_.offwidth >= 1920
    assert scene.vis.global_.offheight >= 1080


def test_motors_are_within_the_robots_torques_and_all_else_is_the_tabletop():
    motors, tabletop = load(TORQUE_DRIVEN), load("tabletop")
    limits = motors.actuator_forcerange[:7]
    np.testing.assert_array_equal(limits, np.column_stack((-TORQUE_MAX, TORQUE_MAX)))
    np.testing.assert_array_equal(motors.actuator_ctrlrange[:7], limits)
    assert (motors.actuator_gainprm[:7, 0] == 1.0).all()
    for field in ("body_mass", "body_inertia", "geom_friction", "geom_solref", "jnt_range"):
        np.testing.assert_array_equal(getattr(motors, field), getattr(tabletop, field))
    for field in ("gainprm", "biasprm", "ctrlrange"):
        one, other = (getattr(model, f"actuator_{field}")[7] for model in (motors, tabletop))
        np.testing.assert_array_equal(one, other)


@pytest.mark.skipif(MENAGERIE is None, reason="MENAGERIE_ROOT is not set")
def test_arm_is_menageries_in_kinematics_dynamics_joints_and_servos():
    """Hand pose, Jacobian, mass matrix and bias force agree in random states."""
    ours = load("panda")
    path = Path(MENAGERIE or "") / "franka_emika_panda" / "panda.xml"
    theirs = mujoco.MjModel.from_xml_path(str(path))
    rng = np.random.default_rng(7)
    low, high = ours.jnt_range.T
    for _ in range(50):
        qpos, qvel = rng.uniform(low, high), rng.normal(size=ours.nv)
        for our, their in zip(
            arm_quantities(ours, qpos, qvel), arm_quantities(theirs, qpos, qvel), strict=True
        ):
            np.testing.assert_allclose(our, their, rtol=0, atol=ARM_TOLERANCE * abs(their).max())
    for field in ("jnt_range", "dof_armature", "dof_damping", "eq_solref", "eq_solimp", "wrap_prm"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field), err_msg=field)
    for field in ("gainprm", "biasprm", "ctrlrange", "forcerange"):
        our, their = getattr(ours, f"actuator_{field}"), getattr(theirs, f"actuator_{field}")
        np.testing.assert_array_equal(our, their[:7], err_msg=field)
    gripper = load("tutorial").actuator("actuator8")
    for field in ("gainprm", "biasprm", "ctrlrange", "forcerange"):
        their = getattr(theirs.actuator("actuator8"), field)
        np.testing.assert_array_equal(getattr(gripper, field), their, err_msg=field)


def arm_quantities(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    hand = data.body("hand")
    jacobian, mass = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], hand.id)
    mujoco.mj_fullM(model, data, mass)
    return hand.xpos, hand.xquat, jacobian, mass, data.qfrc_bias


def test_neighbouring_links_never_touch_and_distant_ones_can():
    """Bodies fewer than three joints apart do not collide in any posture."""
    model = load("panda")
    data = mujoco.MjData(model)
    rng = np.random.default_rng(11)
    order = {name: index for index, name in enumerate(BODIES)}
    order.update(dict.fromkeys(FINGERS, order["hand"]))
    met: set[frozenset[str]] = set()
    for _ in range(300):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_fwdPosition(model, data)
        met |= touching(model, data)
    assert met
    assert all(abs(order[first] - order[second]) >= 3 for first, second in map(tuple, met))


@pytest.mark.parametrize("position", [(0.4, -0.2, 0.05), (0.6, 0.35, 0.25)])
def test_block_at_rest_does_not_creep(scene, position):
    data = at_home(scene)
    put_block(scene, data, np.array(position))
    mujoco.mj_step(scene, data, nstep=300)  # it sinks into its soft contact
    start = data.body("obj").xpos.copy()
    mujoco.mj_step(scene, data, nstep=2000)
    assert np.linalg.norm(data.body("obj").xpos - start) < CREEP_BOUND


@pytest.mark.parametrize("friction", [0.05, 1.7])
def test_every_contact_of_the_block_has_the_blocks_friction(scene, friction):
    """On floor, table and between the pads, whatever friction these have themselves.

    At home it touches the floor alone, and in a grasp the fingers alone: the palm leaves it free.
    """
    scene.geom_friction[:, 0] = 0.8
    scene.geom("obj_geom").friction[0] = friction
    on_floor, on_table, in_hand = at_home(scene), at_home(scene), grasped(scene)
    put_block(scene, on_table, np.array((0.6, 0.35, 0.2)))
    mujoco.mj_step(scene, in_hand, nstep=20)
    for data, partners in ((on_floor, {"world"}), (on_table, {"work_space"}), (in_hand, FINGERS)):
        assert touching(scene, data) == {frozenset({name, "obj"}) for name in partners}
        assert {contact.friction[0] for contact in data.contact} == {friction}


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData, finger: str) -> list[float]:
    """Normal forces between the finger and the block [N]."""
    forces = []
    for index, contact in enumerate(data.contact):
        if {model.body(model.geom_bodyid[geom]).name for geom in contact.geom} == {finger, "obj"}:
            force = np.zeros(6)
            mujoco.mj_contactForce(model, data, index, force)
            forces.append(force[0])
    return forces


def test_strong_gripper_presses_as_the_hand_is_rated():
    """About 30 N per finger on the block, and never more than 70 N even with one finger alone."""
    model = load("tabletop")
    data = grasped(model)
    mujoco.mj_step(model, data, nstep=1000)
    for finger in FINGERS:
        assert sum(contact_forces(model, data, finger)) == pytest.approx(30.0, abs=0.5)
    assert abs(model.actuator("actuator8").forcerange).max() <= 70.0


def test_strong_gripper_follows_the_hands_speed_without_overshoot():
    """It opens at 0.05 m/s a finger within 1.2 mm, and ends within 0.05 mm."""
    model = load("tabletop")
    data = at_home(model)
    data.qpos[7:9] = 0.005
    for tick in range(1500):
        width = min(0.005 + 0.05 * tick * 1e-3, 0.035)
        data.ctrl[7] = width / 0.04 * 255
        mujoco.mj_step(model, data)
        assert abs(data.qpos[7] - width) < 1.2e-3
        assert data.qpos[7] < 0.035 + 5e-5
    assert data.qpos[7] == pytest.approx(0.035, abs=5e-5)
