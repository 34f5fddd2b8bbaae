"""Comparison with a reference recording: differences that matter are reported, others are not."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.study.compare.against_reference import Comparison, compare_with_reference
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.compare.tubes import tube, widths, widths_of_noise
from panda_cosim.study.compare.wording import multiple
from panda_cosim.task.tolerances import OURS, Tolerances, of_ours
from refusals import refused
from regress_support import METADATA, NO_SUCCESS, ROWS, SUMMARY, columns, record

DQ = OURS["controller"]["dq"]["rad"]  # rad, half-width of its tube
# As of our own FMUs, of which these runs have only some signals.
VALUES = {"controller.dq": DQ, "plant.qpos": 5e-6, "plant.contact_force": 1.0}
TOLERANCES = Tolerances(values=VALUES)


@pytest.fixture
def reference(tmp_path):
    """Return a reference that was written and read."""
    run = record(tmp_path / "before", columns())
    Reference.of(run, SUMMARY, TOLERANCES).write(tmp_path / "reference.parquet", run)
    return Reference.read(tmp_path / "reference.parquet")


@pytest.fixture
def compared(tmp_path, reference):
    """Return a function that records values and compares them with the reference."""

    def run(
        values: dict[str, Any], summary: Any = SUMMARY, tolerances: Tolerances = TOLERANCES,
        *, exact: bool = False, **options: Any,
    ) -> Comparison:  # fmt: skip
        recording = record(Path(mkdtemp(dir=tmp_path)), values, **options)
        return compare_with_reference(recording, summary, reference, tolerances, exact=exact)

    return run


def texts(comparison: Comparison) -> str:
    return "\n".join(comparison.problems)


def test_the_same_run_is_as_its_reference_bit_for_bit_whoever_ran_it(compared):
    who = {"fmus": {"plant": {"guid": "{2}"}}, "parameters": {}, "versions": {"numpy": "2"}}
    comparison = compared(columns(), exact=True, metadata=who)
    assert comparison.ok, texts(comparison)
    assert [d.share for d in comparison.deviations] == [0.0] * 5


@pytest.mark.parametrize(("share", "ok"), [(0.5, True), (0.9, True), (1.2, False), (40.0, False)])
def test_a_value_may_differ_by_its_tolerance(compared, share, ok):
    values = columns()
    values["controller.dq[1]"][224] += share * DQ  # where it moves least
    comparison = compared(values)
    assert comparison.ok is ok
    worst = comparison.worst
    assert worst.name == "controller.dq[1]"
    assert worst.share == pytest.approx(share, abs=0.06)  # the reference's rounding
    if not ok:
        assert worst.time == worst.first == pytest.approx(0.224)
        assert worst.outside == 1
        assert re.search(r"controller\.dq\[1\] off by .* at 0\.224 s", texts(comparison))


@pytest.mark.parametrize(("ticks", "ok"), [(1, True), (2, False)])
def test_an_event_may_move_by_the_tolerance_in_time(compared, ticks, ok):
    values = columns()
    values["plant.contact_force"] = np.roll(values["plant.contact_force"], ticks)
    values["plant.contact_force"][:ticks] = 0.0
    assert compared(values).ok is ok


@pytest.mark.parametrize(("before", "now", "steps", "ok"), [
    (0.2, 0.203, 3, True), (0.2, 0.197, 3, True), (0.2, 0.204, 3, False), (0.2, 0.196, 3, False),
    (None, None, 0, True), (0.2, 0.2, 0, True), (0.2, None, 10, False), (None, 0.2, 10, False),
])  # fmt: skip
def test_an_event_of_the_summary_may_move_by_so_many_steps(tmp_path, before, now, steps, ok):
    run = record(tmp_path / "run", columns())
    made, seen = (replace(SUMMARY, events={"grasp": at}) for at in (before, now))
    reference = Reference.of(run, made, TOLERANCES)
    tolerances = replace(TOLERANCES, events=steps)
    comparison = compare_with_reference(run, seen, reference, tolerances)
    assert comparison.ok is ok
    assert ok or f"may move by {steps} steps" in texts(comparison)


def test_a_reference_too_coarse_for_the_tolerances_must_be_recorded_again(compared):
    assert compared(columns(), tolerances=Tolerances(scale=0.5, values=VALUES)).ok
    finer = Tolerances(values={**VALUES, "plant.qpos[1]": 5e-8})
    assert "rounded to 5e-07 rad" in refused(compared, columns(), tolerances=finer)


def test_a_system_that_starts_later_matches_its_reference(tmp_path):
    later = columns()
    later["time"] = later["time"] + 2.5
    run = record(tmp_path / "run", later, metadata={"start_time": 2.5})
    Reference.of(run, SUMMARY, TOLERANCES).write(tmp_path / "reference.parquet", run)
    reference = Reference.read(tmp_path / "reference.parquet")
    comparison = compare_with_reference(run, SUMMARY, reference, TOLERANCES, exact=True)
    assert comparison.ok, texts(comparison)
    earlier = record(tmp_path / "earlier", columns())
    problems = compare_with_reference(earlier, SUMMARY, reference, TOLERANCES).problems
    assert "401 rows from 0 to 0.4 s, the reference 401 rows from 2.5 to 2.9 s" in problems[0]


def test_no_signal_is_no_match_and_no_reference_is_made_of_none_or_of_nan(tmp_path, compared):
    run = record(tmp_path / "now", {"time": columns()["time"]})
    problems = compared({"time": columns()["time"]}).problems
    assert problems == (
        "5 columns are missing: controller.dq, plant.contact_force, plant.jac, plant.qpos",
        "no signal was compared",
    )
    assert "the run records no signal" in refused(Reference.of, run, SUMMARY, TOLERANCES)
    nan = record(tmp_path / "nan", put("plant.jac[1,1]", 17, np.nan)(columns()))
    assert "not finite" in refused(Reference.of, nan, SUMMARY, TOLERANCES)


def test_what_is_just_outside_its_tube_is_not_called_one_tolerance():
    assert [multiple(share) for share in (0.5, 1.0, 1.0004, 1.04)] == ["0.5", "1", "1.0004", "1.04"]


Change = Callable[[dict[str, Any]], dict[str, Any]]


def put(name: str, rows: Any, value: float) -> Change:
    def change(values: dict[str, Any]) -> dict[str, Any]:
        values[name][rows] = value
        return values

    return change


def keep(rows: Any) -> Change:
    return lambda values: {name: signal[rows] for name, signal in values.items()}


def rename(old: str, new: str | None = None) -> Change:
    return lambda values: {(new or n) if n == old else n: v for n, v in values.items()
                           if new or n != old}  # fmt: skip


FAULTS = [
    (put("plant.jac[1,1]", 17, np.nan), "plant.jac[1,1] is nan at 0.017 s"),
    (put("controller.dq[1]", slice(17, 20), np.inf), "controller.dq[1] is inf at 0.017 s, "),
    (put("time", 100, 0.1004), "all instants must be the same"),
    (put("time", -1, 0.4 + 4e-9), "to 0.400000004 s, the reference 401 rows from 0 to 0.4 s"),
    (keep(slice(ROWS // 2)), "has 200 rows from 0 to 0.199 s, the reference 401 rows"),
    (keep(np.arange(ROWS) != 100), "has 400 rows from 0 to 0.4 s, the reference 401 rows"),
    (rename("plant.contact_force"), "1 columns are missing: plant.contact_force"),
    (rename("controller.dq[2]"), "1 columns are missing: controller.dq"),
    (rename("plant.jac[1,1]", "plant.temperature"), "1 columns are new: plant.temperature"),
]


@pytest.mark.parametrize(("fault", "expected"), FAULTS)
def test_a_fault_is_reported_in_one_line(compared, fault, expected):
    comparison = compared(fault(columns()))
    assert not comparison.ok
    assert expected in texts(comparison)
    assert all("\n" not in problem for problem in comparison.problems)


def test_what_has_another_unit_or_verdict_differs(compared):
    unit = compared(columns(), units={"plant.contact_force": "kN"})
    assert "plant.contact_force has the unit 'kN', the reference 'N'" in texts(unit)
    assert texts(compared(columns(), NO_SUCCESS)) == (
        "is not a success, the reference is a success (tracking_rms 300 mm, allowed 200 mm)"
    )


def test_one_bit_of_any_signal_is_noticed_where_it_is_asked_for(compared):
    values = columns()
    values["plant.jac[1,1]"][5] = np.nextafter(values["plant.jac[1,1]"][5], 2.0)
    assert texts(compared(values, exact=True)) == "bits differ: plant.jac"


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=40), st.integers(0, 5), st.floats(1e-6, 2.0)
)
def test_a_tube_holds_its_signal_moved_within_both_tolerances(values, ticks, tolerance):
    signal = np.array(values)
    lower, upper = tube(signal, tolerance, ticks)
    for shift in range(-ticks, ticks + 1):
        moved = signal[np.clip(np.arange(len(signal)) + shift, 0, len(signal) - 1)]
        assert (lower <= moved - 0.99 * tolerance).all()
        assert (moved + 0.99 * tolerance <= upper).all()
    assert (upper <= signal.max() + tolerance).all()


def test_a_reference_comes_back_as_it_was_and_is_small(tmp_path, reference):
    for name, tolerance in widths(reference, TOLERANCES).items():
        assert np.abs(reference[name] - columns()[name]).max() <= 0.051 * tolerance
    assert reference.metadata["parameters"] == METADATA["parameters"]
    assert reference.summary == SUMMARY
    assert (tmp_path / "reference.parquet").stat().st_size < 6000  # bytes


@pytest.mark.parametrize(
    ("section", "expected"),
    [({"time": -1}, "[regression] time: value -1; must be a number from 0 to 1 s"),
     ({"plant.contact_force": float("nan")}, "must be a number from 1e-15")],
)  # fmt: skip
def test_a_bad_section_is_refused_with_what_is_valid(section, expected):
    assert expected in refused(Tolerances.of, section)


def test_a_tolerance_is_of_a_number_that_is_recorded():
    names = ("time", "a.temperature", "a.q[1]", "a.q[2]")
    Tolerances(values={"a.temperature": 1.0, "a.q[2]": 1.0, "a.q": 1.0}).check_names(names)
    for name in ("a.temperatur", "a.q[3]", "time"):
        told = refused(Tolerances(values={name: 1.0}).check_names, names)
        assert "must be a number that is recorded: time, scale, events, a" in told


@pytest.mark.parametrize("name", ["plant", "arm.inner"])
def test_an_fmu_is_ours_by_its_signals_and_not_by_its_name(name, tmp_path):
    """All signals of PandaPlant in their units make a plant of ours; less do not."""
    units = {f"{name}.{signal}": next(iter(by_unit)) for signal, by_unit in OURS["plant"].items()}
    values = {"time": columns()["time"], **dict.fromkeys(units, 1e-3 * columns()["time"])}
    run = record(tmp_path / "ours", values, units)
    found = widths(run, Tolerances(scale=2.0, values={f"{name}.qvel": 3.0}))
    assert found.pop(f"{name}.qvel") == 3.0
    assert found == {n: 2.0 * OURS["plant"][n.removeprefix(f"{name}.")][units[n]] for n in found}
    other = record(tmp_path / "other", values, {**units, f"{name}.qpos": "K"})
    assert widths(other, Tolerances())[f"{name}.hand_xpos"] == pytest.approx(1e-5 * 4e-4)


@pytest.mark.parametrize(
    ("name", "tables"), [("controller", ("commands", "controller")), ("plant", ("plant",))]
)
def test_the_signals_of_our_own_fmus_are_those_of_their_interfaces(name, tables):
    units = {
        f"{name}.{scalar.name}": scalar.unit
        for scalar in INTERFACES[name].scalars()
        if scalar.variable.causality in ("input", "output")
    }
    assert of_ours(units).keys() == {f"{name}.{each}" for table in tables for each in OURS[table]}


def test_tubes_of_noise_are_ten_times_its_effect_and_a_hundredth_of_the_default_at_least(tmp_path):
    noisy = columns()
    noisy["controller.dq[1]"][300] += 1e-6
    run, other = record(tmp_path / "run", columns()), record(tmp_path / "noisy", noisy)
    found = widths_of_noise(run, other, Tolerances())
    assert found["plant.qpos[1]"] == 0.01 * widths(run, Tolerances())["plant.qpos[1]"]
    Reference.of(run, SUMMARY, Tolerances(), noise=found).write(tmp_path / "x", run)
    for stated, width in (({}, 1e-5), ({"controller.dq": 8e-6}, 8e-6)):
        judged = Reference.read(tmp_path / "x"), Tolerances(scale=10.0, values=stated)
        worst = compare_with_reference(other, SUMMARY, *judged).worst
        assert worst.tolerance == pytest.approx(width, rel=0.1)
    refused(widths_of_noise, run, run, Tolerances())
