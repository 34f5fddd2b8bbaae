"""What a suite would notice: one parameter after another is changed by a step."""

import json
from pathlib import Path

import pytest

from forked import command
from odd_fmu import odd_fmu
from panda_cosim.run.start import start_values
from panda_cosim.study.compare.qualify import STEPS, changes_of
from panda_cosim.task.scenario import load_scenario
from panda_cosim.task.tolerances import signal_of

SHARE = 0.05
# The output y follows the first, and z, in a wide tube, the second.
VALUES = {"seen": 1.0, "wide": 2.0, "idle": 3.0}


def suite(folder: Path, *names: str) -> tuple[object, ...]:
    """Write a scenario of an FMU with parameters, and its reference; return the command."""
    place = folder / "short"
    place.mkdir()
    outputs = [(name, "Real", "output", at) for name, at in (("y", 100), ("z", 101))]
    parameters = [(name, "Real", "parameter", list(VALUES).index(name)) for name in names]
    odd_fmu(place / "own.fmu", [*parameters, *outputs])
    given = "".join(f"{name} = {VALUES[name]}\n" for name in names)
    (place / "scenario.toml").write_text(
        f'duration = 0.02\n[fmus]\nown = "own.fmu"\n[regression]\n"own.z" = 1.0\n'
        f"[parameters.own]\n{given}"
    )
    words = ("regress", "--scenarios", folder)
    command(*words, "--update", "--yes", code=0)
    return words


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


def test_the_command_tells_what_each_change_does_and_fails_below_a_score(tmp_path):
    words = suite(tmp_path, *VALUES)
    qualify = (*words, "--qualify", SHARE, "--min-score")
    told = command(*qualify, 0.51, "--json", "--report", tmp_path / "report", code=3)
    found = json.loads(told.stdout)
    assert [(each["change"], each["state"]) for each in found["changes"]] == [
        ("1 -> 1.05", "noticed"), ("2 -> 2.1", "not noticed"), ("3 -> 3.15", "no effect")
    ]  # fmt: skip
    assert found["changes"][0]["noticed"][0][1].startswith("own.y at ")
    assert found["score"] == 0.5
    page, xml = ((tmp_path / "report" / name).read_text() for name in ("report.html", "junit.xml"))
    assert "own.wide 2 -&gt; 2.1</code></td><td class=num>not noticed</td>" in page
    assert (xml.count("<testcase"), xml.count("<failure")) == (3, 1)
    assert "50% of the changes that have an effect are noticed" in command(*qualify, 0.5).stdout
    red = command(*words, "--qualify", SHARE, "--set", "own.seen=2", code=2)
    assert "short: differs: must pass before it is qualified" in red.stderr


def test_a_suite_in_which_no_change_has_an_effect_is_not_green(tmp_path):
    done = command(*suite(tmp_path, "idle"), "--qualify", SHARE, code=2)
    assert "has an effect" in done.stderr
