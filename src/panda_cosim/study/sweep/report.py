"""One HTML page on a sweep's results. Beyond a few thousand rows, plots show a sample.

A row can be run again: to show it in 3D beside the unvaried scenario, or as a scenario.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from shlex import quote
from typing import Any, Final
from urllib.parse import quote as quote_address

import numpy as np
from numpy.typing import NDArray

from ...fmus.atomic import cache_folder, replacing, temporary_folder
from ...fmus.errors import InputError, legible, printable
from ...fmus.interface.tables import INTERFACES
from ...result.judging.definitions import DEFINITIONS, Definition
from ...result.judging.summary import SUMMARY_FILE
from ...run.execution import run_scenario
from ...run.folder import SCENARIO_FOLDER, refuse_existing
from ...show.view.page import (
    TITLE,
    VIEW_FILE,
    data_element,
    document,
    rendered,
    shown_run,
    write_view,
)
from ...task.scenario import Scenario
from ..compare.reference import REFERENCE_FILE, Reference
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
    text = page(store, path.parent)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page(store: Store, beside: Path) -> str:
    """Return the page as HTML; links are relative to the folder that it stands in."""
    results, content = Results.read(store), store.content
    definition, lacking = content["origin"]["definition"], missing(store)
    is_sample = definition["design"] in SAMPLED
    has_bounds = is_sample and not lacking
    order = influences(results.values, results.labels, results.margins[MARGIN])
    keys = list(dict.fromkeys((*(each.key for each in order), *results.values)))
    total, good = len(results.bad), int((~results.bad).sum())
    data = _data(store, results, keys, beside, bounds=has_bounds)
    if is_sample:
        data["influences"] = dict(_influences(store, results, bounds=has_bounds))
    title = f"Sweep of {', '.join(content['nominal'])}"
    body = rendered(
        TEMPLATE,
        title=title,
        definition=definition,
        versions=content["origin"]["versions"],
        lacking=lacking,
        total=total,
        good=good,
        beyond=store.beyond_limits(),
        is_sample=is_sample,
        interval=share_bounds(good, total) if has_bounds else None,
        counts=store.count(),
        unjudged=UNJUDGED,
        idle=content["without_effect"],
        missed=results.missed,
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
    instance, _, name = key.partition(".")
    if re.fullmatch(r"push\[\d+\]\.force\[\d\]", key):
        return "N"
    interface = INTERFACES.get(instance)
    scalars = interface.scalars() if interface is not None else []
    unit = next((s.unit for s in scalars if name in (s.name, s.variable.name)), "")
    return "" if unit == "1" else unit


def _rows(
    store: Store, chosen: NDArray[np.int64], worst: Sequence[int], beside: Path
) -> dict[str, Any]:
    """Return how the drawn rows ended, what repeats them, and links to them in 3D."""
    content = store.content
    keys, given = content["keys"], content["origin"]["definition"]["scenario"]
    names = dict(zip(content["nominal"], given, strict=True))
    rows = store.rows(chosen.tolist(), ["status", "missed", "error", "scenario", *keys])
    views = {}
    for index in chosen.tolist():
        run = store.run_folder(index)
        if index in worst and (run / SUMMARY_FILE).exists() and not (run / VIEW_FILE).exists():
            write_view([shown_run(run, name=f"row {index}")], run / VIEW_FILE)
        pages = (store.folder / "shown" / run.name / VIEW_FILE, run / VIEW_FILE)
        if page := next((each.resolve() for each in pages if each.exists()), None):
            inside = page.is_relative_to(top := beside.resolve())
            views[str(index)] = (
                f"./{quote_address(page.relative_to(top).as_posix())}" if inside else page.as_uri()
            )
    return {
        "results": [row["missed"] or row["status"] for row in rows],
        "errors": [row["error"] for row in rows],
        # What is pasted into a shell must be one line that does what it says. So it is made here,
        # and not taken from the table, which others may have written.
        "commands": [
            printable(command(names[row["scenario"]], {key: row[key] for key in keys}))
            for row in rows
        ],
        "show": printable(f"panda-cosim sweep show {quote(str(store.folder))}"),
        "views": views,
    }


def _data(
    store: Store, results: Results, keys: Sequence[str], beside: Path, *, bounds: bool
) -> dict[str, Any]:
    """Return what the page draws."""
    definition = store.content["origin"]["definition"]
    first, *others = store.content["nominal"].values()
    worst = [row["index"] for row in store.worst(OPENED, ())]
    chosen = np.union1d(_sample(results), np.flatnonzero(np.isin(results.index, worst)))
    return {
        "keys": keys,
        "labels": results.labels,
        "metrics": {name: _metric(name) for name in (*results.margins, *results.metrics)},
        "units": {key: _unit(key) for key in keys},
        "points": {name: _rounded(c) for name, c in _columns(store, results, keys, chosen)},
        "index": results.index[chosen].tolist(),
        "bad": results.bad[chosen].astype(int).tolist(),
        "total": len(results.bad),
        "marginals": {key: marginal(results, key, bounds=bounds) for key in keys},
        "maps": [heat_map(results, *pair) for pair in combinations(keys[:PAIRED], 2)],
        "isGrid": results.is_grid,
        "nominal": {k: v for k, v in first.items() if isinstance(v, float) and not others},
        "influences": None,
        "search": definition["design"] == "search" and definition["goal"],
        "searched": margin_column(definition["criterion"], results.margins),
        **_rows(store, results.index[chosen], worst, beside),
    }


def _columns(
    store: Store, results: Results, keys: Sequence[str], rows: NDArray[np.intp]
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield values, margins and metrics of some rows (n,) by name, each (n,)."""
    yield from ((key, results.values[key][rows]) for key in keys)
    yield from ((name, margin[rows]) for name, margin in results.margins.items())
    table = store.table([*results.metrics, "index"], results.index[rows].tolist())
    yield from ((name, table[name].to_numpy()) for name in results.metrics)


