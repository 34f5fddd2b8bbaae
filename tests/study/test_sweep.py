"""Definitions of sweeps, and the values that they give."""

import re
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest, norm

from fault_support import write_files
from panda_cosim import Sweep
from panda_cosim.study.sweep.definition import (
    load_sweep,
    read_distribution,
    shipped_sweeps,
    sweep_of,
)
from panda_cosim.study.sweep.design import Design, keys_without_effect
from panda_cosim.study.sweep.packed import load_scenarios
from panda_cosim.study.sweep.sweeping import check_sweep
from refusals import refused
from sweep_support import MASS, short_scenario

PUSH = 'scenario = "push"\n'
DURATION = f'{PUSH}[vary."duration"]\n'


def made(**keys: Any) -> Sweep:
    vary = {MASS: {"uniform": [0.05, 0.5]}}
    return Sweep(**{"scenario": ("pick_and_place",), "vary": vary, "samples": 8, **keys})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("samples = 8", "key scenario is missing"),
        (f"{PUSH}sampels = 8", "'sampels' is unknown; .*did you mean 'samples'"),
        (f"{PUSH}samples = 8", "vary: sections required"),
        (f'{PUSH}design = "sobl"', "design: value 'sobl'; must be one of .*'sobol'"),
        (f'{PUSH}design = "list"', "file: required with"),
        (f"{PUSH}[vary.plant.block_mass]\nuniform = [0, 1]", "needs quotes"),
        (f"{DURATION}uniform = [1, 0]", "low below high"),
        (f"{DURATION}normal = [1, 0]", "deviation., that above 0"),
        (f"{DURATION}log-uniform = [0, 1]", "low above 0"),
        (f"{DURATION}values = []", "at least one value"),
        (f"{DURATION}limits = [0, 1]", "must have exactly one of"),
        ("scenario = ", "must be TOML"),
    ],
)
def test_what_is_wrong_in_a_definition_is_reported_in_one_line(text, message, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    told = refused(load_sweep, path)
    assert re.search(message, told)
    assert told.startswith(str(path))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"samples": 0}, "samples"),
        ({"design": "grid", "samples": 5}, "samples: required with search, random"),
        ({"min_success": 95}, "min_success: value 95; must be a number from 0 to 1"),
        ({"min_success": 0.9, "design": "search"}, "a search has no success rate"),
        ({"confidence": 0.9}, "confidence: needs min_success"),
        ({"min_success": 0.9, "confidence": 0.9, "design": "grid", "samples": 0}, "random rows"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(keys, message):
    assert message in refused(made, **keys)


@pytest.mark.parametrize(
    ("key", "low", "message"),
    [
        ("plant.block_mas", 0.1, "did you mean 'block_mass'"),
        ("plnt.block_mass", 0.1, "no instance 'plnt'"),
        (MASS, -1.0, "plant.block_mass: value -1.0; must be"),
        ("table.rows[99].x", 0.1, r"table.rows\[99\].x: there is no row 99; must be 1 to"),
        ("table.rows[1].u", 0.1, "key 'u' is unknown; valid: time, frame, position"),
        ("table.rows[1].grip", -3.0, r"table.rows\[1\].grip: .*value -3"),
        ("push[1].start", 0.1, "there is no push 1; the scenario has none"),
        ("durations", 0.1, "durations: no such key; valid: duration.*did you mean 'duration'"),
    ],
)
def test_keys_and_ends_are_checked_before_anything_runs(key, low, message):
    assert re.search(message, refused(check_sweep, made(vary={key: {"uniform": [low, 2.0]}})))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{MASS},{MASS}\n1,2\n", "line 1: column .* occurs 2 times"),
        (f"{MASS}\n", "has no rows"),
        (f"{MASS},duration\n\n0.1,1\n\n0.2\n", "line 5: 1 values; must be 2"),
    ],
)
def test_what_is_wrong_in_a_list_is_told_with_its_line(text, message, tmp_path):
    (tmp_path / "list.csv").write_text(text, encoding="utf-8")
    sweep = Sweep(scenario=("push",), design="list", file=tmp_path / "list.csv")  # type: ignore[arg-type]
    assert re.search(message, refused(Design, sweep))


@pytest.mark.parametrize("design", ["random", "latin-hypercube", "sobol"])
@pytest.mark.parametrize(
    ("given", "cumulative"),
    [
        ({"uniform": [1.0, 3.0]}, lambda x: (x - 1.0) / 2.0),
        ({"log-uniform": [1.0, 100.0]}, lambda x: np.log(x) / np.log(100.0)),
        ({"normal": [2.0, 0.5]}, lambda x: norm.cdf(x, 2.0, 0.5)),
    ],
)
def test_samples_have_their_distribution(design, given, cumulative):
    sweep = made(vary={"x": given, "y": {"uniform": [0, 1]}}, design=design, samples=512, seed=5)
    drawn = np.asarray(Design(sweep).columns["x"])
    assert kstest(cumulative(drawn), "uniform").pvalue > 0.01


