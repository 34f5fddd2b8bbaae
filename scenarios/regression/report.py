"""The report: one HTML file with the differences from the references, the worst first.

The file contains its style, script, curves and pictures. Names, purposes, units and messages come
from users; the template escapes all of them.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from ...fmus.atomic import replacing
from ..judging.criterion import Criterion, bound_text, margin_text, quantity
from ..recording import Recording
from ..running.start import Overrides
from .compare import Deviation, deviation_text
from .guards import measure, multiple
from .metrics import Metric, compare_metrics
from .reference import Reference, kept_metadata
from .report_data import curve
from .report_pictures import picture
from .report_view import ReportViews
from .runner import Outcome
from .templating import DASH, fill, number, numbers

TEMPLATE: Final = "report_template.html"
CURVES: Final = 8  # of a scenario that differs
CURVES_SAME: Final = 2  # of one that does not
ALIKE: Final = 3  # curves per signal
LISTED: Final = 12  # signals in the open table
NOTICED: Final = 0.01  # relative change from which a metric is shown unfolded
DECADES: Final = 4.0  # of tolerance, from a hundredth to a hundred times, along a bar
# What ran and differs comes before what could not be judged, so that errors hide no difference.
ORDER: Final = {"differs": 0, "missed": 0, "failed": 1, "no reference": 2, "same": 3, "holds": 3}


def write_report(outcomes: Sequence[Outcome], path: Path, overrides: Overrides) -> None:
    """Write the report.

    Args:
        outcomes: Of the suite.
        path: The HTML file.
        overrides: Parameters that were set for this run, by instance and name.

    Raises:
        InputError: The file cannot be written.
    """
    page = fill(TEMPLATE, _content(outcomes, overrides), (measure, bar_length, short_share))
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def bar_length(share: float) -> int:
    """Return the bar length [%] of a share of the tolerance, logarithmic with 1 in the middle."""
    length = (math.log10(min(max(share, 1e-9), 1e9)) + DECADES / 2) / DECADES
    return round(100 * min(max(length, 0.0), 1.0))


def short_share(share: float) -> str:
    """Format a share of the tolerance."""
    return "∞" if math.isinf(share) else multiple(share) if share >= 1e-3 else "0"


def _content(outcomes: Sequence[Outcome], overrides: Overrides) -> dict[str, Any]:
    """Return the content for the template."""
    curves: list[dict[str, Any]] = []
    views = ReportViews()
    wrong = sum(not outcome.ok for outcome in outcomes)
    return {
        "title": _headline(outcomes, wrong),
        "wrong": wrong,
        "about": _about(outcomes),
        "settings": [
            f"{instance}.{name} = {value}"
            for instance, values in overrides.items()
            for name, value in values.items()
        ],
        "sections": [_section(o, curves, views) for o in sorted(outcomes, key=_rank)],
        "curves": curves,
        "view": views.page_parts,
        "nonce": secrets.token_urlsafe(),  # of the only script that the page may run
    }


def _rank(outcome: Outcome) -> tuple[int, float, str]:
    """Sort key of the verdicts: the worst first."""
    worst = outcome.comparison.worst if outcome.comparison else None
    return ORDER[outcome.verdict], -(worst.share if worst else 0.0), outcome.name


def _headline(outcomes: Sequence[Outcome], wrong: int) -> str:
    count = len(outcomes)
    if any(outcome.verdict in ("holds", "missed") for outcome in outcomes):
        return f"{count - wrong} of {count} scenarios pass"
    if not wrong:
        return f"All {count} scenarios match their references" if count > 1 else "No difference"
    says = "do not match their references" if wrong > 1 else "does not match its reference"
    return f"{wrong} of {count} scenarios {says}"


def _about(outcomes: Sequence[Outcome]) -> str:
    """Return date, duration and versions in one line."""
    facts = [time.strftime("%Y-%m-%d %H:%M"), f"{sum(o.seconds for o in outcomes):.0f} s of runs"]
    ran = [o for o in outcomes if o.verdict != "failed"]
    if ran:
        versions = Recording.open(ran[0].run).metadata.get("versions", {})
        facts += [f"{name} {version}" for name, version in versions.items()]
    return " · ".join(facts)


def _section(outcome: Outcome, curves: list[dict[str, Any]], views: ReportViews) -> dict[str, Any]:
    """Return one scenario's section of the page; add its curves and 3D view to the lists."""
    comparison = outcome.comparison
    section: dict[str, Any] = {
        "name": outcome.name,
        "purpose": outcome.scenario.purpose,
        "state": "good" if outcome.ok else "warn" if outcome.verdict == "no reference" else "bad",
        "word": "not compared" if outcome.verdict == "no reference" else outcome.verdict,
        "reason": outcome.reason,
        "seconds": outcome.seconds,
        "problems": [outcome.error] if outcome.error else [],
        "worst": comparison.worst if comparison else None,
        "compared": comparison is not None,
        "criteria": [_criterion_row(criterion) for criterion in outcome.criteria],
    }
    if comparison is None:
        return section
    reference, recording = Reference.read(outcome.reference_path), Recording.open(outcome.run)
    failed = [d for d in comparison.deviations if not d.ok]
    shown = _varied(failed)[:CURVES] or comparison.deviations[:CURVES_SAME]
    section["problems"] += [problem.text for problem in comparison.problems]
    return section | {
        "figures": [_figure(d, outcome, recording, reference, curves) for d in shown],
        "failed": failed[:LISTED],
        "others": [d for d in comparison.deviations if d not in failed[:LISTED]],
        "metrics": _metrics(compare_metrics(reference.summary, outcome.summary)),
        "picture": picture(outcome.run),
        "view": _view(outcome, shown, views),
        "origins": _origins(reference.metadata, kept_metadata(recording)),
    }


