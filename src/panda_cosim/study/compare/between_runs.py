"""Compares runs with each other: parameters, criteria, metrics and signals.

All runs are compared with the first. Their scenarios, lengths and step sizes may differ; signals
of the same name and unit are compared at the instants of all runs, where the times overlap.
Between its own, a run's Reals are interpolated; all else keeps its value. A log of a robot or
another program is compared as a run without parameters, criteria and metrics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import InputError
from ...result.judging.criterion import Criterion, bound_text, margin_text, quantity
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...result.recording.logs import is_log, open_log
from ...result.recording.reader import run_names
from ...run.finished import Run
from ...task.typed import typed
from . import differences
from .differences import Extent, SignalRow
from .page import Figure, Page, Part, Section, Table, curve, render, varied
from .wording import DASH, multiple, precise, short

Names = tuple[str, ...]

FIGURES: Final = 12
ALIKE: Final = 2  # figures of one signal's elements
VIEWED: Final = 3  # curves of the most different signals beside the 3D view
SIGNALS: Final = "Signals that differ, the most default tolerances first"
DIGITS: Final = 9  # of instants [s], so that rounding of k * dt makes no second one


class RunComparison:
    """Runs against the first of them; `compare` makes it.

    Attributes:
        names: Names of the runs.
        recordings: Their recordings.
        extents: What each run recorded.
        verdicts: What each run came to.
        begin: First of the instants, those of all runs, at which they were compared [s].
        end: The last of these [s].
        rows: Their number.
        columns: Number of compared columns.
        parameters: Parameters that differ.
        criteria: All criteria, those that only later runs miss first.
        metrics: Metrics that differ, the largest difference first.
        signals: Columns of all runs that differ, the most default tolerances apart first.
        missing: Columns that only some runs have.
        other_units: Columns that are of another unit, or text in some runs; they are not compared.
    """

    def __init__(
        self, names: Sequence[str], runs: Sequence[Recording], summaries: Sequence[Summary]
    ) -> None:
        self.names, self.recordings = tuple(names), tuple(runs)
        instants, own = differences.joint_instants(names, [run.time for run in runs])
        compared, self.other_units, self.missing = _columns(runs)
        if not compared:
            raise InputError(f"{', '.join(names)}: nothing to compare: no signal in common")
        self.extents = tuple(map(Extent.of, runs))
        self.verdicts = tuple(summary.verdict for summary in summaries)
        self.begin, self.end = float(instants[0]), float(instants[-1])
        self.rows, self.columns = len(instants), len(compared)
        settings = [differences.parameters_of(run) for run in runs]
        self.parameters = _differing(settings)
        judged = [{each.name: each for each in summary.criteria} for summary in summaries]
        newly = sorted(differences.side_by_side(judged), key=lambda row: not _newly_missed(row))
        self.criteria = tuple(newly)
        metrics = _differing([dict(summary.numbers()) for summary in summaries])
        self.metrics = tuple(sorted(metrics, key=lambda row: -row.relative))
        self.signals = differences.signals_apart(compared, runs, instants, own)

    def __repr__(self) -> str:
        return f"<RunComparison of {', '.join(self.names)}: {self.verdict}>"

    @property
    def identical(self) -> bool:
        """Whether all runs recorded the same: signals, instants, and whether they ended early."""
        same_extent = all(extent == self.extents[0] for extent in self.extents)
        return same_extent and not (self.signals or self.missing or self.other_units)

    @property
    def unmet(self) -> bool:
        """Whether a run did not come to what its scenario expects."""
        return any(verdict.level == "bad" for verdict in self.verdicts)

    def to_dict(self) -> dict[str, object]:
        """Return plain values, for JSON."""
        parts = ("extents", "parameters", "metrics", "signals")
        plain = ("begin", "end", "rows", "columns", "missing", "other_units")
        criteria = [{"name": row.name, "judged": asdict(row)["values"]} for row in self.criteria]
        return {
            "runs": self.names,
            "verdicts": [verdict.word for verdict in self.verdicts],
            "identical": self.identical,
            **{name: getattr(self, name) for name in plain},
            "criteria": criteria,
            **{part: [asdict(row) for row in getattr(self, part)] for part in parts},
        }

    @property
    def tables(self) -> dict[str, Table]:
        """What each run recorded, and what differs, by heading."""
        extents = self.extents
        recorded = [
            ("span", *(f"{precise(e.begin)} to {precise(e.end)} s" for e in extents)),
            ("rows", *(str(e.rows) for e in extents)),
            ("ended", *("complete" if e.complete else f"early: {e.reason}" for e in extents)),
            ("verdict", *(verdict.word for verdict in self.verdicts)),
        ]
        criteria = [
            (row.name, bound_text(next(filter(None, row.values))), *map(_judged, row.values))
            for row in self.criteria
        ]
        signals = [
            (row.name, multiple(row.multiple), f"{short(100.0 * row.share)} %", *row.texts)
            for row in self.signals
        ]
        parameters = [row.cells for row in self.parameters]
        metrics = [row.cells for row in self.metrics]
        names = self.names
        return {
            "Recorded": Table(("Recorded", *names), recorded),
            "Parameters that differ": Table(("Parameter", *names), parameters),
            "Success criteria": Table(("Criterion", "Required", *names), criteria),
            SIGNALS: Table(("Signal", "x tolerance", "of its range", *names[1:]), signals),
            "Metrics that differ": Table(("Metric", *names), metrics, f"{len(metrics)} metrics"),
        }

    @property
    def verdict(self) -> str:
        """What was compared, and what came of it."""
        if self.identical:
            result = "All recorded signals are equal"
        else:
            count = len(self.signals)
            result = f"{count or 'None'} of the compared columns differ{'s' if count < 2 else ''}"
            result += "" if count else ", but the runs are not the same"
        span = f"from {precise(self.begin)} to {precise(self.end)} s"
        return f"{result}. Compared: {self.columns} columns, {self.rows} rows, {span}."

    def to_html(self) -> str:
        """Return the comparison as a self-contained page."""
        return render(_page(self))

    def _repr_html_(self) -> str:
        from ...result.view.page import Inline  # noqa: PLC0415 - only in a notebook

        return Inline(self.to_html(), 640)._repr_html_()


@typed
def compare(
    first: Run | str | Path, *others: Run | str | Path, names: Path | None = None
) -> RunComparison:
    """Compare runs with the first of them.

    Args:
        first: A run, or its folder.
        others: At least one more, or a log: CSV, Parquet or MCAP.
        names: What the logs' columns are in the first run, see `LogNames`; None: their names.

    Raises:
        InputError: There is no such run, or only one, or they have no signal or span in common.
    """
    if not others:
        raise InputError("compare: only one run; must be at least two")
    opened = [_opened(first)]
    opened += [_opened(other, opened[0][0], names) for other in others]
    recordings, summaries = (list(each) for each in zip(*opened, strict=True))
    return RunComparison(run_names(recordings), recordings, summaries)


def _differing(tables: Sequence[Mapping[str, object]]) -> tuple[differences.Row, ...]:
    """Return what differs; nothing if a table is empty, as a log's is."""
    return tuple(differences.differing(tables)) if all(tables) else ()


