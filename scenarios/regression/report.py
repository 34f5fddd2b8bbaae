"""Writes the report of a suite: one HTML file that needs nothing else.

All text is in the page itself; the script in it only draws the curves.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from ..files import replacing
from ..recording import Recording
from ..running.start import Overrides
from .compare import Deviation
from .guards import measure
from .metrics import Metric, compare_metrics
from .reference import Reference, kept_metadata
from .regress import Outcome
from .report_data import curve
from .report_pictures import picture
from .report_text import (
    DASH,
    bar,
    cells,
    details,
    number,
    rows_table,
    share_text,
)

TEMPLATE: Final = "report_template.html"
CURVES: Final = 8  # of a scenario that differs
CURVES_SAME: Final = 2  # of one that does not
ALIKE: Final = 3  # curves of one signal's elements
LISTED: Final = 12  # signals in the table that is open
NOTICED: Final = 0.01  # relative change of a metric that is shown unfolded
ORDER: Final = {"failed": 0, "differs": 1, "no reference": 2, "same": 3}
WORDS: Final = {"same": "same", "differs": "differs", "failed": "failed", "no reference": "new"}


def write_report(outcomes: Sequence[Outcome], path: Path, overrides: Overrides) -> None:
    """Write the report.

    Args:
        outcomes: Of the suite.
        path: The HTML file.
        overrides: Parameters that were set for this run, by instance and name.

    Raises:
        InputError: The file cannot be written.
    """
    ranked = sorted(outcomes, key=_rank)
    curves: list[dict[str, Any]] = []
    sections = [_section(outcome, curves) for outcome in ranked]
    wrong = sum(not outcome.ok for outcome in outcomes)
    fields = {
        "TITLE": escape(_headline(len(outcomes), wrong)),
        "STATE": "bad" if wrong else "good",
        "ABOUT": _about(outcomes, overrides),
        "VERDICTS": "\n".join(_verdict_row(outcome) for outcome in ranked),
        "SECTIONS": "\n".join(sections),
        # No text of ours can end the script element.
        "CURVES": json.dumps(curves).replace("<", "\\u003c"),
    }
    page = files(__package__).joinpath(TEMPLATE).read_text(encoding="utf-8")
    for name, value in fields.items():
        page = page.replace(f"{{{{{name}}}}}", value)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _rank(outcome: Outcome) -> tuple[int, float, str]:
    """Order of the verdicts: what is wrong first, the worst of it before the rest."""
    worst = outcome.comparison.worst if outcome.comparison else None
    return ORDER[outcome.verdict], -(worst.share if worst else 0.0), outcome.scenario.name


def _headline(count: int, wrong: int) -> str:
    if not wrong:
        return f"All {count} scenarios are as their references" if count > 1 else "No difference"
    return f"{wrong} of {count} scenarios {'are' if wrong > 1 else 'is'} not as before"


def _about(outcomes: Sequence[Outcome], overrides: Overrides) -> str:
    """Tell when, where and with what, in one line."""
    facts = [time.strftime("%Y-%m-%d %H:%M"), f"{sum(o.seconds for o in outcomes):.0f} s of runs"]
    ran = [o for o in outcomes if o.verdict != "failed"]
    if ran:
        versions = Recording.open(ran[0].run).metadata.get("versions", {})
        facts += [f"{name} {version}" for name, version in versions.items()]
    text = escape(" · ".join(facts))
    chips = "".join(
        f"<code class=chip>{escape(f'{instance}.{name} = {value}')}</code>"
        for instance, values in overrides.items()
        for name, value in values.items()
    )
    return f"<p class=about>{text}</p>" + (f"<p class=about>Set: {chips}</p>" if chips else "")


def _verdict_row(outcome: Outcome) -> str:
    name = escape(outcome.scenario.name)
    worst = outcome.comparison.worst if outcome.comparison else None
    why = escape(outcome.reason) or f"<span class=muted>{escape(outcome.scenario.purpose)}</span>"
    return (
        f'<tr class="{_state(outcome)}"><td data-label=Scenario><a href="#s-{name}">{name}</a></td>'
        f"<td data-label=Verdict>{_badge(outcome)}</td><td data-label=Why class=why>{why}</td>"
        f'<td data-label="Worst signal">{bar(worst.share) if worst else ""}</td>'
        f"<td data-label=Time class=num>{outcome.seconds:.1f} s</td></tr>"
    )


def _state(outcome: Outcome) -> str:
    return "good" if outcome.ok else "warn" if outcome.verdict == "no reference" else "bad"


def _badge(outcome: Outcome) -> str:
    return f'<span class="badge {_state(outcome)}">{WORDS[outcome.verdict]}</span>'


def _section(outcome: Outcome, curves: list[dict[str, Any]]) -> str:
    """Return one scenario's part of the page; its curves are added to the list."""
    name = escape(outcome.scenario.name)
    parts = [f"<p class=purpose>{escape(outcome.scenario.purpose)}</p>", _problems(outcome)]
    if outcome.comparison is not None:
        reference = Reference.read(outcome.reference_path)
        recording = Recording.open(outcome.run)
        now = kept_metadata(recording)
        parts += [
            _figures(outcome, recording, reference, curves),
            _deviations(outcome.comparison.deviations),
            _metrics(compare_metrics(reference.summary, outcome.summary)),
            picture(outcome.run),
            _origins(reference.metadata, now),
        ]
    opened = "" if outcome.ok else " open"
    return (
        f'<details class="scenario {_state(outcome)}" id="s-{name}"{opened}>'
        f"<summary><h2>{name}</h2>{_badge(outcome)}</summary>{''.join(parts)}</details>"
    )


