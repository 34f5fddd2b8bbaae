"""Runs compared with each other, in numbers that are known; and how notebooks read results."""

import html
import json
import math
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forked import command
from panda_cosim import Recording, compare
from panda_cosim.result.judging.criterion import Criterion
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.finished import Run
from panda_cosim.study.compare.wording import numbers
from refusals import refused
from regress_support import CONTENT, columns, record

DISTANCE = 2e-3  # rad
EVIL = "<script>alert(1)</script>"


def made(folder: Path, offset: float = 0.0, *, mass: float = 0.18, rows: int = 401) -> Path:
    values = columns(rows)
    values["plant.qpos[1]"] = values["plant.qpos[1]"] + offset * (values["time"] >= 0.2)
    record(folder, values, metadata={"parameters": {"plant": {"block_mass": mass}}})
    rms = 100.0 + 1e3 * offset
    summary = {**CONTENT, "tracking": {"rms_mm": rms, "max_mm": 150.0}}
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_a_run_is_the_same_as_itself(tmp_path):
    result = compare(made(tmp_path / "a"), made(tmp_path / "b"))
    assert result.identical
    assert (result.parameters, result.metrics, result.signals, result.missing) == ((), (), (), ())
    assert result.names == ("a", "b")
    assert '<header class="good">' in result.to_html()
    assert "All recorded signals are equal. Compared: 5 columns, 401 rows" in result.to_html()


def test_curves_of_runs_of_other_lengths_and_steps_are_all_there(tmp_path):
    """Each keeps its own span; where one has no value, the figure has none either."""
    a, values = made(tmp_path / "a", DISTANCE), columns(501)
    record(tmp_path / "b", {name: signal[100::2] for name, signal in values.items()})
    page = compare(a, tmp_path / "b").to_html()
    figure = page.partition("<b>plant.qpos[1]</b>")[2]
    curve = json.loads(html.unescape(figure.partition('data-curve="')[2].partition('"')[0]))
    steps, counts = np.transpose(curve["time"])
    time = np.cumsum(np.repeat(steps, counts)) / 1e6
    baseline, stored = (
        np.frombuffer(b64decode(text), "<f4") for text in (curve["baseline"], *curve["runs"])
    )
    assert curve["names"] == ["a", "b"]
    assert (time[0], time[-1]) == (0.0, 0.5)
    assert np.array_equal(np.isfinite(baseline), time <= 0.4)
    assert np.array_equal(np.isfinite(stored), time >= 0.1)
    run = np.where(np.isfinite(baseline), baseline, 0.0) + stored
    assert run[time >= 0.1] == pytest.approx(np.sin(3 * time[time >= 0.1]), abs=1e-5)  # rad


def test_what_differs_from_the_first_run_is_found_with_its_size_and_time(tmp_path):
    result = compare(made(tmp_path / "a"), made(tmp_path / "b", DISTANCE, mass=0.2))
    (mass,), (metric,) = result.parameters, result.metrics
    assert (mass.name, mass.values) == ("plant.block_mass", (0.18, 0.2))
    assert (metric.name, metric.values) == ("tracking.rms_mm", (100.0, 102.0))
    (signal,) = result.signals
    assert (signal.name, signal.unit, signal.times) == ("plant.qpos[1]", "rad", (0.2,))
    assert signal.largest == pytest.approx((DISTANCE,), abs=1e-12)
    assert signal.rms == pytest.approx((DISTANCE * math.sqrt(201 / 401),), abs=1e-12)
    (criterion,) = result.criteria
    assert isinstance(criterion.values[0], Criterion)
    json.dumps(result.to_dict(), allow_nan=False)
    (signal,) = compare(tmp_path / "a", made(tmp_path / "c", 1e-3), tmp_path / "b").signals
    assert signal.largest == pytest.approx((1e-3, DISTANCE), abs=1e-12)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 400), st.booleans())
def test_a_run_and_its_beginning_are_compared_and_not_identical(tmp_path_factory, rows, killed):
    folder = tmp_path_factory.mktemp("runs")
    whole = made(folder / "whole")
    record(folder / "cut", columns(rows), reason="stopped by SIGKILL" if killed else None)
    for runs in ((whole, folder / "cut"), (folder / "cut", whole)):
        result = compare(*runs)
        assert (result.signals, result.rows, result.begin) == ((), rows, 0.0)
        assert result.end == pytest.approx((rows - 1) * 1e-3, abs=1e-9)
        assert not result.identical
        assert result.to_dict()["identical"] is False
        assert result.unmet is killed


