"""The nightly history of `bench`: what counts as worse, and its figures on small runs."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from panda_cosim.study.benchmark import BenchResult, Spread

CI = Path(__file__).parents[1] / ".ci"
HISTORY = runpy.run_path(str(CI / "bench_history.py"))
MACHINE = {"processor": "P", "cores": "2", "system": "S", "numpy": "2"}


def line(c_a: float, b_c: float = 8.0, **machine: str) -> dict[str, Any]:
    ratios = {"c/a": Spread(c_a, c_a, c_a), "b/c": Spread(b_c, b_c, b_c)}
    result = BenchResult("tutorial", {}, ratios, 1.0, {}, {**MACHINE, **machine})
    made: dict[str, Any] = HISTORY["line_of"](result, {"a_by_b": 2.0, "peak_MB": 1.0})
    return made


EARLIER = [line(c_a) for c_a in (9.9, 0.98, *[1.0] * 8, 1.02)]  # the first is too old to count


@pytest.mark.parametrize(
    ("c_a", "b_c", "worse"),
    [
        (1.04, 8.0, []),
        (1.06, 8.0, ["c/a"]),
        (0.50, 16.0, []),
        (1.00, 7.5, ["b/c"]),
        (2.00, 4.0, ["c/a", "b/c"]),
    ],
)
def test_a_ratio_is_worse_beyond_five_percent_of_the_median_of_the_last_ten(
    c_a, b_c, worse, capsys
):
    new = line(c_a, b_c, numpy="3")
    assert new["ratios"] == {"c/a": c_a, "b/c": b_c, "a_by_b": 2.0}
    lines = [*HISTORY["alike"]([*EARLIER, line(5.0, processor="Q")], new), new]
    assert len(lines) == 12, "those of the other machine do not count"
    assert [before for _, before, _ in HISTORY["compared"](lines).values()] == [1.0, 8.0, 2.0]
    assert HISTORY["show_changes"](lines) == (3 if worse else 0)
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows if row.strip().endswith("worse")] == worse


def test_too_few_runs_are_not_compared(capsys):
    assert HISTORY["show_changes"]([*EARLIER[-2:], line(9.0)]) == 0
    assert capsys.readouterr().out.count("not compared") == 3


def test_the_plot_shows_runs_without_some_of_the_ratios(tmp_path):
    HISTORY["plot"]([*EARLIER, {"ratios": {"c/a": 1.0}}], tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_each_figure_is_measured():
    measured = runpy.run_path(str(CI / "growth.py"))["figures"](2e-5, 60.0)
    assert measured.keys() == HISTORY["FIGURES"].keys()
    assert all(value > 0.0 for value in measured.values())
