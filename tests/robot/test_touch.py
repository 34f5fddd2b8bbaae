"""What the controller feels: observed torques, contacts and collisions, and the reactions."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from control_support import hold, started
from panda_cosim import Push, Scenario, Session, SignalCriterion, Success, load_scenario
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.result.judging.advice import refusals
from panda_cosim.result.judging.holds import COLLISION
from panda_cosim.result.pictures.motion import key_moments
from random_tasks import run_in_memory

PATH = replace(load_scenario("push"), push=())  # m; it moves until 1.2 s
NUMERICAL = 0.02  # [N.m] of the observer on a model that is exact, by its finite differences


def pushed(link: str, force: tuple[float, float, float]) -> Scenario:
    return replace(PATH, push=(Push(start=0.3, duration=1.7, force=force, on=link),))


@pytest.mark.parametrize("link", ["link2", "link4", "link6", "hand"])
def test_the_observer_finds_the_torques_of_a_push_while_the_arm_moves(link):
    force = np.array([12.0, -20.0, 7.0])  # N
    scenario = replace(pushed(link, tuple(force)), controller={"observer": True})
    run = run_in_memory(scenario).signals
    plant, _ = started()
    for row in (600, 900, 1500):
        plant.data.qpos[:7] = run["plant.qpos"][row, :7]
        mujoco.mj_forward(plant.model, plant.data)
        jac = np.zeros((3, plant.model.nv))
        mujoco.mj_jacBodyCom(plant.model, plant.data, jac, None, plant.model.body(link).id)
        observed = run["controller.external_torque"][row]
        np.testing.assert_allclose(observed, jac[:, :7].T @ force, atol=0.3)  # it lags by 2 ms
        wrench = np.linalg.lstsq(run["plant.jac"][row].reshape(6, 7).T, observed, rcond=None)[0]
        np.testing.assert_allclose(run["controller.external_force"][row], wrench, atol=1e-6)
    before = run["controller.external_torque"][:300]
    assert np.abs(before).max() < NUMERICAL


def test_the_observer_follows_with_its_time_constant():
    controller = Controller(Gains(observer=True, observer_gain=250.0), 0.002)
    plant, torque = started()[0], np.arange(7.0)
    hold(plant, controller)
    controller.inputs["qvel"], controller.inputs["qfrc_bias"] = 0.0, 0.0
    controller.inputs["actuator_force"][:7] = -torque  # the arm rests although its servos push
    for count in range(5):
        expected = torque * (1.0 - (1.0 + 250.0 * 0.002) ** -count)
        controller.update()
        np.testing.assert_allclose(controller.outputs["external_torque"], expected, atol=1e-9)


def test_a_contact_ends_and_a_collision_stays():
    gains = Gains(observer=True, observer_gain=1e4)
    controller, (plant, _) = Controller(gains), started()
    hold(plant, controller)
    states = []
    for torque in (0.0, 9.0, 11.0, 9.0, 21.0, 0.0):  # N.m on joint 2
        controller.inputs["qfrc_bias"][:] = controller.inputs["actuator_force"][:7] = 0.0
        controller.inputs["actuator_force"][1] = torque
        for _ in range(5):
            controller.update()
        states.append(controller.outputs["joint_contact"].tolist())
    assert [joints[1] for joints in states] == [0, 0, 1, 0, 2, 2]
    assert not np.delete(states, 1, axis=1).any()


@pytest.mark.parametrize("law", [True, False])
def test_an_observer_alone_changes_nothing_else(law):
    scenario = replace(load_scenario("pick_and_place" if law else "tutorial"), duration=0.5)
    plain = run_in_memory(scenario).signals
    observed = run_in_memory(
        replace(scenario, controller={**scenario.controller, "observer": True})
    )
    touch = {f"controller.{n}" for n in ("external_torque", "external_force", "joint_contact")}
    assert observed.signals.keys() - plain.keys() == touch
    for name, values in plain.items():
        assert np.array_equal(values, observed.signals[name]), name


def test_a_criterion_about_touch_turns_the_observer_on():
    criterion = SignalCriterion("controller.external_torque[2]", reduce="max", above=1.0)
    scenario = replace(
        pushed("hand", (0.0, 0.0, -9.0)), duration=0.5, success=Success(signal=(criterion,))
    )
    assert run_in_memory(scenario).summary.success


@pytest.mark.parametrize("reaction", ["stop", "yield"])
def test_a_hand_that_presses_on_the_table_stops_or_gives_way(reaction):
    scenario = load_scenario("collision")
    run = run_in_memory(replace(scenario, controller={"reaction": reaction}, preflight="fer"))
    force = run.signals["plant.unwanted_contact_force"].ravel()
    first = int(np.argmax((run.signals["controller.joint_contact"] == COLLISION).any(axis=1)))
    assert run.summary.events["collision"] == pytest.approx(first * 0.001)
    assert 10.0 < force.max() < 40.0  # N; 223 without a reaction
    assert force[first + 50 :].max() < 25.0  # N
    assert force[-1] < (25.0 if reaction == "stop" else 0.1)
    moved = run.signals["plant.hand_xpos"][-1] - run.signals["plant.hand_xpos"][first + 50]
    assert np.linalg.norm(moved) < 0.001  # m, the rest of the run
    advice = [text for _, text in refusals(run.summary.preflight, complete=True)]
    assert any("it follows the touch at t = " in text for text in advice)
    assert not any("retime" in text for text in advice)


def test_an_arm_that_has_stopped_goes_on_when_the_reaction_is_none(tmp_path):
    scenario = replace(
        pushed("link6", (0.0, 0.0, -90.0)), controller={"reaction": "stop"}, duration=4.0
    )
    with Session(scenario, tmp_path / "run") as session:
        session.step(2200)  # the push has ended
        assert _off_path(session) > 0.05  # m
        session.set("controller.reaction", "none")
        session.step(1790)
        assert _off_path(session) < 0.001  # m
        run = session.close()
    labels = {moment.label: moment.time for moment in key_moments(run.recording, 12)}
    assert labels["collision"] == run.summary.events["collision"]


def _off_path(session: Session) -> float:
    """Distance of the hand from its command [m]."""
    now = session.state()
    pairs = [(now[f"plant.hand_xpos[{i}]"], now[f"controller.pos_cmd[{i}]"]) for i in (1, 2, 3)]
    return float(np.linalg.norm([float(hand) - float(command) for hand, command in pairs]))
