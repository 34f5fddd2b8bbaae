"""The history of `bench`, and the figures of `bench --all` on small runs."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest
import typer
from panda_cosim import InputError
from panda_cosim.scenarios.benchmark import FIGURES, BenchResult, Spread, append, compared, read
from panda_cosim.scenarios.cli.commands.bench import GROWTH, WORSE, show_changes
from panda_cosim.scenarios.pictures.plot import plot_history

MACHINE = {"processor": "P", "cores": "2", "system": "S", "numpy": "2"}


def result(c_a: float, b_c: float = 8.0, **machine: str) -> BenchResult:
    ratios = {"c/a": Spread(c_a, c_a, c_a), "b/c": Spread(b_c, b_c, b_c)}
    return BenchResult("tutorial", {}, ratios, 1.0, {}, {}, {**MACHINE, **machine})


@pytest.fixture
def history(tmp_path: Path) -> Path:
    """A file with c/a of 9.9 and then ten runs about 1.0 on one machine, and one on another."""
    path = tmp_path / "bench.jsonl"
    for ratio in (9.9, 0.98, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.02):
        append(path, result(ratio), "native")
    append(path, result(5.0, processor="Q"), "native")
    return path


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
    history: Path, c_a: float, b_c: float, worse: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = append(history, result(c_a, b_c, numpy="3"), "native")
    assert len(lines) == 12, "those of the other machine do not count"
    assert [before for _, before, _ in compared(lines).values()] == [1.0, 8.0]
    if worse:
        with pytest.raises(typer.Exit) as ending:
            show_changes(lines)
        assert ending.value.exit_code == WORSE == 3
    else:
        show_changes(lines)
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows if row.strip().endswith("worse")] == worse
    saved = json.loads(history.read_text().splitlines()[-1])
    assert saved["ratios"] == {"c/a": c_a, "b/c": b_c}
    assert {"date", "commit", "machine"} <= saved.keys()


@pytest.mark.parametrize(("kind", "processor"), [("python", "P"), ("native", "R")])
def test_other_kinds_and_machines_are_nothing_to_compare_with(
    history: Path, kind: str, processor: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show_changes(append(history, result(9.0, processor=processor), kind))
    assert capsys.readouterr().out.count("too few runs") == 2


def test_another_file_is_refused_by_line(history: Path) -> None:
    with history.open("a") as file:
        file.write('{"ratios": {"c/a": "fast"}}\n')
    with pytest.raises(InputError, match=r"bench.jsonl: line 13: .*must be a line of"):
        read(history)


def test_the_plot_shows_runs_without_some_of_the_ratios(history: Path, tmp_path: Path) -> None:
    lines = [*append(history, result(1.0), "native"), {"ratios": {"set_up_4000_by_2000": 2.0}}]
    assert plot_history(lines, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.fmu
def test_each_figure_is_measured(tmp_path: Path) -> None:
    measured = runpy.run_path(str(GROWTH))["figures"](2e-5, 60.0)
    assert measured.keys() == FIGURES.keys()
    assert all(value > 0.0 for value in measured.values())
