"""The report of a suite: its differences from the references on one page, the worst first."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from ...fmus.atomic import write_whole
from ...result.judging.criterion import cells
from ...result.recording import Recording
from ...result.view.page import shown_run
from ...run.output import versions
from ...task.values import Values
from .against_reference import Comparison, Deviation, matching_rows
from .differences import Row, differing
from .outcome import MEANINGS, Outcome, exit_code, headline
from .page import POINTS, POINTS_INSIDE, Figure, Page, Part, Section, Table, curve, render, varied
from .reference import Reference
from .requirements import Proof, of_outcome
from .tubes import tube
from .views import Views, limited, shown_reference
from .wording import DASH, instant, measure

CURVES: Final = 8  # of a scenario that differs
CURVES_SAME: Final = 2  # of one that does not
ALIKE: Final = 3  # curves per signal
LISTED: Final = 12  # signals in the open table
KEY: Final = (("reference", "reference"), ("tube", "tube around it"), ("r1", "this run"))
CRITERIA: Final = ("Criterion", "Measured", "Required", "Margin", "Verdict")
SIGNALS: Final = (
    "Signal", "Multiple of tolerance", "Largest deviation", "At", "First outside", "Ticks outside"
)  # fmt: skip
NIGHTS: Final = ("Night", "Commit", "Verdict", "Multiple of tolerance", "Recording", "Made of")
REQUIREMENTS: Final = ("Requirement", "Criterion", "Scenario", "Verdict")


def write_report(outcomes: Sequence[Outcome], path: Path, values: Values) -> None:
    """Write the report of a suite that was run with some values changed, by key."""
    views = Views()
    sections = [_section(outcome, views) for outcome in sorted(outcomes, key=_rank)]
    if proven := sorted(proof for outcome in outcomes for proof in of_outcome(outcome)):
        sections.insert(0, _requirements(proven))
    page = Page(
        title=headline(outcomes),
        state="bad" if exit_code(outcomes) else "good",
        about=_about(outcomes),
        key=KEY,
        sections=sections,
        runs=views.elements,
        settings=[f"{key} = {value}" for key, value in values.items()],
    )
    write_whole(path, render(page))


def _requirements(proven: Sequence[Proof]) -> Section:
    state = "good" if all(proof.ok for proof in proven) else "bad"
    table = Table(REQUIREMENTS, [proof[:4] for proof in proven])
    return Section("Requirements", state, [Part("What proves them", [table])])


def _rank(outcome: Outcome) -> tuple[int, float, str]:
    """Sort key of the verdicts: the worst first."""
    share = outcome.worst.share if outcome.worst else 0.0
    return list(MEANINGS).index(outcome.verdict), -share, outcome.name


def _about(outcomes: Sequence[Outcome]) -> str:
    """Return date, duration and versions in one line."""
    facts = [time.strftime("%Y-%m-%d %H:%M"), f"{sum(o.seconds for o in outcomes):.0f} s of runs"]
    return " · ".join([*facts, *map(" ".join, versions().items())])


def _section(outcome: Outcome, views: Views) -> Section:
    criteria = Part("Success criteria", [Table(CRITERIA, list(map(cells, outcome.criteria)))])
    compared = _compared(outcome, outcome.comparison, views) if outcome.comparison else []
    history = [_history(outcome)] if outcome.nights else []
    return Section(outcome.name, outcome.meaning.level, [criteria, *history, *compared], outcome)


def _history(outcome: Outcome) -> Part:
    """Return the nights of a case, the last one first."""
    nights = [[DASH if it in ("", None) else it for it in n[1:]] for n in reversed(outcome.nights)]
    tables = Table(NIGHTS, nights[:LISTED]), Table(NIGHTS, nights[LISTED:], "Earlier nights")
    return Part("History", tables, outcome.flaky)


def _compared(outcome: Outcome, comparison: Comparison, views: Views) -> list[Part]:
    """Return the parts of a run that was compared with its reference."""
    reference, recording = Reference.read(outcome.reference_path), Recording.open(outcome.run)
    failed = [d for d in comparison.deviations if not d.ok]  # the first of them
    listed = len(failed[:LISTED])
    shown = varied(failed, ALIKE)[:CURVES] or comparison.deviations[:CURVES_SAME]
    shown = [deviation for deviation in shown if deviation.name in reference.columns]
    metrics = differing([dict(each.summary.numbers()) for each in (reference, outcome)])
    metrics.sort(key=lambda row: -row.relative)
    rows = [_deviation(d) for d in comparison.deviations]
    others = Table(SIGNALS, rows[listed:], f"{len(rows) - listed} more signals")
    tables = [Table(SIGNALS, rows[:listed]), others]
    figures = [_figure(d, outcome, recording, reference) for d in shown]
    return [
        _view(outcome, shown, views),
        Part("Signals, worst first", tables, comparison.scope, figures),
        _changes("Bounds, parameters, models, versions, FMUs", comparison.causes),
        _changes("Metrics", metrics, f"{len(metrics)} that differ"),
    ]


def _deviation(d: Deviation) -> tuple[str | float, ...]:
    first = DASH if d.first is None else f"{instant(d.first)} s"
    where = (measure(d.distance, d.unit), f"{instant(d.time)} s", first, str(d.outside or DASH))
    return (d.name, d.share, *where)


def _view(outcome: Outcome, shown: Sequence[Deviation], views: Views) -> Part:
    """Show the run in 3D at the instant of the worst deviation."""
    columns, name = [deviation.name for deviation in shown], outcome.name
    run = partial(shown_run, outcome.run, name=name)
    ghost = partial(shown_reference, outcome.reference_path, f"reference of {name}")
    limits = (limited(each(), columns) for each in (run, ghost))
    return views.add(limits, columns, shown[0].time if shown else 0.0)


def _figure(
    deviation: Deviation, outcome: Outcome, recording: Recording, reference: Reference
) -> Figure:
    """Return a column's curves at the reference's ticks, NaN where the run has no value."""
    rows = matching_rows(recording.time, reference)
    run = np.full(reference.rows, np.nan)
    run[rows[rows >= 0]] = recording[deviation.name][rows >= 0]
    expected = reference[deviation.name].astype(float)
    width = deviation.tolerance + reference.quanta.get(deviation.name, 0.0) / 2
    lines = curve(
        deviation.unit,
        {"reference": expected, "run": run},
        reference.time,
        deviation.time,
        tube(expected, width, outcome.read.regression.ticks(reference.step_size)),
        deviation.tolerance,
        POINTS_INSIDE if deviation.ok else POINTS,
    )
    meaning = recording.descriptions.get(deviation.name, "")
    return Figure(deviation.name, deviation.text, meaning, lines)


def _changes(title: str, rows: Sequence[Row], folded: str = "") -> Part:
    """Return what has changed from the reference."""
    table = Table(("What", "Reference", "This run"), [row.cells for row in rows], folded)
    return Part(title, [table])
