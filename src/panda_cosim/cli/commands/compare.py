"""`panda-cosim compare`."""

from __future__ import annotations

from pathlib import Path

from ...fmus.atomic import check_replaceable, write_whole
from ...fmus.errors import InputError
from ...study.compare.between_runs import RunComparison, compare
from ...study.compare.wording import signal_names
from ..console import as_cell, show, show_json, table
from ..forms import argument, option
from ..options import JSON, MAP, OVERWRITE

SHOWN = 8  # rows of a table
PAGE = "compare.html"


def command(
    runs: list[Path] = argument("RUN RUN|LOG..."),
    names: Path | None = MAP,
    out: Path | None = option("--out -o DIR"),
    json: bool = JSON,
    overwrite: bool = OVERWRITE,
) -> None:
    """Compare runs: parameters, verdicts, metrics and signals.

    Shows how the parameters, verdicts and signals of each run differ from the first run's. Signals
    are ranked by the largest deviation as a multiple of the default tolerance of `regress`; it is
    also shown as a share of the element's range. The page overlays the curves of all runs. Runs of
    different lengths are compared where they overlap, and are never identical. Exit code 2: the
    runs have nothing in common.

    A log of a robot or another program is compared as a run, where it has the names of its columns
    and its seconds; `--map` says what other names and times are.

    ```
    panda-cosim run push --out runs/a
    panda-cosim run push --set controller.kp=6 --out runs/b
    panda-cosim compare runs/a runs/b --out report
    panda-cosim compare runs/a robot.mcap --map names.toml
    ```

    Args:
        runs: Folders of runs, or logs (.csv, .parquet, .mcap); compared with the first, a run.
        out: Write compare.html there, with all details.
    """
    if len(runs) < 2:
        raise InputError("RUN: only one; must be at least two runs")
    comparison = compare(runs[0], *runs[1:], names=names)
    if out is not None:
        check_replaceable(out / PAGE, overwrite=overwrite)
        write_whole(out / PAGE, comparison.to_html())
    if json:
        show_json(comparison.to_dict())
        return
    _show(comparison)
    if out is not None:
        show(str(out / PAGE))


def _show(comparison: RunComparison) -> None:
    equal = comparison.identical and not comparison.unmet
    show(comparison.verdict, "bold green" if equal else "bold")
    _show_names("Only some runs have", comparison.missing)
    _show_names("Not compared, as their units or types differ:", comparison.other_units)
    for title, each in comparison.tables.items():
        first, *others = each.head
        most = len(each.rows) if title == "Success criteria" else SHOWN
        rows = [[as_cell(str(cell)) for cell in cells] for cells in each.rows[:most]]
        if rows:
            show(table((f"{first}*", *others), rows, right=others))
        if len(each.rows) > most:
            show(f"and {len(each.rows) - most} more", "dim")


def _show_names(what: str, columns: tuple[str, ...]) -> None:
    if columns:
        show(f"{what} {signal_names(columns, SHOWN)}")