def test_runs_with_nothing_in_common_are_refused(tmp_path):
    a = made(tmp_path / "a")
    later, others = columns(), columns()
    later["time"] = later["time"] + 1.0
    values = {"time": others["time"], "plant.other": others["time"]}
    none = {name: signal[:0] for name, signal in others.items()}
    for name, signals, told in (
        ("b", later, "no span of time in common"),
        ("c", values, "no signal in common"),
        ("d", none, "a, d: nothing to compare: one of them has no rows"),
    ):
        record(tmp_path / name, signals)
        assert told in refused(compare, a, tmp_path / name)


def test_columns_that_cannot_be_compared_are_named(tmp_path):
    values = columns()
    values["controller.dq[1]"] = values["controller.dq[1]"] + 1.0
    values[f"plant.{EVIL}"] = values.pop("plant.jac[1,1]")
    values["controller.dq[2]"][100] = np.nan
    record(tmp_path / "b", values, units={"controller.dq[1]": "N.m"})
    result = compare(made(tmp_path / "a"), tmp_path / "b")
    assert result.other_units == ("controller.dq[1]",)
    assert result.missing == ("plant.jac[1,1]", f"plant.{EVIL}")
    (row,) = result.signals
    assert (row.name, row.share) == ("controller.dq[2]", math.inf)
    assert row.texts[0].startswith("nan instead of 7.6")
    assert not result.identical
    assert "1 columns in other units or types, not compared" in result.to_html()
    assert EVIL not in result.to_html()


def test_noise_is_ranked_below_what_differs(tmp_path):
    """An element that stays at 0 is noise; 50 mm are all of the way that another one moves."""
    values = columns()
    signs = np.where(np.arange(401) % 2, 1.0, -1.0)
    names = [f"plant.hand_xpos[{i}]" for i in (1, 2, 3)]
    units = dict.fromkeys(names, "m")
    for name, noise, way in (("a", 6e-16, 0.0), ("b", -9e-16, 0.05)):
        moves = np.where(values["time"] > 0.1, way, 0.0)
        signals = (0.6 * values["time"] / 0.4, noise * signs, 0.3 + moves)
        record(tmp_path / name, {**values, **dict(zip(names, signals, strict=True))}, units)
        metrics = {"tracking": {"rms_mm": way}, "block": {"slip_mm": noise}}
        (tmp_path / name / "summary.json").write_text(json.dumps({**CONTENT, **metrics}))
    result = compare(tmp_path / "a", tmp_path / "b")
    assert [row.name for row in result.metrics] == ["tracking.rms_mm", "block.slip_mm"]
    real, small = result.signals
    assert (real.name, small.name) == ("plant.hand_xpos[3]", "plant.hand_xpos[2]")
    assert real.largest == pytest.approx((0.05,), abs=1e-12)  # m
    assert real.share == pytest.approx(1.0)
    assert small.share < 1e-9


@given(st.lists(st.floats(allow_nan=False), min_size=2, max_size=4))
def test_numbers_that_differ_look_different(values):
    assert len(set(numbers(values))) >= len(set(values))


def test_the_command_prints_tables_json_and_a_page(tmp_path):
    a, b = made(tmp_path / "a"), made(tmp_path / "b", DISTANCE, mass=0.2)
    brief = command("compare", a, b, "--out", tmp_path / "page", code=0)
    for text in ("plant.block_mass", "tracking.rms_mm", "0.002 rad at 0.200 s", "compare.html"):
        assert text in brief.stdout
    assert "data-curve=" in (tmp_path / "page" / "compare.html").read_text(encoding="utf-8")
    told = command("compare", a, b, "--json")
    assert json.loads(told.stdout)["runs"] == ["a", "b"]
    alone = command("compare", a, code=2)
    assert "must be at least two" in alone.stderr


def test_a_notebook_has_the_pictures_of_a_run_and_its_recording_as_a_table_of_pandas(tmp_path):
    (tmp_path / "contact_sheet.png").touch()
    assert "data:image/png;base64," in Run(tmp_path, Summary())._repr_html_()
    pytest.importorskip("pandas")
    recording = Recording.open(made(tmp_path / "a"))
    frame = recording.to_pandas()
    assert frame.index.name == "time"
    assert list(frame.columns) == [name for name in recording.columns if name != "time"]
    assert np.array_equal(frame["plant.qpos[1]"].to_numpy(), recording["plant.qpos[1]"])
    assert frame.attrs["units"]["plant.contact_force"] == "N"
    names = ["controller.dq[1]", "controller.dq[2]"]
    assert list(recording.to_pandas(["controller.dq"]).columns) == names
    assert "did you mean" in refused(recording.to_pandas, ["controller.dp"])
