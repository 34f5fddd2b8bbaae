"""The grip force as a command: in a table and as the controller's parameter."""

from __future__ import annotations

from dataclasses import replace

import pytest

from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import preset
from panda_cosim.fmus.errors import InputError
from panda_cosim.result.judging.advice import weakest_grip
from panda_cosim.run.prepare import prepare
from panda_cosim.study.check.diagnosis import rehearse
from panda_cosim.task.scenario import Scenario
from panda_cosim.task.table import TableRow, TrajectoryTable
from random_tasks import run_plain

FORCE = 22.0  # [N] a finger
OFF = 0.03  # of the force, as the pads give


def gripping(force: float) -> Scenario:
    """Grasp the block where it stands."""
    rows = (
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(1.2, "target", (0.0, 0.0, 0.085), 0.06, grip_force=force),
        TableRow(2.0, "target", (0.0, 0.0, 0.085), 0.06, grip_force=force),
        TableRow(2.4, "target", (0.0, 0.0, 0.135), 0.06, grip_force=force),
    )
    return Scenario("grip", TrajectoryTable(rows), duration=2.4)


def test_the_fingers_press_as_the_table_says():
    contact = run_plain(gripping(FORCE))["plant.contact_force"]
    assert contact[-200:] == pytest.approx(2 * FORCE, rel=OFF)


def test_the_parameter_presses_like_the_column():
    row = gripping(FORCE).table.rows[1]
    controllers = [Controller(preset("default", grip_force=FORCE)), Controller()]
    for controller, opening in zip(controllers, (0.02, row.opening), strict=True):
        controller.inputs["grip_cmd"] = opening
        controller.inputs["quat_cmd"] = controller.inputs["hand_xquat"] = (1.0, 0.0, 0.0, 0.0)
        controller.update()
    assert controllers[0].outputs["ctrl"][7] == controllers[1].outputs["ctrl"][7]


def test_a_wide_opening_is_no_grip():
    controller = Controller(preset("default", grip_force=FORCE))
    controller.inputs["grip_cmd"] = 0.07
    controller.inputs["quat_cmd"] = controller.inputs["hand_xquat"] = (1.0, 0.0, 0.0, 0.0)
    controller.update()
    assert controller.outputs["ctrl"][7] == pytest.approx(255 * 0.07 / 0.08)


@pytest.mark.parametrize(
    ("grip", "force", "bound"),
    [(0.06, 31.0, "from 0 to 30 N"), (0.04, 21.0, "must be at most 20 N on what is 0.04 m wide")],
)
def test_an_impossible_force_is_refused(grip, force, bound):
    with pytest.raises(InputError, match=bound):
        TableRow(0.0, "home", (0.0, 0.0, 0.0), grip, grip_force=force)


def test_a_check_says_what_the_block_takes():
    heavy = {"block_mass": 2.0, "block_friction": 0.4}
    robust = replace(gripping(FORCE), gains="robust", scene="elastic", plant=heavy)
    prepared = prepare(robust)
    grip = weakest_grip(rehearse(prepared).recording)
    assert grip is not None
    _, friction, needed = grip
    assert friction < 0.4 * 2.0 * FORCE * 1.05
    assert needed > 0.9 * 2.0 * 9.81
    assert friction < needed


def test_a_scene_without_that_gripper_refuses_the_column():
    with pytest.raises(InputError, match='the gripper of scene "tutorial" is too weak'):
        replace(gripping(FORCE), scene="tutorial")
