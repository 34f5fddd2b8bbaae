"""`panda-cosim compare`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from rich.text import Text

from ...fmus.atomic import check_replaceable, write_whole
from ...study.compare.between_runs import RunComparison, compare
from ...study.compare.wording import signal_names
from ..common import JSON, MAP, OVERWRITE
from ..console import Item, show_result, table
from ..forms import argument, option

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
    comparison = compare(runs[0], *runs[1:], names=names)
    if out is not None:
        check_replaceable(out / PAGE, overwrite=overwrite)
        write_whole(out / PAGE, comparison.to_html())
    written = [] if out is None else [str(out / PAGE)]
    show_result(comparison.to_dict(), chain(_shown(comparison), written), json=json)


def _shown(comparison: RunComparison) -> Iterator[Item]:
    equal = comparison.identical and not comparison.unmet
    yield Text(comparison.verdict, "bold green" if equal else "bold")
    for what, columns in (
        ("Only some runs have", comparison.missing),
        ("Not compared, as their units or types differ:", comparison.other_units),
    ):
        if columns:
            yield f"{what} {signal_names(columns, SHOWN)}"
    for title, each in comparison.tables.items():
        first, *others = each.head
        most = len(each.rows) if title == "Success criteria" else SHOWN
        if each.rows:
            yield table((f"{first}*", *others), each.rows[:most], right=others)
        if len(each.rows) > most:
            yield Text(f"and {len(each.rows) - most} more", "dim")
