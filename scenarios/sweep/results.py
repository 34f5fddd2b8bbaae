"""The columns of a sweep's table that its report needs, and what the table lacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from .definition import MAX_SAMPLES
from .distribution import Distribution
from .row import MARGIN
from .statistics import number_text
from .store import Store

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Results:
    """The columns that the page needs, each of all rows (n,).

    A margin is -inf if the row did not finish, or it could not be measured, and NaN if the row's
    scenario has no such criterion.
    """

    values: Mapping[str, Array]  # varied, by key; words as their numbers in `labels`
    labels: Mapping[str, list[str]]  # words by key, the scenarios' names among them
    margins: Mapping[str, Array]  # by column
    bad: NDArray[np.bool_]  # failed, or missed a criterion
    index: NDArray[np.int64]
    missed: Mapping[str, int]  # number of rows by first missed criterion

    @classmethod
    def read(cls, store: Store) -> Results:
        """Read them."""
        content = store.content
        names = [name for name in content["columns"] if name.split(".")[0] == MARGIN]
        keys = content["keys"] + (["scenario"] if len(content["nominal"]) > 1 else [])
        table = store.table(list({*keys, *names, "status", "missed", "index", "scenario"}))
        values, labels = {}, {}
        for key in keys:
            values[key], labels[key] = _numbers(table[key])
            if not np.isfinite(values[key]).all():
                raise InputError(f"{store.results}: column {excerpt(key)} is not finite in a row")
        counted = table.group_by(["status", "missed"]).aggregate([([], "count_all")]).to_pylist()
        missed = {each["missed"]: each["count_all"] for each in counted
                  if each["status"] == "missed" and each["missed"]}  # fmt: skip
        return cls(
            values,
            {key: each for key, each in labels.items() if each},
            {name: _margins(table, name, content) for name in names},
            np.asarray(table["status"].to_numpy() != "success", dtype=bool),
            table["index"].to_numpy(),
            dict(sorted(missed.items(), key=lambda each: -each[1])),
        )


def _numbers(column: Any) -> tuple[Array, list[str]]:
    """Return a column as numbers, and what they stand for if it is text or switches."""
    if str(column.type) == "double":
        return np.asarray(column.to_numpy(), dtype=np.float64), []
    if column.null_count:
        return np.full(len(column), np.nan), []
    coded = column.combine_chunks().cast("string").dictionary_encode()
    words, places = np.unique(coded.dictionary.to_pylist(), return_inverse=True)
    return places[coded.indices.to_numpy()].astype(np.float64), words.tolist()


def _margins(table: Any, name: str, content: Mapping[str, Any]) -> Array:
    column = np.asarray(table[name].to_numpy(), dtype=np.float64)
    column = np.where(np.isnan(column), -np.inf, column)
    nominal = content["nominal"]
    if len(nominal) > 1:  # a criterion may be one scenario's only
        others = [s for s, row in nominal.items() if not _has(name, row)]
        column[np.isin(table["scenario"].to_numpy(), others)] = np.nan
    elif not _has(name, content["columns"]):
        column[:] = np.nan
    return column


def _has(margin: str, columns: Any) -> bool:
    if margin != MARGIN:
        return margin in columns
    return any(name.startswith(f"{MARGIN}.") for name in columns)


def missing(store: Store) -> list[str]:
    """Say which rows an unfinished sweep lacks; nothing if it is complete."""
    content = store.content
    rows, index = content["rows"], store.table(["index"])["index"].to_numpy()
    try:
        if not len(index) <= rows <= MAX_SAMPLES * len(content["nominal"]):
            raise ValueError(f"rows: value {rows}")
        absent = np.setdiff1d(np.arange(rows), index)
        if not len(absent):
            return []
        is_whole = absent[-1] - absent[0] + 1 == len(absent)
        span = f"{'' if is_whole else 'among '}rows {absent[0]} to {absent[-1]}"
        return [f"{len(absent)} of {rows} rows are missing: {span}.", *_lost(absent, content)]
    except (LookupError, TypeError, ValueError) as error:
        raise InputError(f"{store.folder}: sweep.json does not fit its rows: {error}") from None


def _lost(absent: NDArray[np.int64], content: Mapping[str, Any]) -> Iterator[str]:
    """Say of which scenarios, and of which values of a grid, there are no rows at all."""
    rows, origin = content["rows"], content["origin"]
    axes: dict[str, Sequence[Any]] = {"scenario": list(content["nominal"])}
    if origin["definition"]["design"] == "grid":
        axes |= {key: _axis(each, rows) for key, each in origin["vary"].items()}
    else:
        axes[""] = range(rows // len(axes["scenario"]))
    places = np.unravel_index(absent, [len(axis) for axis in axes.values()])
    for (key, axis), place in zip(axes.items(), places, strict=True):
        lost = np.flatnonzero(np.bincount(place, minlength=len(axis)) == rows // len(axis))
        if key and 0 < len(lost) < len(axis):
            yield f"No row has {key} = {_span(lost, axis)}."


def _axis(distribution: Mapping[str, Any], rows: int) -> list[Any]:
    drawn = Distribution(**distribution)
    if not drawn.values and drawn.steps > rows:
        raise ValueError(f"steps: value {drawn.steps}")
    return list(drawn.grid())


def _span(places: NDArray[np.intp], axis: Sequence[Any]) -> str:
    names = value_names(axis)
    if len(places) > 2 and not isinstance(axis[0], str) and np.ptp(places) < len(places):
        return f"{names[places[0]]} to {names[places[-1]]}"
    return ", ".join(names[place] for place in places)


def value_names(values: Sequence[Any] | Array) -> list[str]:
    """Return values as text, numbers in as few digits, three at least, as tell them apart."""
    if not all(isinstance(value, float) for value in values):
        return [str(value).lower() if isinstance(value, bool) else str(value) for value in values]
    for digits in range(3, 18):
        names = [number_text(float(f"{value:.{digits}g}")) for value in values]
        if len(set(names)) == len(names):
            break
    return names
