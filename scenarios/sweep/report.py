"""One HTML page on a sweep's results. Beyond a few thousand rows, plots show a sample."""

from __future__ import annotations

import base64
import hashlib
import json
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

from ...fmus.interface.tables import INTERFACES
from ...fmus.messages import legible, printable, shown
from ...fmus.replacing import replacing
from ..view.export import VIEW_FILE
from .engine import count, worst
from .results import Results
from .row import margin_column
from .statistics import (
    Influence,
    Leaf,
    failure_tree,
    rank_correlations,
    share_bounds,
)
from .store import Store

Array = NDArray[np.float64]

REPORT_FILE: Final = "report.html"
PAGE: Final = Path(__file__).parent / "page"
WORST: Final = 20
POINTS: Final = 2000  # drawn one by one
BINS: Final = (6, 24)  # of a marginal: fewest and most
CELLS: Final = (5, 14)  # of a heat map, each way
IN_A_BIN: Final = 12  # least mean number of rows per bin
PAIRED: Final = 8  # keys in heat maps, the most influential
_DIGITS: Final = 5


def write_report(folder: str | Path, path: str | Path | None = None) -> Path:
    """Write the page about a sweep.

    Args:
        folder: Of the sweep.
        path: The page; None: report.html in the folder.

    Raises:
        InputError: There are no results, or it cannot be written.
    """
    store = Store(folder)
    path = store.folder / REPORT_FILE if path is None else Path(path)
    text = page(store, path.parent)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page(store: Store, beside: Path) -> str:
    """Return the page as HTML.

    Args:
        store: The sweep.
        beside: Folder of the page, which links are relative to.
    """
    results = Results.read(store)
    content = store.content
    definition = content["origin"]["definition"]
    influences = _influences(results)
    order = [each.key for each in influences["margin"]]
    script = (PAGE / "report.js").read_text(encoding="utf-8")
    total, good = len(results.bad), int((~results.bad).sum())
    low, high = share_bounds(good, total)
    environment = Environment(loader=FileSystemLoader(PAGE), autoescape=True, finalize=shown)
    return environment.get_template("report.html").render(
        title=f"Sweep of {', '.join(content['nominal'])}",
        script=Markup(script),  # noqa: S704 - our own
        digest=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        style=Markup((PAGE / "report.css").read_text(encoding="utf-8")),  # noqa: S704 - our own
        data=Markup(_json(_data(results, influences, order, definition))),  # noqa: S704 - escaped
        definition=definition,
        vary=content["origin"]["vary"],
        versions=content["origin"]["versions"],
        total=total,
        expected=_expected(content, total),
        good=good,
        low=low,
        high=high,
        counts=count(store),
        missed=results.missed,
        tree=_tree(results, order),
        influences=influences,
        worst=_worst(store, beside),
        shown=min(total, POINTS),
    )


def _expected(content: Mapping[str, Any], total: int) -> int:
    definition = content["origin"]["definition"]
    if definition["design"] in ("grid", "list"):
        return total
    return int(definition["samples"]) * len(definition["scenario"])


def _influences(results: Results) -> dict[str, list[Influence]]:
    """Return the influence of each varied value on each margin."""
    ordered = {key: v for key, v in results.values.items() if key not in results.labels}
    return {n: rank_correlations(ordered, m) for n, m in results.margins.items()}


def _tree(results: Results, order: Sequence[str]) -> list[Leaf]:
    keys = [*order, *(key for key in results.values if key not in order)]
    ordered = {key: results.values[key] for key in keys if key not in results.labels}
    return failure_tree(ordered, results.bad, {key: _unit(key) for key in ordered})[:6]


def _unit(key: str) -> str:
    """Return the unit of a parameter of our own FMUs; of another key, and of a bare number, ""."""
    instance, _, name = key.partition(".")
    interface = INTERFACES.get(instance)
    scalars = interface.scalars() if interface is not None else []
    found = next((s.unit for s in scalars if name in (s.name, s.variable.name)), "")
    return "" if found == "1" else found


def _worst(store: Store, beside: Path) -> list[dict[str, Any]]:
    keys = store.content["keys"]
    rows = worst(store, WORST, keys)
    for row in rows:
        run = store.run_folder(row["index"])
        pages = (store.folder / "shown" / f"{row['index']:07d}" / VIEW_FILE, run / VIEW_FILE)
        link = next((each for each in pages if each.exists()), None)
        row["view"] = None if link is None else _relative(link, beside)
        row["kept"] = run.exists()
        row["values"] = [row[key] for key in keys]
        # What is pasted into a shell must be one line that does what it says.
        row["command"] = _command(row["command"] or "")
        row["show"] = _command(f"panda-cosim sweep show {quote(str(store.folder))} {row['index']}")
    return rows


