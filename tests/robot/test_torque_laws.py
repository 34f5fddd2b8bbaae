"""Laws that give torques, or angles: the words for what does not fit, and options in any order."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from control_support import started
from fault_support import write_files
from forked import command
from panda_cosim import InputError, Push, load_scenario, run_scenario
from panda_cosim.assets.franka import TORQUE_MAX, TORQUE_RATE_MAX
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.presets import OF_IMPEDANCE, OF_SERVOS, preset
from panda_cosim.run.prepare import prepare
from panda_cosim.task.rotations import Array
from parts_jobs import write_arm

LAWS = '''
import numpy as np

HOME = np.array([0, 0, 0, -1.57079, 0, 1.57079, -0.7853])

class OSC:
    """Operational space: torques; they settle soon, so that an analysis is short."""
    stiffness = 400.0
    def update(self, time, pos_cmd, hand_xpos, jac, qpos, qvel, qfrc_bias, grip_cmd):
        force = self.stiffness * (pos_cmd - hand_xpos) - 40 * (jac[:3] @ qvel)
        torque = jac[:3].T @ force + 200 * (HOME - qpos) - 30 * qvel + qfrc_bias
        return np.hstack((np.clip(torque, -80, 80), 255 * grip_cmd / 0.08))

class Angles:
    """Resolved rate: servo targets."""
    def update(self, time, pos_cmd, hand_xpos, jac, qpos, grip_cmd):
        move = np.linalg.pinv(jac[:3]) @ (pos_cmd - hand_xpos)
        return np.hstack((qpos + 0.1 * move, 255 * grip_cmd / 0.08))
'''
MOTORS = ("--set", "scene=motors")


@pytest.fixture
def laws(tmp_path):
    (tmp_path / "laws.py").write_text(LAWS)
    write_files(tmp_path / "hold", "duration = 0.2\n")
    return tmp_path


def said(*arguments: object) -> tuple[int, str]:
    done = command(*arguments)
    return done.returncode, done.stdout + done.stderr


def test_a_torque_law_and_its_scene_are_named_in_any_order(laws):
    law = ("--controller", f"{laws / 'laws.py'}:OSC")
    gain = ("--set", "controller.stiffness=300")
    for options in ((*law, *MOTORS), (*MOTORS, *law)):
        assert said("check", laws / "hold", *options, *gain)[0] == 0
    out = ("--no-video", "--no-view", "--out", laws / "run")
    code, text = said("run", laws / "hold", *options, *gain, *out)
    assert code == 0, text
    assert "controller.kp" not in text
    code, text = said("analyze", laws / "hold", *options, *gain, "--at", "0.1", "--out", laws / "a")
    assert code == 0, text
    assert "plant.torque[7]" in text
    assert "plant.ctrl[8]" not in text  # the gripper has no loop
    assert "gauss-seidel: stable" in text


@pytest.mark.parametrize(
    ("law", "scene", "fits"),
    [("OSC", (), 'scene "motors" takes torques'), ("Angles", MOTORS, 'scene "tabletop" takes')],
)
def test_a_law_that_does_not_fit_the_scene_is_refused_with_one_that_does(laws, law, scene, fits):
    options = ("--controller", f"{laws / 'laws.py'}:{law}", *scene)
    code, text = said("run", laws / "hold", *options, "--no-video", "--out", laws / "run")
    assert code == 1
    assert fits in text
    code, text = said("analyze", laws / "hold", *options, "--out", laws / "analysis")
    assert code == 1
    assert fits in text
    assert not (laws / "analysis").exists()


@pytest.mark.parametrize(
    ("head", "body", "code", "words"),
    [
        ("import no_such", "return [0.0] * 8", 2, "bad.py, line 1: ModuleNotFoundError"),
        ("", "return 'text'", 1, "bad.py: update returned 'text'; must be numbers"),
        ("", "return [0.0] * 8\n    def start(self): 1 / 0", 2, "line 5: ZeroDivisionError"),
    ],
)
def test_a_law_that_cannot_be_imported_or_gives_no_numbers_is_named(laws, head, body, code, words):
    (laws / "bad.py").write_text(
        f"{head}\nclass Bad:\n    def update(self, time, qpos):\n        {body}\n"
    )
    law = ("--controller", f"{laws / 'bad.py'}:Bad")
    done = said("run", laws / "hold", *law, "--no-video", "--out", laws / "run")
    assert done[0] == code
    assert words in done[1]
    assert (laws / "run").exists() == (code == 1)


# The impedance law: its formulas, its limits, pushes, and what the border refuses.


TORQUES = {"scene": "motors", "gains": "impedance"}
MOVING = load_scenario("pick_and_place").changed({**TORQUES, "duration": 4.0})
TASKS = ("pick_and_place_impedance", "wipe", "peg_in_hole", "stack_impedance", "open_door")
SHARE = 0.99  # of the limits, the default `limit_share`
REST = preset("impedance", posture_stiffness=0.0, posture_damping=0.0)


def at_home(controller: Controller) -> tuple[Any, Array, Array]:
    """Give the controller what the plant measures at home; returns plant, M (7, 7) and J (6, 7)."""
    plant, x = started()[0], controller.inputs
    plant.data.qpos[:7] = np.array([0.2, -0.3, 0.1, -2.0, 0.3, 1.8, 0.4])  # away from symmetries
    mujoco.mj_forward(plant.model, plant.data)
    hand, inertia = plant.model.body("hand").id, np.zeros((plant.model.nv,) * 2)
    jac = np.zeros((6, plant.model.nv))
    mujoco.mj_jacBody(plant.model, plant.data, jac[:3], jac[3:], hand)
    mujoco.mj_fullM(plant.model, plant.data, inertia)
    x["qpos"], x["qvel"], x["jac"] = plant.data.qpos[:7], 0.0, jac[:, :7]
    x["pos_cmd"] = x["hand_xpos"] = plant.data.xpos[hand]
    x["quat_cmd"] = x["hand_xquat"] = plant.data.xquat[hand]
    return plant, inertia[:7, :7], jac[:, :7]


def settled(controller: Controller) -> Array:
    """Torques of the motors (7,) once their rate limit no longer binds."""
    for _ in range(100):
        controller.update()
    return np.array(controller.outputs["motor_torque"])


@pytest.mark.parametrize(("law", "others"), [("impedance", OF_SERVOS), ("default", OF_IMPEDANCE)])
def test_the_gains_of_the_other_laws_change_nothing(law, others):
    def outputs(gains: Gains) -> Array:
        controller, random = Controller(gains), np.random.default_rng(3)
        at_home(controller)
        rows = []
        for _ in range(20):
            controller.inputs["qvel"] = random.normal(0.0, 0.1, 7)
            controller.update()
            rows.append(controller.output_values.copy())
        return np.array(rows)

    gains = preset(law)
    expected = outputs(gains)
    for name in others:
        changed = replace(gains, **{name: (0.5 * np.array(getattr(gains, name)) + 1.0).tolist()})
        np.testing.assert_array_equal(outputs(changed), expected, err_msg=name)
    key = f"controller.{min(others)}"
    task = {"impedance": "pick_and_place_impedance", "default": "pick_and_place"}[law]
    scenario = load_scenario(task).changed({key: 2.0})
    assert prepare(scenario).notes[0].startswith(f"[controller] {min(others)}: without effect")


def test_springs_offset_and_commanded_force_act_at_the_hand():
    controller = Controller(replace(REST, offset_rate=0.0))
    plant, _, jac = at_home(controller)
    held = settled(controller)
    np.testing.assert_allclose(held, plant.data.qfrc_bias[:7], atol=0.05)  # fingers open or closed
    controller.inputs["pos_cmd"] += (1e-3, -2e-3, 3e-3)
    bent = settled(controller)
    np.testing.assert_allclose(bent - held, jac[:3].T @ (3.0, -6.0, 9.0), atol=1e-9)
    controller.inputs["force_cmd"] = (0.0, 0.0, -8.0)
    pressed = settled(controller)
    np.testing.assert_allclose(pressed - bent, jac[:3].T @ (0.0, 0.0, -8.0), atol=1e-9)
    controller.inputs["pos_cmd"] += (1.0, 0.0, 0.0)  # the springs are as strong as they may be
    far = np.linalg.lstsq(jac.T, settled(controller) - held, rcond=None)[0]
    assert np.linalg.norm(far[:3] - (0.0, 0.0, -8.0)) == pytest.approx(60.0)


def test_the_offset_grows_but_along_the_axis_of_a_commanded_force():
    controller = Controller(replace(REST, offset_rate=2.0, offset_limit=(20.0,) * 6))
    _, _, jac = at_home(controller)
    controller.inputs["pos_cmd"] += 1e-3
    controller.inputs["force_cmd"] = (0.0, 0.0, -8.0)
    before = settled(controller)
    grown = np.linalg.lstsq(jac.T, settled(controller) - before, rcond=None)[0]
    np.testing.assert_allclose(grown, (0.6, 0.6, 0.0, 0.0, 0.0, 0.0), atol=1e-6)  # 2/s 3 N 0.1 s


@pytest.mark.parametrize("ratio", [0.7, 1.0])
def test_each_mode_of_the_hand_on_its_springs_has_the_damping_ratio(ratio):
    controller = Controller(replace(REST, damping_ratio=ratio, offset_rate=0.0))
    _, inertia, jac = at_home(controller)
    held = settled(controller)
    damping = np.empty((6, 6))
    for column, twist in enumerate(1e-3 * np.eye(6)):  # commanded, while the hand rests
        controller.inputs["vel_cmd"], controller.inputs["omega_cmd"] = twist[:3], twist[3:]
        force = np.linalg.lstsq(jac.T, settled(controller) - held, rcond=None)[0]
        damping[:, column] = 1e3 * force
    stiffness = np.diag(REST.stiffness)
    of_hand = np.linalg.inv(jac @ np.linalg.solve(inertia, jac.T))
    root = np.linalg.cholesky(of_hand)
    squares, modes = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, stiffness).T))
    modes = np.linalg.solve(root.T, modes)  # modes.T L modes is the identity
    expected = np.diag(2.0 * ratio * np.sqrt(squares))
    np.testing.assert_allclose(modes.T @ damping @ modes, expected, atol=0.02 * expected.max())


@pytest.mark.own_process
@pytest.mark.parametrize(("axis", "force"), [(0, -150.0), (1, 150.0), (2, -150.0)])  # N
def test_a_hand_that_is_pushed_comes_back_to_its_path(tmp_path, axis, force):
    push = Push(start=0.6, duration=0.3, force=tuple(force * np.eye(3)[axis]))
    record = run_scenario(replace(MOVING, push=(push,)), tmp_path / "run").recording
    error = np.linalg.norm(record["plant.hand_xpos"] - record["controller.pos_cmd"], axis=1)
    assert error.max() > 0.05  # m
    assert error[3900] < 1e-4  # m, 3 s later
    torque = record["controller.motor_torque"]
    assert (np.abs(torque) <= SHARE * TORQUE_MAX + 1e-9).all()
    assert (np.abs(np.diff(torque, axis=0)) <= SHARE * 1e-3 * TORQUE_RATE_MAX + 1e-9).all()


@pytest.mark.long
@pytest.mark.own_process
@pytest.mark.parametrize("name", TASKS)
def test_a_task_in_contact_succeeds_with_other_robots(tmp_path, name):
    for seed in (2, 3):
        varied = load_scenario(name).changed({"mismatch.seed": seed})
        assert run_scenario(varied, tmp_path / str(seed)).summary.success


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"gains": "impedance"}, 'must come with scene = "motors"'),
        ({"scene": "motors"}, 'such as gains = "impedance"'),
        ({**TORQUES, "controller.reaction": "stop"}, "with impedance, it must be"),
    ],
)
def test_what_does_not_fit_is_refused(values, words):
    with pytest.raises((InputError, ValueError), match=words):
        prepare(load_scenario("pick_and_place").changed(values))


def test_mismatch_needs_a_plant_that_extends_ours(tmp_path):
    model = '[fmus]\nplant = "arm.xml"\n[mismatch]\npreset = "calibrated"\n'
    write_files(write_arm(tmp_path), f"duration = 0.1\n{model}")
    done = command("check", tmp_path, code=2)
    assert "mismatch: only valid with the project's plant, or one that extends it" in done.stdout
