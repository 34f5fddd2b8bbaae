"""Fields of parameters, with units, ranges and choices, and of flat buffers."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # (n,)
Matrix = NDArray[np.float64]  # (m, n)
Layout = np.dtype[np.void]
Views = SimpleNamespace  # arrays by name


def bounded(default: Any, unit: str, low: float, high: float, part: float | None = None) -> Any:
    """Return the field of a number, or of several, between two; `part`: it is a multiple of it."""
    about = {"unit": unit, "range": (low, high), "multiple_of": part}
    return field(default=default, metadata=about)


def switch(default: bool | str, choices: Iterable[str] = ()) -> Any:
    """Return the field of a switch, or of one of several names."""
    return field(default=default, metadata={"choices": tuple(choices)})


def as_arrays(parameters: object) -> Any:
    """Return the fields by name, those of several joints or axes as arrays."""
    given = vars(parameters).items()
    return SimpleNamespace(**{k: np.array(v) if isinstance(v, tuple) else v for k, v in given})


def layouts(module: str) -> list[Layout]:
    """Return the layouts of flat buffers that the TOML file beside a module has."""
    tables = tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))
    return [np.dtype([*fields.items()]) for fields in tables.values()]


class Buffer:
    """A flat array (n,), `values`, with named fields of 64-bit floats.

    The fields share its memory: by name for users of the controller, `record["qpos"] = q`, and as
    attributes, `views.qpos[:] = q`. A scalar field is an array of shape ().
    """

    def __init__(self, layout: Layout, values: Vector | None = None) -> None:
        self.values = np.zeros(layout.itemsize // 8) if values is None else values
        rows = self.values.view(layout)
        self.record: Any = rows[0]
        self.views = _views(rows)


def _views(rows: NDArray[Any]) -> Views:
    """Return the fields of a structured array (1,) as attributes."""
    fields = {name: rows[name] for name in rows.dtype.names or ()}
    views = {k: _views(v) if v.dtype.names else v.squeeze(axis=0) for k, v in fields.items()}
    return SimpleNamespace(**views)