def _influences(
    store: Store, results: Results, *, bounds: bool
) -> Iterator[tuple[str, list[tuple[Any, ...]]]]:
    """Yield the influences on each margin and metric: key, value and its bounds."""
    rows = _evenly(np.arange(len(results.bad)), min(len(results.bad), ESTIMATED))
    values = {key: column[rows] for key, column in results.values.items()}
    for name, column in _columns(store, results, (), rows):
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


def scenario_of(store: Store, index: int) -> tuple[int, Scenario, Scenario]:
    """Return which scenario a row is of, and that scenario as swept, unvaried and varied."""
    content = store.content
    row = store.row(index)
    number = list(content["nominal"]).index(row["scenario"])
    nominal = store.kept(number)
    return number, nominal, nominal.changed({key: row[key] for key in content["keys"]})


def show_row(folder: str | Path, index: int) -> Path:
    """Run a row of a sweep and its unvaried scenario, unless done before, for a 3D view."""
    store = Store(folder)
    number, nominal, changed = scenario_of(store, index)
    place = store.folder / "shown"
    row_folder = store.run_folder(index)
    if not (row_folder / SUMMARY_FILE).exists():
        row_folder = _run(changed, place / f"{index:07d}")
    nominal_folder = _run(nominal, place / f"nominal-{number}")
    runs = [
        shown_run(row_folder, name=f"row {index}"),
        shown_run(nominal_folder, name=f"{nominal.name} unvaried"),
    ]
    return write_view(runs, place / f"{index:07d}" / VIEW_FILE)


def _run(scenario: Scenario, folder: Path) -> Path:
    if not (folder / SUMMARY_FILE).exists():
        shutil.rmtree(folder, ignore_errors=True)  # leftovers of a killed call
        run_scenario(scenario, folder)
    return folder


def promote_row(
    folder: str | Path, index: int, new: str | Path, *, known_limit: bool = False
) -> list[Path]:
    """Make a scenario of a row in a new folder; return its files."""
    # A row with success gets a reference. One without fails in `regress`, by its criteria, until it
    # is mended; a known limit expects the failure instead, and has a reference of it.
    store, new = Store(folder), Path(new)
    _, _, changed = scenario_of(store, index)
    refuse_existing(new)
    row = store.row(index)
    promoted = replace(changed, **_keys(row, known_limit), name=new.resolve().name)
    with temporary_folder(cache_folder()) as scratch:
        run = run_scenario(promoted, scratch / "run")
        kept = run.folder / SCENARIO_FOLDER  # with the files of its own FMUs
        shutil.copytree(kept, new, dirs_exist_ok=True)
        if run.summary.as_expected:
            reference = Reference.of(run.recording, run.summary, promoted.regression)
            with replacing(new / REFERENCE_FILE) as path:
                reference.write(path, run.recording)
    return sorted(new.iterdir())


def _keys(row: Mapping[str, Any], known_limit: bool) -> dict[str, Any]:
    """Return the key `purpose` and, for a known limit, those that expect the failure."""
    index, status = row["index"], row["status"]
    if status == "unmeasured":
        raise InputError(f"row {index}: {row['error']}; must have a verdict")
    keys: dict[str, Any] = {"purpose": f"Row {index} of a sweep of {row['scenario']}"}
    if known_limit:
        if status != "missed":
            raise InputError(f"--expect failure: row {index}: status {status}; must be missed")
        reason = f"found by a sweep: {row['missed']} is missed"
        keys |= {"expect": "failure", "expect_reason": reason}
    return keys
