"""One HTML page on a sweep's results. Beyond a few thousand rows, plots show a sample."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from shlex import quote
from typing import Any, Final
from urllib.parse import quote as quote_address

import numpy as np
from numpy.typing import NDArray

from ...fmus.atomic import write_whole
from ...fmus.errors import legible, printable
from ...result.judging.definitions import DEFINITIONS, Definition
from ...result.judging.summary import SUMMARY_FILE
from ...result.view.page import (
    TITLE,
    VIEW_FILE,
    data_element,
    document,
    rendered,
    shown_run,
    write_view,
)
from ..compare.wording import unit_of
from .definition import SAMPLED
from .results import Results, heat_map, influences, marginal, missing, share_bounds
from .row import MARGIN, UNJUDGED, command, margin_column
from .store import Store

REPORT_FILE: Final = "report.html"
TEMPLATE: Final = Path(__file__).with_name("report.html")
OPENED: Final = 20  # kept rows whose 3D page is written with the report, the worst
POINTS: Final = 4000  # drawn one by one
ESTIMATED: Final = 10_000  # rows of which the influence on a metric is estimated
PAIRED: Final = 8  # keys in maps, the most influential
_DIGITS: Final = 5


def write_report(folder: str | Path, path: str | Path | None = None) -> Path:
    """Write the page about the sweep in a folder; by default, report.html there."""
    store = Store(folder)
    path = store.folder / REPORT_FILE if path is None else Path(path)
    write_whole(path, page(store, path.parent))
    return path


def page(store: Store, beside: Path) -> str:
    """Return the page as HTML; links are relative to the folder that it stands in."""
    results, content = Results(store), store.content
    definition, lacking = content.origin["definition"], missing(store)
    is_sample = definition["design"] in SAMPLED
    has_bounds = is_sample and not lacking
    order = influences(results.values, results.labels, results.margins[MARGIN])
    keys = list(dict.fromkeys((*(each.key for each in order), *results.values)))
    total, good = len(results.bad), int((~results.bad).sum())
    data = _data(results, keys, beside, bounds=has_bounds)
    if is_sample:
        data["influences"] = dict(_influences(results, bounds=has_bounds))
    title = f"Sweep of {', '.join(content.nominal)}"
    body = rendered(
        TEMPLATE,
        title=title,
        results=results,
        lacking=lacking,
        total=total,
        good=good,
        beyond=store.beyond_limits(),
        is_sample=is_sample,
        interval=share_bounds(good, total) if has_bounds else None,
        counts=store.count(),
        unjudged=UNJUDGED,
        shown=len(data["index"]),
        estimated=ESTIMATED,
    )
    return document(legible(title, TITLE), body, data_element("sweep", data), ["sweep"])


def _metric(column: str) -> dict[str, str]:
    """Return what a column of the table holds, its unit, and whether lower or higher is better."""
    name = column.removeprefix("summary.").replace("event.", "events.", 1).partition("[")[0]
    means = DEFINITIONS.get(name.replace("margin.", "success.", 1), Definition(name, ""))
    return {"what": means.text, "unit": means.unit.removeprefix("1"), "better": means.better}


def _unit(key: str) -> str:
    """Return the unit of a parameter of our own FMUs or a push; of another key, and of 1, ""."""
    return "N" if re.fullmatch(r"push\[\d+\]\.force\[\d\]", key) else unit_of(key)


def _rows(results: Results, chosen: list[int]) -> dict[str, object]:
    """Return how the drawn rows ended, and what repeats them."""
    store, content = results.store, results.content
    names = dict(zip(content.nominal, content.origin["definition"]["scenario"], strict=True))
    rows = store.rows(chosen, ["status", "missed", "error", "scenario", *content.keys])
    # What is pasted into a shell must be one line that does what it says. So it is made here, and
    # not taken from the table, which others may have written.
    commands = (command(names[r["scenario"]], {key: r[key] for key in content.keys}) for r in rows)
    return {
        "results": [row["missed"] or row["status"] for row in rows],
        "errors": [row["error"] for row in rows],
        "commands": [*map(printable, commands)],
        "show": printable(f"panda-cosim sweep show {quote(str(store.folder))}"),
    }


def _views(store: Store, worst: Sequence[int], chosen: list[int], beside: Path) -> dict[str, str]:
    """Return links to rows in 3D, with pages of the worst ones that are kept."""
    views, top = {}, beside.resolve()
    for index in worst:
        run = store.run_folder(index)
        if (run / SUMMARY_FILE).exists() and not (run / VIEW_FILE).exists():
            write_view([shown_run(run, name=f"row {index}")], run / VIEW_FILE)
    for index in chosen:
        run = store.run_folder(index)
        pages = (store.folder / "shown" / run.name / VIEW_FILE, run / VIEW_FILE)
        if page := next((each.resolve() for each in pages if each.exists()), None):
            inside = page.is_relative_to(top)
            place = f"./{quote_address(page.relative_to(top).as_posix())}" if inside else ""
            views[str(index)] = place or page.as_uri()
    return views


def _data(results: Results, keys: Sequence[str], beside: Path, *, bounds: bool) -> dict[str, Any]:
    """Return what the page draws."""
    definition = results.content.origin["definition"]
    first, *others = results.content.nominal.values()
    worst = [row["index"] for row in results.store.worst(OPENED, ())]
    chosen = np.union1d(_sample(results), np.flatnonzero(np.isin(results.index, worst)))
    indices = results.index[chosen].tolist()
    return {
        "keys": keys,
        "labels": results.labels,
        "metrics": {name: _metric(name) for name in (*results.margins, *results.metrics)},
        "units": {key: _unit(key) for key in keys},
        "points": {name: _rounded(c) for name, c in results.columns(keys, chosen)},
        "index": indices,
        "bad": results.bad[chosen].astype(int).tolist(),
        "total": len(results.bad),
        "marginals": {key: marginal(results, key, bounds=bounds) for key in keys},
        "maps": [heat_map(results, *pair) for pair in combinations(keys[:PAIRED], 2)],
        "isGrid": results.is_grid,
        "nominal": {k: v for k, v in first.items() if isinstance(v, float) and not others},
        "influences": None,
        "search": definition["design"] == "search" and definition["goal"],
        "searched": margin_column(definition["criterion"], results.margins),
        "views": _views(results.store, worst, indices, beside),
        **_rows(results, indices),
    }


def _influences(results: Results, *, bounds: bool) -> Iterator[tuple[str, list[tuple[Any, ...]]]]:
    """Yield the influences on each margin and metric: key, value and its bounds."""
    rows = _evenly(np.arange(len(results.bad)), min(len(results.bad), ESTIMATED))
    values = {key: column[rows] for key, column in results.values.items()}
    for name, column in results.columns((), rows):
        each = influences(values, results.labels, column)
        yield name, [(e.key, e.value, *((e.low, e.high) if bounds else (None, None))) for e in each]


def _sample(results: Results) -> NDArray[np.intp]:
    """Choose rows to draw: evenly, but half of them failures if there are so many."""
    if len(results.bad) <= POINTS:
        return np.arange(len(results.bad))
    bad, good = np.flatnonzero(results.bad), np.flatnonzero(~results.bad)
    few = min(len(bad), max(POINTS // 2, POINTS - len(good)))
    return np.sort(np.concatenate((_evenly(bad, few), _evenly(good, POINTS - few))))


def _evenly(rows: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    return rows[np.linspace(0, len(rows) - 1, number).astype(int)] if number else rows[:0]


def _rounded(column: NDArray[Any]) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if math.isfinite(v) else None for v in column.tolist()]