def _columns(runs: Sequence[Recording]) -> tuple[Names, Names, Names]:
    """Return the columns that can be compared, those of other units, and those not in all runs."""
    counts = Counter(name for run in runs for name in run.types if name != "time")
    common = [name for name, count in counts.items() if count == len(runs)]
    units = {name: {run.units.get(name) for run in runs} for name in common}  # None: of a text
    compared = tuple(name for name in common if len(units[name]) == 1)
    others = tuple(name for name in common if name not in compared)
    return compared, others, tuple(name for name in counts if name not in units)


def _opened(
    run: Run | str | Path, like: Recording | None = None, names: Path | None = None
) -> tuple[Recording, Summary]:
    """Return a run's recording and summary; also those of a log `like` a run."""
    if isinstance(run, Run):
        return run.recording, run.summary
    if like is not None and is_log(Path(run)):
        return open_log(Path(run), names, like), Summary()
    recording = Recording.open(run, in_order=True)
    return recording, Summary.of(recording)


def _newly_missed(row: differences.Row) -> bool:
    first, *others = row.values
    return bool(first and first.ok) and any(other and not other.ok for other in others)


def _judged(criterion: Criterion | None) -> str:
    """Format the measured value and its margin."""
    if criterion is None:
        return DASH
    if criterion.value is None:
        return f"not measured: {criterion.reason}"
    missed = "" if criterion.ok else ", missed"
    value = quantity(criterion.value, criterion.unit)
    return f"{value} ({margin_text(criterion)}{missed})"


