"""The second arm, FR3: its numbers, its limits, and the shipped scenarios with it."""

import numpy as np
import pytest

from libfranka import speed
from panda_cosim import InputError, Scenario, load_scenario, run_scenario, shipped_scenarios
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import Plant
from panda_cosim.study.check.diagnosis import feasibility
from panda_cosim.task.rotations import Array
from random_tasks import run_plain

ROUNDING = 1e-6  # of a limit
# Scenarios that this arm does not manage.
BEYOND = {
    "pick_and_place_fast": "asks for 1.6 times its acceleration",
    "draw_circle": "its springs of 500 N/m do not overcome the joints' friction",
    "peg_in_hole": "nor do its springs, with the friction that `calibrated` adds",
    "wipe": "it presses for 0.4 s with more than the most, with that friction",
}


def with_fr3(name: str) -> Scenario:
    return load_scenario(name).changed({"robot": "fr3"})


def velocity_shares(q: Array, qd: Array) -> Array:
    return np.abs(qd) / np.maximum(speed("fr3", q, qd), 1e-3)


def test_its_links_and_ranges_are_its_own():
    model = Plant(PlantParameters(robot="fr3")).model
    assert (model.body("link1").mass, model.body("link2").mass) == (2.92747, 2.93554)
    assert model.jnt_range[5].tolist() == [0.4398, 4.6216]


@pytest.mark.own_process
def test_the_law_keeps_its_limits_where_more_is_asked_for():
    hasty = run_scenario(with_fr3("pick_and_place_fast")).recording
    q, qd = hasty["controller.qpos_ref"], hasty["controller.qvel_ref"]
    acceleration = np.abs(np.diff(qd, axis=0)).max() / 1e-3  # rad/s^2
    jerk = np.abs(np.diff(qd, 2, axis=0)).max() / 1e-6  # rad/s^3
    assert 9.8 < acceleration <= 0.99 * 10.0 * (1.0 + ROUNDING)
    assert 4800.0 < jerk <= 0.99 * 5000.0 * (1.0 + ROUNDING)
    assert velocity_shares(q, qd).max() <= 1.0


@pytest.mark.own_process
def test_shares_of_limits_are_those_of_the_arm():
    run = run_scenario(with_fr3("pick_and_place").changed({"duration": 1.5}))
    recording, limits = run.recording, run.summary.limits
    q, qd = recording["plant.qpos"][:, :7], recording["plant.qvel"][:, :7]
    assert limits["velocity_share"] == pytest.approx(velocity_shares(q, qd).max(axis=0))
    changes = np.abs(np.diff(recording["controller.qvel_ref"], axis=0)).max(axis=0) / 1e-3
    assert limits["reference_acceleration_share"] == pytest.approx(changes / 10.0)


def test_check_names_what_is_too_fast_for_it():
    violations, shares = feasibility(with_fr3("pick_and_place_fast"))
    assert any(v.quantity == "acceleration" and v.limit == 10.0 for v in violations)
    assert shares["acceleration"] == pytest.approx(1.6, abs=0.05)


@pytest.mark.own_process
@pytest.mark.parametrize("name", ["pick_and_place", "elastic"])
def test_native_fmus_give_the_bits_of_python(tmp_path, name):
    scenario = with_fr3(name).changed({"duration": 1.0})
    recording = run_scenario(scenario, tmp_path / "run").recording
    plain = run_plain(scenario)
    assert np.array_equal(recording["plant.qpos"], plain["plant.qpos"])
    assert np.array_equal(recording["controller.ctrl"], plain["controller.ctrl"])


@pytest.mark.long
@pytest.mark.own_process
@pytest.mark.parametrize("name", shipped_scenarios())
def test_it_runs_the_shipped_scenarios(name, tmp_path):
    assert run_scenario(with_fr3(name), tmp_path / name).summary.success == (name not in BEYOND)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"robot": "fr4"}, "robot: value 'fr4'; must be one of panda, fr3"),
        ({"controller.robot": "fr3"}, "robot: must stand at the top"),
    ],
)
def test_other_robots_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        load_scenario("pick_and_place").changed(values)