def _criterion_row(criterion: Criterion) -> tuple[str, ...]:
    measured = criterion.reason or quantity(criterion.value, criterion.unit)
    margin = margin_text(criterion)
    return (criterion.name, measured, bound_text(criterion), margin, criterion.word)


def _view(outcome: Outcome, shown: Sequence[Deviation], views: ReportViews) -> dict[str, Any]:
    """Return the runs in a scenario's viewer, and the instant of the worst deviation."""
    worst = outcome.comparison.worst if outcome.comparison else None
    columns = [deviation.name for deviation in shown]
    found = views.add(outcome.run, outcome.reference_path, outcome.name, columns)
    return found | {"at": worst.time if worst and math.isfinite(worst.time) else 0.0}


def _figure(
    deviation: Deviation,
    outcome: Outcome,
    recording: Recording,
    reference: Reference,
    curves: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return a signal's figure; add its curve to the list."""
    curves.append(curve(deviation, recording, reference, outcome.tolerances))
    return {
        "name": deviation.name,
        "text": deviation_text(deviation),
        "meaning": recording.descriptions.get(deviation.name, ""),
        "curve": len(curves) - 1,
    }


def _varied(deviations: Sequence[Deviation]) -> list[Deviation]:
    """Limit the elements per signal, so that other signals are seen."""
    counts: Counter[str] = Counter()
    kept = []
    for deviation in deviations:
        signal = deviation.name.partition("[")[0]
        counts[signal] += 1
        if counts[signal] <= ALIKE:
            kept.append(deviation)
    return kept


def _metrics(metrics: Sequence[Metric]) -> dict[str, list[tuple[str, ...]]]:
    """Return the rows of the metrics tables, by size of the change."""
    tables: dict[str, list[tuple[str, ...]]] = {"most": [], "little": [], "same": []}
    for m in metrics:
        kind = "most" if m.relative > NOTICED else "little" if m.relative > 0.0 else "same"
        change = number(m.change, "+") if m.changed else DASH
        tables[kind].append((m.name, *numbers((m.before, m.now)), change))
    return tables


def _origins(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Compare the origins of reference and run: parameters, versions, machine, FMUs."""
    old, new = dict(_flatten(before)), dict(_flatten(now))
    names = list({**new, **old})
    rows = {name: (name, str(old.get(name, DASH)), str(new.get(name, DASH))) for name in names}
    changed = [name for name in names if old.get(name) != new.get(name)]
    return {
        "changed": [rows[name] for name in changed],
        "same": [rows[name] for name in names if name not in changed],
    }


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


__all__ = ["write_report"]
