"""`panda-cosim compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ....fmus.atomic import check_replaceable, replacing
from ....fmus.errors import InputError
from ...compare.between_runs import RunComparison, compare, extent_rows, judged_text
from ...compare.formats import numbers, percent, signal_names
from ..console import as_cell, show, show_json, table
from ..options import JSON, OVERWRITE, argument, option

SHOWN = 8  # rows of a table
PAGE = "compare.html"


def command(
    runs: list[Path] = argument(
        "RUN RUN [RUN]...", "Folders of runs; the others are compared with the first."
    ),
    out: Path | None = option("--out -o DIR", f"Write {PAGE} there, with all details."),
    json: bool = JSON,
    overwrite: bool = OVERWRITE,
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
        raise InputError("RUN: only one; must be at least two runs")
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
    names, others = comparison.names, comparison.names[1:]
    show(comparison.verdict, "bold green" if equal else "bold")
    _show_rows(("Recorded", *names), list(extent_rows(comparison)))
    _show_names("Only some runs have", comparison.missing)
    _show_names("Not compared, as their units differ:", comparison.other_units)
    parameters = [(row.name, *numbers(row.values)) for row in comparison.parameters]
    _show_rows(("Parameter*", *names), parameters, SHOWN)
    criteria = [(row.name, *map(judged_text, row.judged)) for row in comparison.criteria]
    _show_rows(("Criterion*", *names), criteria)
    metrics = [(row.name, *numbers(row.values)) for row in comparison.metrics]
    _show_rows(("Metric*", *names), metrics, SHOWN)
    signals = [(row.name, percent(row.share), *row.texts) for row in comparison.signals]
    _show_rows(("Signal", "of its range", *others), signals, SHOWN)


def _show_rows(head: Sequence[str], rows: Sequence[Sequence[str]], most: int | None = None) -> None:
    """Show a table, if it has rows, or its first ones."""
    if rows:
        show(table(head, (map(as_cell, cells) for cells in rows[:most]), right=head[1:]))
    if most is not None and len(rows) > most:
        show(f"and {len(rows) - most} more", "dim")


def _show_names(what: str, columns: tuple[str, ...]) -> None:
    if columns:
        show(f"{what} {signal_names(columns, SHOWN)}")
