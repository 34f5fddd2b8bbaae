"""Fields of the classes of parameters: their units, ranges and choices."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field
from types import SimpleNamespace
from typing import Any

import numpy as np


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
