"""What a suite would notice: one parameter after another is changed by a step."""

import json
import subprocess
import sys

import pytest

from fault_support import write_scenario
from panda_cosim.run.start import start_values
from panda_cosim.study.compare.qualify import STEPS, Finding, changes_of, score
from panda_cosim.task.scenario import Scenario, load_scenario
from panda_cosim.task.tolerances import signal_of

SHARE = 0.05


def regress(folder, *arguments):
    command = [sys.executable, "-m", "panda_cosim", "regress", "--scenarios", folder, *arguments]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=500)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """A scenario of 30 ms with a reference."""
    folder = write_scenario(tmp_path_factory.mktemp("suite") / "short", 0.03)
    code, _, said = regress(folder, "--update", "--yes")
    assert code == 0, said
    return folder


@pytest.fixture(scope="module")
def told(suite, tmp_path_factory):
    """What the command says of it, and its file for CI."""
    report = tmp_path_factory.mktemp("report")
    words = ("--qualify", SHARE, "--min-score", 1.0, "--json", "--report", report)
    code, out, said = regress(suite, *map(str, words))
    assert code == 3, said
    return json.loads(out), (report / "junit.xml").read_text()


def test_every_number_that_a_scenario_takes_is_changed_once_and_by_the_step():
    scenario = load_scenario("pick_and_place")
    changes = {change.key: change for change in changes_of(scenario, SHARE)}
    given = {
        f"{instance}.{signal_of(name)}": values[name]
        for instance, values in start_values(scenario).items() for name in values
        if isinstance(values[name], int | float) and not isinstance(values[name], bool)
    }  # fmt: skip
    assert changes.keys() <= given.keys()
    zero = {key for key, value in given.items() if value == 0.0}
    assert given.keys() - changes.keys() <= zero | {"controller.period"}
    for key, change in changes.items():
        for before, now in zip(change.before, change.now, strict=True):
            if any(change.before):
                assert abs(now - before) == pytest.approx(SHARE * abs(before), rel=1e-9)
            else:
                assert now == STEPS[key]
        changed = start_values(change.applied(scenario))
        instance, name = key.split(".")
        values = [value for n, value in changed[instance].items() if signal_of(n) == name]
        assert values == pytest.approx(list(change.now))


def test_a_score_is_the_share_of_changes_with_an_effect_that_are_noticed():
    seen, blind = Finding("a", "", (("s", "x"),), ("t",)), Finding("b", "", (), ("s",))
    nothing = Finding("c", "", (), ())
    assert [each.state for each in (seen, blind, nothing)] == [
        "noticed",
        "not noticed",
        "no effect",
    ]
    assert score([seen, blind, nothing, nothing]) == 0.5
    assert score([nothing]) == 0.0  # nothing measured is never good


def test_the_states_are_those_of_runs_with_that_change_alone(suite, told, tmp_path):
    states = {each["key"]: each for each in told[0]["changes"]}
    scenario = Scenario.read(suite)
    for key in ("controller.servo_stiffness", "controller.observer_gain"):
        change = next(it for it in changes_of(scenario, SHARE) if it.key == key)
        value = ",".join(map(str, change.now))
        code, out, _ = regress(suite, "--set", f"{key}={value}", "--json")
        assert (code == 1) == (states[key]["state"] == "noticed")
        (found,) = json.loads(out)["scenarios"]
        if code == 1:
            assert states[key]["noticed"][0][1].startswith(found["first"]["name"])
        exact, *_ = regress(suite, "--set", f"{key}={value}", "--exact")
        assert (exact == 0) == (states[key]["state"] == "no effect")


def test_score_and_failures_are_those_of_the_table(told):
    said, xml = told
    states = [each["state"] for each in said["changes"]]
    assert xml.count("<testcase") == len(states)
    assert xml.count("<failure") == states.count("not noticed")
    judged = len(states) - states.count("no effect")
    assert said["score"] == pytest.approx(states.count("noticed") / judged)
    assert 0.0 < said["score"] < 1.0


def test_a_suite_that_does_not_pass_is_not_qualified(suite):
    code, out, said = regress(
        suite, "--qualify", "0.05", "--set", "controller.servo_stiffness=5000"
    )
    assert (code, out) == (2, "")
    assert "short: differs: must pass before it is qualified" in said


def test_a_suite_in_which_no_change_has_an_effect_is_not_green(tmp_path):
    (tmp_path / "fall").mkdir()
    (tmp_path / "fall" / "fall.xml").write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="ball"><freejoint/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "fall" / "scenario.toml").write_text(
        'purpose = "falls"\nduration = 0.02\nstep = 0.002\n[fmus]\nball = "fall.xml"\n'
    )
    assert regress(tmp_path, "--update", "--yes")[0] == 0
    code, out, said = regress(tmp_path, "--qualify", "0.05")
    assert (code, out) == (2, "")
    assert "has an effect" in said
