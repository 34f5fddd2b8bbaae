"""A new scenario runs at the first try, and what is wrong with one is explained."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fault_support import write_files
from panda_cosim import Run, Scenario, load_scenario, run_scenario, shipped_scenarios
from panda_cosim.assets.franka import CTRL_OPEN, FINGER_SPEED_MAX, HOME_Q, OPENING_MAX
from panda_cosim.cli.app import app
from panda_cosim.result.judging.advice import advise, weakest_grip
from panda_cosim.run.prepare import prepare
from panda_cosim.study.check.diagnosis import check_folder, rehearse
from panda_cosim.study.sweep.definition import load_sweep
from panda_cosim.study.sweep.sweeping import check_sweep
from panda_cosim.task.writer import make_scenario, write_scenario
from refusals import refused


def test_a_new_scenario_with_parts_of_its_own_runs_and_is_swept(tmp_path):
    runner = CliRunner()
    new = runner.invoke(app, ["new", str(tmp_path / "own"), "--law", "--plant", "--sweep"])
    assert new.exit_code == 0, new.output
    assert f"panda-cosim sweep {tmp_path / 'own'}/sweep.toml" in new.output
    run = run_scenario(tmp_path / "own", tmp_path / "run")
    assert run.summary.success, run.summary.criteria
    assert "plant.pillar_xpos[1]" in run.recording.columns
    _, design = check_sweep(load_sweep(tmp_path / "own" / "sweep.toml"))
    assert len(design) == 40


def test_check_suggests_no_torques_for_a_scene_with_servos(tmp_path):
    make_scenario(tmp_path / "own", ["plant"])
    assert [each.level for each in check_folder(tmp_path / "own")] == ["good", "good"]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_copy_of_a_shipped_scenario_is_equal_to_it(name, tmp_path):
    make_scenario(tmp_path / "copy", copied=name)
    shipped = Scenario.read(shipped_scenarios()[name])
    same = replace(shipped, name="copy", folder=tmp_path / "copy")
    assert Scenario.read(tmp_path / "copy") == same
    assert not (tmp_path / "copy" / "reference.parquet").exists()


def test_what_cannot_be_copied_is_refused(tmp_path):
    for options, words in (
        (("--from", "pusch"), "did you mean 'push'"),
        (("--from", "push", "--law"), "--from: cannot be combined with"),
    ):
        done = CliRunner().invoke(app, ["new", str(tmp_path / "copy"), *options])
        assert (done.exit_code, words in done.output) == (2, True)
        assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("name", ["-lift", "li/ft\n", "..", "x" * 201])
def test_a_bad_name_is_refused(tmp_path, name):
    assert "scenario name" in refused(make_scenario, tmp_path / name)


def test_a_new_scenario_can_run_at_the_first_try_and_is_not_written_over(tmp_path):
    runner = CliRunner()
    made = runner.invoke(app, ["new", str(tmp_path / "lift")])
    assert made.exit_code == 0
    assert "trajectory.csv" in made.output
    checked = runner.invoke(app, ["check", str(tmp_path / "lift")])
    assert checked.exit_code == 0
    order, lift = (" ".join(line.split()) for line in checked.output.splitlines())
    assert order.startswith("good FMUs are stepped in the order controller, plant; a step late: ")
    holds = "the grip holds 31.6 N by friction, 1.89 N needed"
    assert lift == f"good lift: 5 rows, 3.4 s; {holds}; it can run"
    assert runner.invoke(app, ["check", str(tmp_path / "lif")]).exit_code == 2
    (tmp_path / "lift" / "trajectory.csv").unlink()
    again = runner.invoke(app, ["new", str(tmp_path / "lift")])
    assert (again.exit_code, "already exists" in again.output) == (2, True)
    assert not (tmp_path / "lift" / "trajectory.csv").exists()


EDITS = [  # file, what is there, what is put there, level, what is told
    ("scenario.toml", "block_mass", "block_mas", "wrong", "did you mean 'block_mass'"),
    ("scenario.toml", "0.4, -0.2", "0.65, 0.09", "wrong", "would start"),
    ("scenario.toml", "duration = 3.4", "duration = 3.4005", "wrong", "whole number of ticks"),
    ("scenario.toml", "duration = 3.4", "duration =", "wrong", "scenario.toml"),
    ("scenario.toml", "duration = 3.4", "duration = 2.5", "hint", "it is never reached"),
    ("scenario.toml", "Picks the block up and holds it", "", "hint", "purpose is empty"),
    ("trajectory.csv", "0.08\n1.2", "0,08\n1.2", "wrong", "line 2: 7 values; must be 6"),
    ("trajectory.csv", "1.7,target,0.0", "1.7,target,1.0", "hint", "within the arm's reach"),
    ("trajectory.csv", "0.085,0.0\n2", "-0.085,0.0\n2", "hint", "the path must avoid this"),
    ("trajectory.csv", "1.2,target", "0.1,target", "hint", "of joint"),
]


@pytest.mark.parametrize(("file", "before", "after", "level", "told"), EDITS)
def test_what_is_wrong_is_explained(tmp_path, file, before, after, level, told):
    make_scenario(tmp_path / "lift")
    path = tmp_path / "lift" / file
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after))
    diagnostics = check_folder(path.parent)
    assert any(f.level == level and told in f.text for f in diagnostics), diagnostics
    assert all("\n" not in f.text for f in diagnostics)


@pytest.mark.parametrize("name", [pytest.param("beyond_reach", marks=pytest.mark.long), "tutorial"])
def test_nothing_is_wrong_with_the_shipped_ones(name):
    diagnostics = check_folder(shipped_scenarios()[name])
    # They ask for what the arm cannot do, the tutorial by its law.
    order, *rest = sorted(diagnostics, key=lambda f: f.level)
    assert order.text.startswith("FMUs are stepped in the order controller, plant")
    assert {f.level for f in rest} == {"hint"}, diagnostics


FOLDER = shipped_scenarios()["pick_and_place"]


def rehearsed(plant: Mapping[str, float | tuple[float, ...]]) -> Run:
    scenario = load_scenario("pick_and_place")
    return rehearse(prepare(replace(scenario, plant={**scenario.plant, **plant})))


def test_pick_and_place_goes_well_and_a_rehearsal_is_the_run(tmp_path):
    rehearsal = rehearsed({})
    assert list(advise(rehearsal.recording, rehearsal.summary)) == []
    failing = replace(load_scenario("jacobi"), expect="failure", expect_reason="so")
    write_scenario(failing, tmp_path / "failing")
    assert "but a failure is expected" in check_folder(tmp_path / "failing")[0].text
    grip = weakest_grip(rehearsal.recording)
    assert grip is not None
    assert grip[1] > 2.0 * grip[2]
    run = run_scenario("pick_and_place", tmp_path / "run")
    for name in run.recording.columns:
        np.testing.assert_array_equal(run.recording[name], rehearsal.recording[name])


@pytest.mark.parametrize(
    ("place", "bodies"), [((0.5, 0.0), "block and table"), ((0.4, 0.4), "left_finger and table")]
)
def test_what_is_in_the_way_is_named_first(place, bodies):
    rehearsal = rehearsed({"block_pos": place})
    texts = [*advise(rehearsal.recording, rehearsal.summary)]
    assert texts[0].endswith("the path must avoid this: `panda-cosim route SCENARIO`")
    assert any(re.match(rf"trajectory.csv: row \d: {bodies} touch", text) for text in texts)


@pytest.mark.parametrize(
    ("success", "message"),
    [
        ("max_slip = 0.001", "max_slip not measured"),
        ("[[success.signal]]\nsignal = 'plant.hand_xpos[3]'\nreduce = 'min'\nabove = 0.1\n"
         "from = 'release'", "not measured (no release in this run)"),
        ("[[success.body]]\nbody = 'obj'\nmax_tilt = 1.0\nat = 'grasp'", "no grasp in this run"),
        ("max_tilt = 1.0", ""),
    ],
)  # fmt: skip
def test_a_criterion_on_what_never_happens_is_refused(tmp_path, success, message):
    """The hand stays where it is, and holds nothing."""
    write_files(tmp_path, f"duration = 0.2\n[success]\n{success}\n")
    wrong = [each.text for each in check_folder(tmp_path) if each.level == "wrong"]
    assert len(wrong) == bool(message)
    assert message in "".join(wrong)


def test_check_takes_parameters_and_does_not_say_it_can_run_beside_them():
    assert check_folder(FOLDER)[-1].level == "good"
    heavy = check_folder(FOLDER, {"plant.block_mass": 1.2, "plant.block_friction": 0.5})
    assert any("N by friction; the block needs" in finding.text for finding in heavy)
    assert not any("can run" in finding.text for finding in heavy)
    idle = check_folder(FOLDER, {"timing_share": 0.5, "mismatch.seed": 3})
    assert sum("has no effect" in finding.text for finding in idle) == 2
    assert "acts only with scene" in check_folder(FOLDER, {"inputs.plant.torque": 1.0})[0].text
    unknown = check_folder(FOLDER, {"plant.block_maas": 1.0})
    assert [finding.level for finding in unknown] == ["wrong"]
    assert "block_maas" in unknown[0].text


def test_a_push_is_the_cause_of_the_torque_rate_that_answers_it_in_check_and_run(tmp_path):
    checked = [each.text for each in check_folder(shipped_scenarios()["push"])]
    assert re.search(r"torque rate .*; it follows a push: push more gently", checked[0])
    out = ["--no-video", "--no-view", "--out", str(tmp_path / "run")]
    assert checked[0] in CliRunner().invoke(app, ["run", "push", *out]).output.splitlines()


def test_check_advises_no_more_time_for_what_is_out_of_reach():
    told = str(check_folder(shipped_scenarios()["near_singular"]))
    assert "more time does not help" in told
    assert "retime" not in told


def test_check_rehearses_with_the_errors_of_the_sensors():
    calibrated = check_folder(FOLDER, {"mismatch.preset": "calibrated"})
    assert "mismatch of joint_offset" in calibrated[-1].text
    hints = [finding.text for finding in calibrated[:-1] if finding.level == "hint"]
    texts = [text for text in hints if "[success]" not in text]
    assert len(texts) == 3  # noise with the default gains: the cause, then the symptoms
    assert texts[0].startswith("gains: the default ones do not suit mismatch.joint_noise")
    assert re.search(r"jerk limit of joint \d first limits .*; with noisy readings, ", texts[1])
    assert re.search(r"torque rate of joint \d is \d+% .*; it follows the jerk limit", texts[2])
    aside = check_folder(FOLDER, {"mismatch.block_position_error[2]": 0.05})
    # The slip of what is not grasped cannot be measured; that it is not lifted is a verdict.
    assert "wrong" not in {finding.level for finding in aside}
    assert any("max_slip not measured" in finding.text for finding in aside)
    assert any("min_lift 0 mm, required 100 mm" in finding.text for finding in aside)


def test_a_hand_that_moves_on_before_the_fingers_let_go_is_told():
    strong = {"controller.grip_force": 20.0}
    (told,) = (f.text for f in check_folder(FOLDER, strong) if "the hand moves on" in f.text)
    assert re.search(r"row 7: .* still presses with 1.8\d* N; it must stay 0.04 s longer", told)
    # With that much more dwell it does not.
    scenario = load_scenario("pick_and_place")
    rows = scenario.table.rows
    later = {f"table.rows[{n}].time": rows[n - 1].time + 0.05 for n in range(8, len(rows) + 1)}
    longer = rehearse(prepare(scenario.changed({**later, **strong, "duration": 6.6})))
    said = advise(longer.recording, longer.summary)
    assert not any("the hand moves on" in text for text in said)


class Damped:
    """Carries the arm and damps its joints; a torque and the gripper's command jump."""

    damping = 10.0
    torque = 0.0  # of joint 1, at 0.1 s

    def update(self, time, qvel, qfrc_bias):
        """Return torques, and the gripper's command."""
        torque = qfrc_bias - self.damping * qvel[:7]
        torque[0] += self.torque * (time > 0.1)
        return [*torque, 255.0 if time < 0.2 else 0.0]