def _problems(outcome: Outcome) -> str:
    texts = [outcome.error] if outcome.error else []
    if outcome.comparison is not None:
        texts += [problem.text for problem in outcome.comparison.problems]
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul class=problems>{items}</ul>" if items else ""


def _figures(
    outcome: Outcome,
    recording: Recording,
    reference: Reference,
    curves: list[dict[str, Any]],
) -> str:
    """Return places for the worst signals' curves."""
    comparison = outcome.comparison
    deviations = comparison.deviations if comparison else ()
    failed = _varied([d for d in deviations if not d.ok])[:CURVES]
    shown = failed or list(deviations[:CURVES_SAME])
    figures = []
    for deviation in shown:
        curves.append(curve(deviation, recording, reference, outcome.scenario.regression))
        meaning = escape(recording.descriptions.get(deviation.name, ""))
        caption = f"<b>{escape(deviation.name)}</b> {share_text(deviation)}<br><small>{meaning}"
        figures.append(
            f"<figure><figcaption>{caption}</small></figcaption>"
            f'<div class=chart data-curve="{len(curves) - 1}" tabindex=0 role=img '
            f'aria-label="{escape(deviation.name)}: reference, tube and run"></div></figure>'
        )
    return f"<h3>Signals, the worst first</h3><div class=figures>{''.join(figures)}</div>"


def _varied(deviations: Sequence[Deviation]) -> list[Deviation]:
    """Leave out what is one of many elements of a signal, so that other signals are seen."""
    counts: Counter[str] = Counter()
    kept = []
    for deviation in deviations:
        signal = deviation.name.partition("[")[0]
        counts[signal] += 1
        if counts[signal] <= ALIKE:
            kept.append(deviation)
    return kept


def _deviations(deviations: Sequence[Deviation]) -> str:
    head = ("Signal", "Of its tolerance", "Furthest", "At", "First outside", "Ticks outside")

    def rows(chosen: Iterable[Deviation]) -> list[str]:
        return [
            cells(
                f"<code>{escape(d.name)}</code>",
                bar(d.share),
                escape(measure(d.distance, d.unit)),
                f"{d.time:.3f} s",
                DASH if d.first is None else f"{d.first:.3f} s",
                str(d.outside or DASH),
            )
            for d in chosen
        ]

    first = [d for d in deviations if not d.ok][:LISTED]
    rest = [d for d in deviations if d not in first]
    table = rows_table(head, rows(first)) if first else ""
    return table + details(f"{len(rest)} more signals", rows_table(head, rows(rest)))


def _metrics(metrics: Sequence[Metric]) -> str:
    head = ("Metric", "Reference", "This run", "Change")

    def rows(chosen: Iterable[Metric]) -> list[str]:
        return [
            cells(
                f"<code>{escape(m.name)}</code>",
                number(m.before),
                number(m.now),
                DASH if not m.changed else number(m.change, signed=True),
            )
            for m in chosen
        ]

    most = [m for m in metrics if m.relative > NOTICED]
    little = [m for m in metrics if 0.0 < m.relative <= NOTICED]
    still = [m for m in metrics if m.relative == 0.0]
    table = rows_table(head, rows(most)) if most else "<p class=muted>None changed.</p>"
    less = details(f"{len(little)} that changed by less than 1 %", rows_table(head, rows(little)))
    return (
        f"<h3>Metrics</h3>{table}{less if little else ''}"
        f"{details(f'{len(still)} as before', rows_table(head, rows(still)))}"
    )


def _origins(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Compare what made reference and run: parameters, versions, machine, FMUs."""
    old, new = dict(_flatten(before)), dict(_flatten(now))
    head = ("What", "Reference", "This run")
    names = list({**new, **old})
    changed = [name for name in names if old.get(name) != new.get(name)]

    def rows(chosen: Iterable[str]) -> list[str]:
        return [
            cells(
                f"<code>{escape(name)}</code>",
                escape(str(old[name])) if name in old else DASH,
                escape(str(new[name])) if name in new else DASH,
            )
            for name in chosen
        ]

    table = rows_table(head, rows(changed)) if changed else "<p class=muted>None changed.</p>"
    same = [name for name in names if name not in changed]
    rest = details(f"{len(same)} as before", rows_table(head, rows(same)))
    return f"<h3>Parameters, versions, FMUs</h3>{table}{rest}"


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


__all__ = ["write_report"]
