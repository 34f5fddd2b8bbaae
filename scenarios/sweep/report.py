"""One HTML page on a sweep's results. Beyond a few thousand rows, plots show a sample."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from shlex import quote
from typing import Any, Final
from urllib.parse import quote as quote_address

import numpy as np
from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup, escape
from numpy.typing import NDArray

from ...fmus.atomic import replacing
from ...fmus.interface.tables import INTERFACES
from ...fmus.messages import legible, printable, shown
from ..judging.definitions import DEFINITIONS
from ..view.export import VIEW_FILE
from ..view.page import json_text
from .definition import SAMPLED
from .results import Results, heat_map, marginal, missing
from .row import UNJUDGED, margin_column
from .statistics import failure_tree, influences, share_bounds
from .store import Store

REPORT_FILE: Final = "report.html"
PAGE: Final = Path(__file__).parent / "page"
WORST: Final = 20
POINTS: Final = 2000  # drawn one by one
DRAWN: Final = (-1.0, 1.0)  # margins beyond are drawn at these ends
PAIRED: Final = 8  # keys in heat maps, the most influential
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
    strengths = {
        name: influences(results.values, results.labels, each)
        for name, each in results.margins.items()
    }
    keys = list(dict.fromkeys((*(each.key for each in strengths["margin"]), *results.values)))
    values = {key: results.values[key] for key in keys}
    total, good = len(results.bad), int((~results.bad).sum())
    script = (PAGE / "report.js").read_text(encoding="utf-8")
    data = _data(results, keys, definition, bounds=has_bounds)
    if is_sample:
        data["influences"] = {
            name: [[e.key, e.value, *((e.low, e.high) if has_bounds else (None, None))]
                   for e in each]
            for name, each in strengths.items()
        }  # fmt: skip
    environment = Environment(loader=FileSystemLoader(PAGE), autoescape=True, finalize=shown)
    return environment.get_template(
        "report.html"
    ).render(
        title=f"Sweep of {', '.join(content['nominal'])}",
        script=Markup(script),  # noqa: S704 - our own
        digest=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        style=Markup((PAGE / "report.css").read_text(encoding="utf-8")),  # noqa: S704 - our own
        data=Markup(json_text(_seen(data))),  # noqa: S704 - escaped
        definition=definition,
        keys=list(results.values),
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
        tree=failure_tree(values, results.labels, results.bad, {k: _unit(k) for k in keys})[:6],
        worst=_worst(store, beside, list(results.values)),
        shown=min(total, POINTS),
        margin=_meaning("margin"),
    )


def _meaning(margin: str) -> str:
    """Return what a column of margins holds."""
    name = margin.partition(".")[2]
    what = f"margin of {name}" if name else DEFINITIONS[margin].what
    if name and (bounded := DEFINITIONS.get(f"success.{name}")):
        what += f": {bounded.what}"
    return (
        f"{what[:1].upper()}{what[1:]}. Not given if the run did not finish, or a criterion could "
        "not be measured."
    )


def _unit(key: str) -> str:
    """Return the unit of a parameter of our own FMUs; of another key, and of a bare number, ""."""
    instance, _, name = key.partition(".")
    interface = INTERFACES.get(instance)
    scalars = interface.scalars() if interface is not None else []
    unit = next((s.unit for s in scalars if name in (s.name, s.variable.name)), "")
    return "" if unit == "1" else unit


def _worst(store: Store, beside: Path, keys: Sequence[str]) -> list[dict[str, Any]]:
    rows = store.worst(WORST, store.content["keys"])
    for row in rows:
        shown_again = store.folder / "shown" / f"{row['index']:07d}" / VIEW_FILE
        pages = (shown_again, store.run_folder(row["index"]) / VIEW_FILE)
        row["view"] = next((_link(each, beside) for each in pages if each.exists()), None)
        row["values"] = [row[key] for key in keys]
        # What is pasted into a shell must be one line that does what it says.
        row["command"] = escape(printable(row["command"] or ""))  # never shortened
        show = f"panda-cosim sweep show {quote(str(store.folder))} {row['index']}"
        row["show"] = escape(printable(show))
    return rows


def _link(path: Path, folder: Path) -> str:
    try:
        return "./" + quote_address(path.resolve().relative_to(folder.resolve()).as_posix())
    except ValueError:
        return path.resolve().as_uri()


def _data(
    results: Results, keys: Sequence[str], definition: Mapping[str, Any], *, bounds: bool
) -> dict[str, Any]:
    """Return what the page draws."""
    chosen, pairs = _sample(results), combinations(keys[:PAIRED], 2)
    points = {key: results.values[key][chosen] for key in keys} | {
        name: np.clip(column[chosen], *DRAWN) for name, column in results.margins.items()
    }
    return {
        "keys": keys,
        "labels": results.labels,
        "margins": {name: _meaning(name) for name in results.margins},
        "points": {name: _rounded(column) for name, column in points.items()},
        "index": results.index[chosen].tolist(),
        "bad": results.bad[chosen].astype(int).tolist(),
        "total": len(results.bad),
        "marginals": {key: marginal(results, key, bounds=bounds) for key in keys},
        "maps": [heat_map(results, *pair) for pair in pairs],
        "influences": None,
        "search": _search(results, definition) if definition["design"] == "search" else None,
    }


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


def _search(results: Results, definition: Mapping[str, Any]) -> dict[str, Any]:
    """Return the searched margin by row, and the best up to each."""
    name = margin_column(definition["criterion"], results.margins)
    margin = np.clip(np.nan_to_num(results.margins[name], nan=-np.inf), *DRAWN)
    reach = np.minimum if definition["goal"] == "fail" else np.maximum
    chosen = _evenly(np.arange(len(margin)), min(len(margin), POINTS))
    best = reach.accumulate(margin)
    return {"index": results.index[chosen].tolist(), "margin": _rounded(margin[chosen]),
            "best": _rounded(best[chosen]), "name": name}  # fmt: skip


def _seen(value: Any) -> Any:
    """Return plain values with all texts in them as the page shows them."""
    match value:
        case str():
            return legible(value)
        case dict():
            return {_seen(key): _seen(each) for key, each in value.items()}
        case list() | tuple():
            return list(map(_seen, value))
        case _:
            return value
