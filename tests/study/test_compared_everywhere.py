"""Every door compares every signal, of any FMU, name and type."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forked import QUIET, command
from odd_fmu import odd_fmu
from panda_cosim import compare
from panda_cosim.result.recording import Column, Recorder, Recording
from panda_cosim.study.compare.against_reference import Comparison, compare_with_reference
from panda_cosim.study.compare.reference import Reference
from panda_cosim.task.tolerances import Tolerances
from regress_support import METADATA, SUMMARY

DEFAULT = Tolerances()
VALUES = {
    "double": st.floats(-1e9, 1e9),
    "float": st.floats(-1e9, 1e9, width=32),
    "int8": st.integers(-(2**7), 2**7 - 1),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "bool": st.booleans(),
    "string": st.text(max_size=5),
    "binary": st.binary(max_size=5),
}
NAMES = st.tuples(
    st.sampled_from(["plant", "controller", "sensors", "heater"]),
    st.sampled_from(["temperature", "qpos", "dq", "jac[1,1]"]),
).map(".".join)
HALF = 8  # rows of each value


def record(
    folder: Path, name: str, kind: str, values: list[Any], step: float = 0.001, nominal: Any = None
) -> Recording:
    columns = [Column("time", "s"), Column(name, "", "", kind, nominal)]
    recorder = Recorder(folder, columns, {**METADATA, "step_size": step})
    time = step * np.arange(len(values))
    rows = np.empty((len(values), 2), float if kind == "double" else object)
    rows[:, 0], rows[:, 1] = time, values
    recorder.append(rows)
    recorder.close(complete=True, reason=None)
    return Recording.open(folder)


def against(folder: Path, before: Recording, now: Recording, *, exact: bool = False) -> Comparison:
    """Compare a run with the reference made of another, which is written and read."""
    Reference.of(before, SUMMARY, DEFAULT).write(folder / "reference.parquet", before)
    reference = Reference.read(folder / "reference.parquet")
    return compare_with_reference(now, SUMMARY, reference, DEFAULT, exact=exact)


@settings(max_examples=60, deadline=None)
@given(NAMES, st.sampled_from(list(VALUES)), st.data())
def test_each_door_notices_a_change_and_only_a_change(tmp_path_factory, column, kind, data):
    first, second = data.draw(st.tuples(VALUES[kind], VALUES[kind]))
    differ = first != second
    if kind in ("double", "float"):  # a Real may differ by its tolerance
        differ = abs(first - second) > 1e-8 * max(abs(first), abs(second), 1e-3)
    folder = tmp_path_factory.mktemp("runs")
    values = [first] * HALF + [second] * HALF
    before = record(folder / "before", column, kind, values)
    again = record(folder / "again", column, kind, values)
    changed = record(folder / "changed", column, kind, [*values[:-1], first])
    same = against(folder, before, again, exact=True)
    assert same.ok, same.problems
    assert same.compared == 1
    assert before.sha256() == again.sha256()
    assert compare(folder / "before", folder / "again").identical
    if differ:
        off = against(folder, before, changed)
        assert not off.ok
        assert column in off.problems[0]
        problems = against(folder, before, changed, exact=True).problems
        assert problems[-1] == f"bits differ: {column.partition('[')[0]}"
        assert before.sha256() != changed.sha256()
        for pair in (("before", "changed"), ("changed", "before")):
            (row,) = compare(*(folder / each for each in pair)).signals
            assert row.name == column


@pytest.mark.parametrize("other", [-1.0, 0.0, 0.9])
def test_a_tube_is_a_step_wide_however_short_the_step(tmp_path, other):
    wave = np.sin(2 * np.pi * 1000 * 1e-5 * np.arange(500))
    before = record(tmp_path / "a", "t.y", "double", list(wave), 1e-5)
    now = record(tmp_path / "b", "t.y", "double", list(other * wave), 1e-5)
    comparison = against(tmp_path, before, now)
    assert not comparison.ok
    assert comparison.constant_fits == []
    late = record(tmp_path / "c", "t.y", "double", [0.0, *wave[:-1]], 1e-5)
    assert against(tmp_path, before, late).ok


@pytest.mark.parametrize(("kind", "pair"), [("double", (1.0, -1.0)), ("string", ("a", "b"))])
def test_a_tube_in_which_a_constant_stays_is_said(tmp_path, kind, pair):
    run = record(tmp_path / "a", "t.y", kind, list(pair) * 20)
    comparison = against(tmp_path, run, run)
    assert comparison.ok
    assert comparison.constant_fits == ["t.y"]
    assert comparison.count == "1 columns, 1 loose"
    assert "(as a constant would match: t.y)" in comparison.scope


@pytest.mark.parametrize(
    ("values", "nominal", "tolerance"),
    [([293.0, 303.0], None, 1e-4), ([293.0, 293.0], None, 2.93e-7), ([1e5, 1e5], None, 1e-4),
     ([0.0, 0.0], None, 1e-12), ([0.0, 0.0], 1e5, 1e-4), ([0.0, 1e-6], None, 1e-11)],
)  # fmt: skip
def test_a_default_tolerance_is_of_the_signals_own_size(tmp_path, values, nominal, tolerance):
    run = record(tmp_path / "a", "plant.T", "double", values * 5, nominal=nominal)
    (deviation,) = against(tmp_path, run, run).deviations
    assert deviation.tolerance == pytest.approx(tolerance, rel=1e-5)


def test_a_reference_of_another_type_or_without_texts_is_no_match(tmp_path):
    number = record(tmp_path / "a", "t.y", "double", [1.0, 2.0])
    text = record(tmp_path / "b", "t.y", "string", ["1.0", "2.0"])
    comparison = against(tmp_path, number, text)
    assert comparison.compared == 0
    assert "t.y has the type 'string', the reference 'double'" in comparison.problems
    assert compare(tmp_path / "a", tmp_path / "a").identical


@pytest.mark.parametrize("kind", ["bool", "int32"])
def test_what_is_no_real_is_held_between_steps_in_both_directions(tmp_path, kind):
    record(tmp_path / "fine", "t.n", kind, [0, 0, 0, 1, 1, 1, 1], 0.001)
    record(tmp_path / "coarse", "t.n", kind, [0, 0, 1, 1], 0.002)
    pairs = (("fine", "coarse"), ("coarse", "fine"))
    rows = [compare(*(tmp_path / each for each in pair)).signals[0] for pair in pairs]
    assert {(row.largest, row.times, row.share) for row in rows} == {((1.0,), (0.003,), 1.0)}


def test_check_names_an_event_for_which_nothing_is_recorded(tmp_path):
    odd_fmu(tmp_path / "own.fmu", [("y", "Real", "output", 100)])
    text = '[fmus]\nt = "own.fmu"\n[[success.signal]]\nsignal = "t.y"\nreduce = "max"\nbelow = 9\n'
    for window, code in (('to = "end - 0.01"', 0), ('from = "grasp"', 2), ('to = "at_rest"', 2)):
        (tmp_path / "scenario.toml").write_text(f"duration = 0.02\n{text}{window}\n")
        done = command("check", tmp_path, code=code)
        assert ("never happens: plant." in done.stdout) == (code == 2)


def test_a_run_says_that_a_push_comes_too_late(tmp_path):
    assert command("new", tmp_path / "late", "--from", "push").returncode == 0
    path = tmp_path / "late" / "scenario.toml"
    path.write_text(path.read_text().replace("start = 1.6", "start = 9.6"))
    done = command("run", path.parent, *QUIET, "--out", tmp_path / "run")
    assert "[[push]] at 9.6 s begins after the end" in done.stderr


@pytest.mark.parametrize(
    ("name", "kind", "values"),
    [("plant", "Real", (293.0, 294.0)), ("controller", "Integer", (3, 4)),
     ("sensors", "Boolean", ("false", "true"))],
)  # fmt: skip
def test_an_fmu_of_ones_own_is_compared_whatever_its_name(tmp_path, name, kind, values):
    folder = tmp_path / "suite" / "mine"
    folder.mkdir(parents=True)
    odd_fmu(folder / "own.fmu", [("u", kind, "input", 0), ("y", kind, "output", 100)])
    settings = f'duration = 0.02\n[fmus]\n{name} = "own.fmu"\n[regression]\n'
    regress = ("regress", "--scenarios", tmp_path / "suite")
    for value, tolerance, option, code in (
        (values[0], 0.1, ("--update", "--yes"), 0), (values[0], 0.1, ("--exact",), 0),
        (values[1], 0.1, (), 1), (values[1], 2.0, (), 0),
    ):  # fmt: skip
        own = "".join(f'"{name}.{each}" = {tolerance}\n' for each in "uy")
        (folder / "scenario.toml").write_text(f'{settings}{own}[inputs]\n"{name}.u" = {value}\n')
        command(*regress, *option, code=code)
    (folder / "scenario.toml").write_text(f'{settings}"{name}.z" = 1.0\n')
    told = command(*regress).stderr, command("check", folder).stdout
    assert all(f"value '{name}.z'; must be a number that is recorded" in text for text in told)