class Home:
    """Holds the arm by its servos; the gripper's command jumps."""

    def update(self, time, qpos):
        """Return servo targets, and the gripper's command."""
        return [*HOME_Q, 255.0 if time < 0.2 else 0.0]


def of_law(law: type, scene: str, **parameters: float) -> Run:
    values = {"fmus.controller": law, "scene": scene, "duration": 0.4}
    values |= {f"controller.{name}": value for name, value in parameters.items()}
    return rehearse(prepare(load_scenario("tutorial").changed(values)))


def advice(run: Run) -> list[str]:
    return list(advise(run.recording, run.summary, ours=False))


@pytest.mark.parametrize(("damping", "unstable"), [(1000.0, True), (10.0, False)])
def test_a_torque_that_swings_from_limit_to_limit_is_an_unstable_loop(damping, unstable):
    told = advice(of_law(Damped, "motors", damping=damping, torque=200.0))
    (limit,) = (line for line in told if "torque limit of joint" in line)
    assert ("the loop is unstable" in limit) == unstable
    assert ("give that row more time" in limit) == (not unstable)


def test_fingers_are_too_fast_by_a_jump_or_a_touch_but_not_by_a_torque_law(monkeypatch):
    rate = 0.001 * FINGER_SPEED_MAX / (OPENING_MAX / 2) * CTRL_OPEN  # a ms
    run = of_law(Home, "tabletop")
    (line,) = (line for line in advice(run) if "finger speed" in line)
    assert f"; move the gripper's command gradually, by at most {rate:.2f} (of 255) a ms" in line
    monkeypatch.setattr("panda_cosim.result.judging.advice.GRADUAL", CTRL_OPEN)  # as if it did not
    (line,) = (line for line in advice(run) if "finger speed" in line)
    assert "; no command asks for it: touch and set bodies down more gently" in line
    run = of_law(Damped, "motors")  # the hand moves as fast as it can
    assert not [line for line in advice(run) if "finger speed" in line]
    assert np.diff(run.recording["controller.ctrl[8]"])[-150:] == pytest.approx(-rate)


@pytest.mark.parametrize("yaw", [2.8, -2.4])
def test_a_block_turned_too_far_for_joint_7_is_picked_up_all_the_same(yaw):
    run = rehearsed({"block_yaw": yaw})
    assert run.recording["plant.qpos"][:, 11].max() > 0.15  # m
