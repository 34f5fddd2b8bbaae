"""Criteria over signals: what each reduction gives, its margin, and what is refused."""

import math
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panda_cosim import InputError, Recording, Scenario, SignalCriterion, Success, load_scenario
from panda_cosim.result.judging.criterion import Criterion, missed_text, smallest_margin, verdict_of
from panda_cosim.result.judging.signals import REDUCE, judge_signals
from panda_cosim.result.recording import Column, Recorder
from panda_cosim.run.start import check_criteria
from panda_cosim.run.system.assembly import assemble
from panda_cosim.task.criteria import REDUCTIONS
from panda_cosim.task.writer import write_scenario
from refusals import refused

TIME = np.arange(2001) * 1e-3  # s
UNITS = {"time": "s", "a[1]": "m", "a[2]": "m", "b[1]": "m", "b[2]": "m", "step": "m", "f": "N"}
ROUNDING = 1e-12  # m, N


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Signal a = (0.3, 0.4) m, b = 0; step: 0 to 1 m by way of 1.2 m; f: 30 N for 0.4 s."""
    step = np.where(TIME < 0.5, 0.0, np.where(TIME < 0.75, 1.2, 1.0))
    force = np.where((TIME >= 1.0) & (TIME < 1.4), 30.0, 0.0)
    zero = np.zeros_like(TIME)
    columns = (TIME, zero + 0.3, zero + 0.4, zero, zero, step, force)
    folder = tmp_path_factory.mktemp("run")
    with Recorder(folder, [Column(n, u) for n, u in UNITS.items()], {}) as out:
        out.append(np.column_stack(columns))
        out.close(complete=True)
    return Recording.open(folder)


HAPPENED: dict[str, float | None] = {"start": 0.0, "end": 2.0, "grasp": 1.0, "release": None}


def judged(recording: Recording, **keys: object) -> Criterion:
    (result,) = judge_signals([SignalCriterion(**keys)], recording, HAPPENED)  # type: ignore[arg-type]
    return result


@pytest.mark.parametrize(
    ("keys", "value", "unit"),
    [
        ({"signal": "f", "reduce": "max"}, 30.0, "N"),
        ({"signal": "f", "reduce": "max", "to": "grasp - 0.1"}, 0.0, "N"),
        ({"signal": "f", "reduce": "mean", "from_": 1.0, "to": 1.399}, 30.0, "N"),
        ({"signal": "f", "reduce": "rms", "from_": "grasp", "to": "grasp + 0.399"}, 30.0, "N"),
        ({"signal": "f", "reduce": "duration_above", "level": 15.0}, 0.4, "s"),
        ({"signal": "f", "reduce": "duration_below", "level": 15.0, "from_": 1.0}, 0.6, "s"),
        ({"signal": "step", "reduce": "settle", "band": 0.01}, 0.75, "s"),
        ({"signal": "step", "reduce": "settle", "band": 0.01, "from_": 0.5}, 0.25, "s"),
        ({"signal": "step", "reduce": "overshoot"}, 0.2, "m"),
        ({"signal": "step", "reduce": "overshoot", "target": 1.1}, 0.1, "m"),
        ({"signal": "step", "reduce": "overshoot", "target": 1.3}, 0.0, "m"),
        ({"signal": "step", "reduce": "overshoot", "target": 0.0}, 1.2, "m"),  # starts there
        ({"signal": "step", "reduce": "overshoot", "from_": 0.75}, 0.0, "m"),
        ({"signal": "f", "reduce": "overshoot"}, 30.0, "N"),  # starts and ends at 0
        ({"signal": "step", "reduce": "range"}, 1.2, "m"),
        ({"signal": "step", "reduce": "final"}, 1.0, "m"),
        ({"signal": ("norm", ("a",)), "reduce": "mean"}, 0.5, "m"),
        ({"signal": ("norm", ("a", "b")), "reduce": "max"}, 0.5, "m"),
        ({"signal": ("difference", ("b", "a")), "reduce": "peak"}, 0.4, "m"),
        ({"signal": ("difference", ("b[1]", "a[1]")), "reduce": "min"}, -0.3, "m"),
        ({"signal": "a", "reduce": "min"}, 0.4, "m"),  # against an upper bound the largest counts
        ({"signal": "a[1]", "reduce": "min"}, 0.3, "m"),
    ],
)
def test_a_reduction_gives_its_number(recording, keys, value, unit):
    result = judged(recording, **keys, below=100.0)
    assert result.value == pytest.approx(value, abs=1e-9)
    assert (result.unit, result.ok) == (unit, True)


NEVER = {"signal": "step", "reduce": "settle", "band": 0.1, "target": 3.0}


def test_what_does_not_settle_is_missed_by_at_least_the_rest_of_its_window(recording):
    result = judged(recording, **NEVER, below=0.5)
    assert result.word == "missed"
    assert result.value == pytest.approx(2.001, abs=1e-9)  # s: the row after the last


def test_every_reduction_is_there():
    assert tuple(REDUCE) == tuple(REDUCTIONS)
    page = Path(__file__).parents[2] / "docs" / "reference" / "scenario.md"
    reference = page.read_text(encoding="utf-8")
    for name, reduction in REDUCTIONS.items():
        assert f"| `{name}` | {reduction.text} |" in reference


def test_two_bounds_are_two_criteria(recording):
    both = SignalCriterion("f", "max", below=40.0, above=31.0, name="force")
    results = judge_signals([both], recording, HAPPENED)
    told = [(c.name, c.direction, c.ok, round(c.margin, 3)) for c in results]
    assert told == [("force below", "below", True, 0.25), ("force above", "above", False, -0.032)]
    assert judged(recording, signal="a", reduce="max", above=0.1).value == 0.3  # not the larger


@pytest.mark.parametrize(("keys", "word"), [
    ({"signal": "f", "reduce": "max", "from_": "release"}, "no release in this run"),
    ({"signal": "f", "reduce": "max", "from_": 5.0}, "no samples from 5 to 2 s"),
    (NEVER | {"from_": 1.5}, "does not settle within its window of 0.5 s"),
    (NEVER | {"from_": "end"}, "a window of one row"),
    ({"signal": "steps", "reduce": "max"}, "did you mean .step."),
])  # fmt: skip
def test_what_cannot_be_measured_neither_holds_nor_is_missed(recording, keys, word):
    result = judged(recording, **keys, below=1.0)
    assert (result.value, result.margin, result.word) == (None, None, "not measured")
    assert re.search(word, str(result.reason))
    assert str(result.reason) in missed_text([result])


SIZES = st.floats(-1e6, 1e6).map(lambda size: round(size, 3))


@given(value=st.floats(-1e6, 1e6), bound=st.floats(-1e6, 1e6), above=st.booleans())
def test_a_margin_is_at_least_zero_just_where_the_criterion_holds(value, bound, above):
    criterion = Criterion("x", value, bound, "m", "above" if above else "below")
    assert criterion.ok == (value >= bound if above else value <= bound)
    assert criterion.margin is not None
    assert (criterion.margin >= 0.0) == criterion.ok


@given(values=st.lists(SIZES, min_size=2, unique=True), bound=SIZES)
def test_a_worse_value_has_a_smaller_margin_however_bad_both_are(values, bound):
    margins = [Criterion("x", value, bound, "m").margin for value in sorted(values)]
    assert margins == sorted(margins, reverse=True)
    assert Criterion("x", 50.0, 1.0, "m").margin == -49.0
    assert Criterion("x", 0.25, 0.0, "m").margin == -0.25  # a bound of 0 leaves it in the unit


def test_a_value_that_is_not_finite_is_not_measured():
    for value in (math.nan, math.inf):
        result = Criterion("x", value, 1.0, "m", "above")
        assert (result.word, result.reason) == ("not measured", f"is {value}")
    assert smallest_margin([Criterion("x", 0.5, 1.0, "m", "below"), result]) is None


@given(st.lists(st.sampled_from([0.5, 2.0, None]), max_size=4))
def test_a_missed_criterion_is_a_verdict_and_then_one_that_was_not_measured_is_none(values):
    criteria = [Criterion("x", value, 1.0, "m", "below") for value in values]
    expected = "missed" if 2.0 in values else "not measured" if None in values else "ok"
    assert verdict_of(criteria) == expected
    known = [] if expected == "not measured" else [1.0 - value for value in values if value]
    assert smallest_margin(criteria) == min(known, default=None)


SIGNAL = """
[[success.signal]]
signal = "plant.contact_force"
reduce = "max"
below = 60.0
"""
S, R, B = 'signal = "plant.contact_force"', 'reduce = "max"', "below = 60.0"
WRONG = [
    (S, 'signal = "plant.contact_forse"', "did you mean 'plant.contact_force'?"),
    (S, "signal = 3", "signal: value 3; must be a signal's name"),
    (S, "signal = { nrm = [] }", "did you mean 'norm'?"),
    (S, 'signal = { difference = ["a"] }', "a list of 2 signals"),
    (S, 'signal = { norm = ["plant.hand_xpos", "plant.qpos"] }', "plant.qpos has 16 elements"),
    (S, 'signal = { norm = ["plant.qpos"] }', "must have the same unit"),
    (S, 'signal = { difference = ["a", "a"] }', "no two alike"),
    (R, 'reduce = "maxx"', "did you mean 'max'?"),
    (R, 'reduce = "settle"', "band: is missing"),
    (R, 'reduce = "settle"\nband = 0.0', "band: value 0.0; must be a number from 1e-12"),
    (B, "bellow = 60.0", "did you mean 'below'?"),
    (B, "", "below and above: both are missing"),
    (B, B + '\nfrom = "releas"', "from: value 'releas'"),
    (B, B + '\nfrom = "release * 2"', "from: value 'release * 2'"),
    (B, B + "\nlevel = 2.0", "level: only valid with reduce = 'duration_above'"),
    (B, B + "\n" + SIGNAL, "is taken"),
    (B, B + '\nname = "max_tilt"', "name 'max_tilt' is taken"),
    (B, B + f'\nabove = 1.0\nname = "f"\n{SIGNAL}name = "f below"', "name 'f below' is taken"),
    (B, B + "\nto = 3000", "to: value 3000.0; must be within the run, from"),
    (B, B + '\nfrom = "end"\nto = 1.0', "to: value 1.0 is before from, 'end'"),
    (B, B + "\nabove = 61.0", "so that it can never hold; must be at most be"),
    (f"{R}\n{B}", 'reduce = "peak"\nbelow = -1.0', "is never negative, so that it can never hold"),
    (f"{R}\n{B}", 'reduce = "rms"\nabove = 0.0', "is never negative, so that it can never fail"),
    (
        f"{R}\n{B}",
        'reduce = "duration_above"\nlevel = 1.0\nabove = 0.6\nfrom = 2.0',
        "the window lasts 0.5 s at most, so that it can never hold",
    ),
]


def written(folder: Path, section: str) -> Path:
    """A copy of the scenario `push` with more keys."""
    write_scenario(load_scenario("push"), folder)
    path = folder / "scenario.toml"
    path.write_text(f"{path.read_text(encoding='utf-8')}\n{section}", encoding="utf-8")
    return folder


@given(data=st.data())
def test_any_criterion_that_is_accepted_can_hold_and_can_fail(data):
    """Among signals that move or stay there is one that meets it, and one that misses it."""
    numbers = [-1.0, 0.0, 0.25, 1.0, 2.0, 3.0]
    reduce = data.draw(st.sampled_from(list(REDUCTIONS)))
    signal = data.draw(st.sampled_from(["x", ("norm", ("x",))]))
    parameter = st.sampled_from(numbers if signal == "x" else numbers[2:])  # a length is positive
    keys = {key: data.draw(parameter) for key in REDUCTIONS[reduce].takes}
    keys[data.draw(st.sampled_from(["below", "above"]))] = data.draw(st.sampled_from(numbers))
    try:
        criterion = SignalCriterion(signal, reduce, **keys)  # type: ignore[arg-type]
        criterion.check_window(0.0, 2.0)
    except (InputError, ValueError):
        return
    direction = "below" if criterion.above is None else "above"
    time = np.arange(17) * 0.125  # s
    sizes = (-9.0, -1.0, 0.0, 0.1, 0.25, 1.0, 2.0, 3.0, 9.0)
    outcomes = set()
    for before, after, row in product(sizes, sizes, (0, 1, 8, 16)):
        values = np.where(np.arange(17) < row, before, after)
        values = values if signal == "x" else np.abs(values)
        value = REDUCE[reduce](time, values, criterion)
        bound = getattr(criterion, direction)
        outcomes.add(Criterion("x", value, bound, "m", direction).ok)  # type: ignore[arg-type]
    assert outcomes == {True, False}


@pytest.mark.parametrize(("right", "wrong", "told"), WRONG)
def test_bad_input_is_reported_in_one_line(tmp_path, right, wrong, told):
    def read() -> None:
        scenario = Scenario.read(written(tmp_path, SIGNAL.replace(right, wrong)))
        check_criteria(scenario, assemble(scenario))

    said = refused(read)
    assert told in said
    assert "[success" in said


def test_a_written_scenario_reads_back_the_same(tmp_path):
    criteria = (
        SignalCriterion("plant.contact_force", "max", "grasp + 0.5", 2.0, below=60.0),
        SignalCriterion(("norm", ("plant.hand_xpos", "controller.pos_cmd")), "settle", band=1e-3,
                        target=0.0, below=0.2, name='a "quoted" name'),
    )  # fmt: skip
    scenario = replace(
        load_scenario("push"),
        success=Success(max_tilt=1.0, signal=criteria),
        expect="failure",
        expect_reason="is pushed too hard",
    )
    write_scenario(scenario, tmp_path / "push")
    assert replace(Scenario.read(tmp_path / "push"), folder=scenario.folder) == scenario