def test_a_normal_distribution_is_cut_off_at_its_limits():
    cut = read_distribution({"normal": [0.0, 1.0], "limits": [-0.5, 2.0]})
    drawn = np.asarray(cut.quantiles(np.linspace(0.0, 1.0, 1001)))
    assert (drawn.min(), drawn.max()) == (-0.5, 2.0)
    middle = norm.ppf((norm.cdf(-0.5) + norm.cdf(2.0)) / 2)
    assert drawn[500] == pytest.approx(middle, abs=1e-12)


def test_a_grid_has_each_combination_once():
    sweep = sweep_of("push", ["plant.block_mass=0.05:2:4", "controller.kp=6,8", "align=true,false"])
    design = Design(sweep)
    rows = {tuple(design.values(i).items()) for i in range(len(design))}
    assert len(rows) == len(design) == 16
    assert design.values(0) == {MASS: 0.05, "controller.kp": 6.0, "align": True}
    assert max(design.columns[MASS]) == 2.0


def test_a_list_is_read_from_csv_beside_the_definition(tmp_path):
    (tmp_path / "rows.csv").write_text("plant.block_mass,scene\n0.1,tabletop\n0.2,tutorial\n")
    path = tmp_path / "sweep.toml"
    path.write_text('scenario = "push"\ndesign = "list"\nfile = "rows.csv"\n')
    design = Design(load_sweep(path))
    expected = {MASS: 0.1, "scene": "tabletop"}, {MASS: 0.2, "scene": "tutorial"}
    assert (design.values(0), design.values(1)) == expected


@pytest.mark.parametrize("design", ["random", "sobol"])
def test_more_samples_leave_the_first_as_they_are(design):
    few, many = (Design(made(design=design, samples=n, seed=9)) for n in (8, 32))
    assert [few.values(i) for i in range(8)] == [many.values(i) for i in range(8)]


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        (("controller.kp", "controller.kp[1]"), r"controller.kp and controller.kp\[1\]"),
        (("mismatch.joint_offset[3]", "mismatch.joint_offset"), "mismatch.joint_offset and"),
        (("table.rows[2].x", "table.rows[02].x"), r"rows\[2\].x and table.rows\[02\].x"),
    ],
)
def test_keys_that_set_the_same_value_are_refused_together(keys, named):
    told = refused(check_sweep, sweep_of("push", [f"{key}=0.001,0.002" for key in keys]))
    assert re.search(f"vary: .*{named}.* set the same value", told)


@pytest.mark.parametrize(
    ("vary", "idle"),
    [
        (["mismatch.seed=1,2", "controller.kp=6,7"], ["mismatch.seed"]),
        (["mismatch.seed=1,2", "mismatch.preset=nominal,worn"], []),
        (["table.rows[2].blend=0:0.1:3", "align=true,false"], ["align", "table.rows[2].blend"]),
        (["success.tracking_max=0.1,0.2", "push[1].start=0.5,0.6"], []),
        (["plant.block_mass=0.2,0.3", "table.rows[2].x=0.0,0.01"], []),
        (["coupling=jacobi,gauss-seidel"], []),
        (["preflight=fer,fr3"], []),
    ],
)
def test_keys_that_change_nothing_are_found(vary, idle):
    scenarios, design = check_sweep(sweep_of("push", vary))
    assert keys_without_effect(design, scenarios) == idle


@pytest.mark.parametrize("more", [{}, {"design": "random"}, {"design": "grid", "samples": 0}])
def test_the_order_of_keys_in_the_file_means_nothing(more):
    keys = ("mismatch.seed", MASS, "align", "duration")
    one, other = (
        Design(made(vary={key: {"uniform": [0.0, 1.0]} for key in order}, **more))
        for order in (keys, keys[::-1])
    )
    rows = range(len(one))
    assert [*map(one.values, rows)] == [*map(other.values, rows)]


def test_scenarios_of_one_name_are_told_apart_by_their_folders(tmp_path):
    ends = ("A/lift", "B/lift", "C/x/lift", "D/x/lift", "E/other")
    places = [short_scenario(tmp_path / end) for end in ends]
    loaded = load_scenarios(made(scenario=[str(folder) for folder in places]))
    assert [each.label for each in loaded] == ["A/lift", "B/lift", "C/x/lift", "D/x/lift", "other"]
    (tmp_path / "link").symlink_to(places[0])
    twice = made(scenario=[str(places[0]), str(tmp_path / "link")])
    assert f"{places[0]} is named twice" in refused(load_scenarios, twice)


@pytest.mark.parametrize("text", ["plant.block_mass", "plant.block_mass=1:2", "=1", "a=1:b:3"])
def test_a_vary_of_another_form_is_refused(text):
    assert "must be KEY=LOW:HIGH:STEPS" in refused(sweep_of, "push", [text])


def test_a_success_rate_without_criteria_is_refused(tmp_path):
    write_files(tmp_path / "bare", "duration = 0.1\n")
    bare = made(scenario=(str(tmp_path / "bare"),), min_success=0.9)
    assert "bare has no criteria, so it would always be met" in refused(check_sweep, bare)


def test_shipped_sweeps_can_be_run():
    assert "random_box" in shipped_sweeps()
    for name in shipped_sweeps():
        check_sweep(load_sweep(name))