def _page(comparison: RunComparison) -> Page:
    """Return the page: one section, in which all runs are held against the first."""
    first, *others = comparison.names
    state = "bad" if comparison.unmet else "good" if comparison.identical else ""
    recorded, *parts = (
        _signals_part(comparison, table) if title == SIGNALS else Part(title, [table])
        for title, table in comparison.tables.items()
    )
    view, runs = _view(comparison)
    name = f"{', '.join(others)} against {first}"
    deviations = f" Deviations are from {first}." if comparison.signals else ""
    return Page(
        title=f"{', '.join(comparison.names[:-1])} and {comparison.names[-1]}",
        state=state,
        about=comparison.verdict + deviations,
        key=[("reference", first), *((f"r{i % 5 + 1}", name) for i, name in enumerate(others))],
        sections=[Section(name, state, [recorded, *view, *parts])],
        runs=runs,
    )


def _signals_part(comparison: RunComparison, table: Table) -> Part:
    """Return the curves, and what could not be compared."""
    tables = [replace(table, folded=f"{len(table.rows)} signals that differ")]
    for columns, words in (
        (comparison.other_units, "columns in other units or types, not compared"),
        (comparison.missing, "columns that only some runs have"),
    ):
        tables.append(Table(("Signal",), [(each,) for each in columns], f"{len(columns)} {words}"))
    numbers = [row for row in comparison.signals if row.name in comparison.recordings[0].units]
    shown = varied(numbers, ALIKE)[:FIGURES]
    note = "A range below a thousandth of the signal's largest value counts as that."
    figures = [_figure(row, comparison) for row in shown]
    return Part(SIGNALS, tables, note if table.rows else "", figures)


def _figure(row: SignalRow, comparison: RunComparison) -> Figure:
    """Return a column's curves in all runs, at the instants of all of them."""
    runs = comparison.recordings
    time = np.unique(np.round(np.concatenate([run.time for run in runs]), DIGITS))
    values = [_curve(time, run, row.name) for run in runs]
    worst = row.times[int(np.argmax(row.largest))]
    lines = curve(row.unit, dict(zip(comparison.names, values, strict=True)), time, worst)
    meaning = runs[0].descriptions.get(row.name, "")
    return Figure(row.name, "; ".join(row.texts), meaning, lines)


def _curve(time: Array, run: Recording, name: str) -> Array:
    """Return a column at the instants of all runs, NaN before and after its own."""
    values = differences.on_times(time, run.time, run[name].astype(float), run.is_real(name))
    slack = 10.0**-DIGITS
    within = (time >= run.time[0] - slack) & (time <= run.time[-1] + slack)
    return np.asarray(np.where(within, values, np.nan))


def _view(comparison: RunComparison) -> tuple[list[Part], str]:
    """Show the run that differs most in 3D, with the first one as a ghost; with their data."""
    from ...result.view.page import show_source  # noqa: PLC0415 - slow to import
    from .views import Views  # noqa: PLC0415 - slow to import

    if not comparison.signals:
        return [], ""
    worst, views = comparison.signals[0], Views()
    other = int(np.argmax(worst.largest))
    runs = [(comparison.recordings[i], comparison.names[i]) for i in (other + 1, 0)]
    columns = [row.name for row in comparison.signals[:VIEWED]]
    shown = (show_source(each, name, summary=Summary.of(each)) for each, name in runs)
    return [views.add(shown, columns, worst.times[other])], views.elements
