"""`panda-cosim compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable, replacing
from ....fmus.errors import InputError
from ...compare.between_runs import RunComparison, compare, extent_rows, judged_text
from ...compare.differences import Row
from ...compare.formats import numbers, percent
from ..console import as_cell, show, show_json, table
from ..options import Json, Overwrite

SHOWN = 8  # rows of a table
PAGE = "compare.html"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN RUN [RUN]...",
            help="Folders of runs; the others are compared with the first.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help=f"Write {PAGE} there, with all details."),
    ] = None,
    json: Json = False,
    overwrite: Overwrite = False,
) -> None:
    """Compare runs: parameters, verdicts, metrics and signals.

    Shows how the parameters, verdicts and signals of each run differ from the first run's. Signals
    are ranked by the largest deviation as a share of the element's range; a range below a
    thousandth of the signal's largest value counts as that. The page overlays the curves of all
    runs. Runs of other lengths are compared where they overlap, and are not identical. Runs that
    have nothing in common end the command with exit code 2.

    ```
    panda-cosim run push --out runs/a
    panda-cosim run push --set controller.kp=6 --out runs/b
    panda-cosim compare runs/a runs/b --out report
    ```
    """
    if len(runs) < 2:
        raise InputError("RUN: one run is given; must be at least two")
    comparison = compare(runs[0], *runs[1:])
    if out is not None:
        check_replaceable(out / PAGE, overwrite=overwrite)
        with replacing(out / PAGE) as temporary:
            temporary.write_text(comparison.to_html(), encoding="utf-8")
    if json:
        show_json(comparison.to_dict())
        return
    _show(comparison)
    if out is not None:
        show(str(out / PAGE))


def _show(comparison: RunComparison) -> None:
    equal = comparison.identical and not comparison.unmet
    show(comparison.verdict, "bold green" if equal else "bold")
    recorded = table(("Recorded", *comparison.names), right=comparison.names)
    for cells in extent_rows(comparison):
        recorded.add_row(*map(as_cell, cells))
    show(recorded)
    _show_names("Only some runs have", comparison.missing)
    _show_names("Not compared, as their units differ:", comparison.other_units)
    _show_rows("Parameter", comparison, comparison.parameters)
    if comparison.criteria:
        criteria = table(("Criterion*", *comparison.names), right=comparison.names)
        for row in comparison.criteria:
            criteria.add_row(as_cell(row.name), *(as_cell(judged_text(c)) for c in row.judged))
        show(criteria)
    _show_rows("Metric", comparison, comparison.metrics)
    _show_signals(comparison)


def _show_rows(head: str, comparison: RunComparison, rows: tuple[Row, ...]) -> None:
    if not rows:
        return
    values = table((f"{head}*", *comparison.names), right=comparison.names)
    for row in rows[:SHOWN]:
        values.add_row(as_cell(row.name), *map(as_cell, numbers(row.values)))
    show(values)
    _show_rest(len(rows))


def _show_signals(comparison: RunComparison) -> None:
    if not comparison.signals:
        return
    others = comparison.names[1:]
    rows = table(("Signal", "of its range", *others), right=("of its range", *others))
    for row in comparison.signals[:SHOWN]:
        rows.add_row(as_cell(row.name), percent(row.share), *map(as_cell, row.texts))
    show(rows)
    _show_rest(len(comparison.signals))


def _show_names(what: str, columns: tuple[str, ...]) -> None:
    signals = list(dict.fromkeys(name.partition("[")[0] for name in columns))
    if signals:
        more = f" and {len(signals) - SHOWN} more" if len(signals) > SHOWN else ""
        show(f"{what} {', '.join(signals[:SHOWN])}{more}")


def _show_rest(count: int) -> None:
    if count > SHOWN:
        show(f"and {count - SHOWN} more", "dim")