def _command(text: str) -> Markup:
    return escape(printable(text))  # never shortened


def _relative(path: Path, folder: Path) -> str:
    try:
        return "./" + quote_address(path.resolve().relative_to(folder.resolve()).as_posix())
    except ValueError:
        return path.resolve().as_uri()


def _data(
    results: Results,
    influences: Mapping[str, Sequence[Influence]],
    order: Sequence[str],
    definition: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what the page draws."""
    keys = [*order, *(key for key in results.values if key not in order)]
    chosen = _sample(results)
    axes = {key: results.values[key] for key in keys} | dict(results.margins)
    data = {
        "keys": keys,
        "labels": results.labels,
        "margins": list(results.margins),
        "points": {name: _rounded(column[chosen]) for name, column in axes.items()},
        "index": results.index[chosen].tolist(),
        "bad": results.bad[chosen].astype(int).tolist(),
        "total": len(results.bad),
        "marginals": {key: _marginal(results, key) for key in keys},
        "maps": [_map(results, *pair) for pair in combinations(keys[:PAIRED], 2)],
        "influences": {
            name: [[e.key, e.value, e.low, e.high] for e in each]
            for name, each in influences.items()
        },
        "search": None,
    }
    if definition["design"] == "search":
        data["search"] = _search(results, definition)
    return data


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


def _edges(column: Array, number: int) -> Array:
    low, high = float(column.min()), float(column.max())
    return np.linspace(low, high if high > low else low + 1.0, number + 1)


def _between(number: float, ends: tuple[int, int]) -> int:
    return int(min(max(number, ends[0]), ends[1]))


def _marginal(results: Results, key: str) -> dict[str, Any]:
    """Share of failures with its bounds, and the least margin, in bins of a value."""
    column = results.values[key]
    choices = len(results.labels.get(key, ()))
    wanted = _between(len(column) / IN_A_BIN, BINS)
    edges = np.arange(choices + 1) - 0.5 if choices else _edges(column, wanted)
    bins = np.clip(np.digitize(column, edges) - 1, 0, len(edges) - 2)
    rows = np.bincount(bins, minlength=len(edges) - 1)
    bad = np.bincount(bins, weights=results.bad, minlength=len(edges) - 1).astype(int)
    bounds = [share_bounds(int(k), int(n)) for k, n in zip(bad, rows, strict=True)]
    return {
        "edges": _rounded(edges),
        "rows": rows.tolist(),
        "bad": bad.tolist(),
        "low": [round(low, 4) for low, _ in bounds],
        "high": [round(high, 4) for _, high in bounds],
    }


def _map(results: Results, first: str, second: str) -> dict[str, Any]:
    """Rows and failures in the cells of two values."""
    x, y = results.values[first], results.values[second]
    wanted = _between(math.sqrt(len(x) / IN_A_BIN), CELLS)
    edges = [_edges(x, wanted), _edges(y, wanted)]
    rows, _, _ = np.histogram2d(x, y, edges)
    bad, _, _ = np.histogram2d(x, y, edges, weights=results.bad.astype(float))
    return {
        "keys": [first, second],
        "ends": [_rounded(each[[0, -1]]) for each in edges],
        "rows": rows.astype(int).ravel().tolist(),
        "bad": bad.astype(int).ravel().tolist(),
    }


def _search(results: Results, definition: Mapping[str, Any]) -> dict[str, Any]:
    """Return the searched margin by row, and the best up to each."""
    name = margin_column(definition["criterion"], results.margins)
    margin = np.nan_to_num(results.margins[name], nan=-1.0)
    reach = np.minimum if definition["goal"] == "fail" else np.maximum
    chosen = _evenly(np.arange(len(margin)), min(len(margin), POINTS))
    best = reach.accumulate(margin)
    return {"index": results.index[chosen].tolist(), "margin": _rounded(margin[chosen]),
            "best": _rounded(best[chosen]), "name": name}  # fmt: skip


def _json(value: Any) -> str:
    text = json.dumps(_seen(value), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028")


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


__all__ = ["REPORT_FILE", "write_report"]
