"""The columns of a sweep's table that its report needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from .store import Store

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Results:
    """The columns that the page needs.

    Attributes:
        values: Varied values by key (n,); choices of text as their numbers.
        labels: Text of such choices, by key.
        margins: By column name (n,).
        bad: Whether each row failed or missed a criterion (n,).
        index: Of the rows (n,).
        missed: Number of rows by first missed criterion, or by status where none was judged.
    """

    values: Mapping[str, Array]
    labels: Mapping[str, list[str]]
    margins: Mapping[str, Array]
    bad: NDArray[np.bool_]
    index: NDArray[np.int64]
    missed: Mapping[str, int]

    @classmethod
    def read(cls, store: Store) -> Results:
        """Read them."""
        content = store.content
        names = [name for name in content["columns"] if name.split(".")[0] == "margin"]
        keys = content["keys"] + (["scenario"] if len(content["nominal"]) > 1 else [])
        table = store.table([*keys, *names, "status", "missed", "index"])
        values, labels = {}, {}
        for key in keys:
            values[key], labels[key] = _numbers(table[key])
            if not np.isfinite(values[key]).all():
                raise InputError(f"{store.results}: column {excerpt(key)} is not finite in a row")
        missed = table.group_by(["status", "missed"]).aggregate([([], "count_all")]).to_pylist()
        counted = {
            each["missed"] or each["status"]: each["count_all"]
            for each in missed
            if each["status"] != "success"
        }
        return cls(
            values,
            {key: each for key, each in labels.items() if each},
            {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in names},
            np.asarray(table["status"].to_numpy() != "success", dtype=bool),
            table["index"].to_numpy(),
            dict(sorted(counted.items(), key=lambda each: -each[1])),
        )


def _numbers(column: Any) -> tuple[Array, list[str]]:
    """Return a column as numbers, and what they stand for if it is text or switches."""
    kind = str(column.type)
    if kind == "double":
        return np.asarray(column.to_numpy(), dtype=np.float64), []
    coded = column.combine_chunks().cast("string").dictionary_encode()
    return coded.indices.to_numpy().astype(np.float64), coded.dictionary.to_pylist()


__all__ = ["Results"]
