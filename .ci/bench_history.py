"""What has become slower: `python .ci/bench_history.py FILE.jsonl [--all]`.

Measures as `panda-cosim bench`, appends a line of JSON with the ratios to the file, plots it beside
it, and compares each ratio with the median of the last ten on this kind of machine: one that is
more than 5 % worse ends it with 3. `--all` measures sweeps, large systems and long runs, too
(growth.py): half an hour, and 10 GB of temporary files.
"""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any, Final

from matplotlib.figure import Figure
from rich.text import Text

from panda_cosim.cli.commands.bench import tables
from panda_cosim.cli.console import show, table
from panda_cosim.study.benchmark import MICRO, BenchResult, bench

GROWTH: Final = Path(__file__).with_name("growth.py")
FIGURES: Final = {  # what growth.py measures
    "sweep_rows_per_s": ("rows of random_box a second, 2 processes", "at least 13"),
    "sweep_row_by_ticks": ("processor time of a row by its ticks' mj_step", "less is better"),
    "set_up_2000_s": ("two FMUs of 2,000 variables: set-up", "at most 1.5 s"),
    "set_up_4000_by_2000": ("of 4,000, by that", "at most 2.2"),
    "peak_run_MB": ("run of an hour: peak", "at most 500 MB"),
    "peak_regress_MB": ("regress of an hour, also --update: peak", "at most 600 MB"),
    "peak_compare_MB": ("compare of two runs of an hour: peak", "at most 600 MB"),
    "long_run_growth_MB": ("memory that steps add, from ten minutes to an hour", "at most 4 MB"),
}
WORSE: Final = 3  # exit code
LAST: Final = 10  # earlier lines whose median counts
FEWEST: Final = 3  # fewer have no median
SLACK: Final = 1.05  # a ratio of the median from which a ratio is worse
HIGHER_IS_BETTER: Final = ("b/c",)
Line = dict[str, Any]


def main(path: Path, *, all_: bool) -> int:
    """Measure, append, plot and compare; return the exit code."""
    earlier = read(path)
    result = bench()
    figures: dict[str, float] = {}
    if all_:
        figures = runpy.run_path(str(GROWTH))["figures"](result.steps["physics"].median / MICRO)
    for item in tables(result):
        show(item)
    for name, value in figures.items():
        show(f"{FIGURES[name][0]}: {value:.4g} ({FIGURES[name][1]})")
    new = line_of(result, figures)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(new) + "\n")
    lines = [*alike(earlier, new), new]
    plot(lines, path.with_name(f"{path.name}.png"))
    return show_changes(lines)


def line_of(result: BenchResult, figures: Mapping[str, float]) -> Line:
    """Return the line of a run: where, when, and all ratios."""
    ratios = {name: ratio.median for name, ratio in result.ratios.items()}
    git = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False, cwd=GROWTH.parent)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit.stdout.strip(),
        "kind": "native",
        "machine": {key: result.machine[key] for key in ("processor", "cores", "system")},
        "ratios": ratios | {name: value for name, value in figures.items() if "_by_" in name},
    }


def read(path: Path) -> list[Line]:
    """Return the lines of a history; a file that is not there has none."""
    return (
        [json.loads(text) for text in path.read_text("utf-8").splitlines()] if path.exists() else []
    )


def alike(lines: Sequence[Line], new: Line) -> list[Line]:
    """Return the lines of the same kind and machine."""
    return [line for line in lines if all(line[key] == new[key] for key in ("kind", "machine"))]


def compared(lines: Sequence[Line]) -> dict[str, tuple[float, float | None, bool]]:
    """By ratio: the newest, the median of the last ones before it, and whether it is worse."""
    result = {}
    for name, now in lines[-1]["ratios"].items():
        last = [line["ratios"][name] for line in lines[:-1] if name in line["ratios"]][-LAST:]
        before = median(last) if len(last) >= FEWEST else None
        change = 1.0 if before is None else now / before
        result[name] = now, before, (1 / change if name in HIGHER_IS_BETTER else change) > SLACK
    return result


def show_changes(lines: Sequence[Line]) -> int:
    """Show the newest ratios beside those before; return the exit code."""
    columns = ("now", "median before")
    rows = [
        (name, f"{now:.2f}", f"{before:.2f}", Text("worse", "bold red") if worse else "ok")
        if before is not None
        else (name, f"{now:.2f}", "too few runs", "not compared")
        for name, (now, before, worse) in compared(lines).items()
    ]
    show(table(("ratio*", *columns, ""), rows, right=columns))
    return WORSE if any(worse for _, _, worse in compared(lines).values()) else 0


def plot(lines: Sequence[Line], path: Path) -> None:
    """Draw the ratios of all runs, oldest first."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for name in dict.fromkeys(name for line in lines for name in line["ratios"]):
        ratios = [line["ratios"].get(name, float("nan")) for line in lines]
        axes.plot(range(1, len(lines) + 1), ratios, marker="o", markersize=3, label=name)
    axes.set(xlabel="run on this machine", ylabel="ratio")
    axes.set_ylim(bottom=0.0)
    axes.locator_params(axis="x", integer=True)
    axes.legend()
    figure.savefig(path)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), all_="--all" in sys.argv[2:]))
