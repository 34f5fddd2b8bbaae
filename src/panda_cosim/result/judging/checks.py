"""The conditions of the real robot's interface, and what helps: the rows of checks.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ...task.trajectory import TIME_TOLERANCE

ARMS: Final = {"fer": "panda", "fr3": "fr3"}  # as the key `robot` of a scenario has them
_TABLES: Final = tomllib.loads(Path(__file__).with_name("checks.toml").read_text(encoding="utf-8"))
REMEDIES: Final[Mapping[str, str]] = _TABLES.pop("remedies")
SIGNALS: Final[Mapping[str, list[str]]] = _TABLES.pop("signals")


@dataclass(frozen=True)
class Check:
    """One condition of the interface; checks.toml says what the fields are."""

    interface: str
    error: str
    what: str
    unit: str
    remedy: str  # its name in `REMEDIES`
    necessary: bool = True
    limit: str = "the limit"


# By the key of their largest share in summary.json.
CHECKS: Final[Mapping[str, Check]] = {key: Check(**entry) for key, entry in _TABLES.items()}


def table_row(metadata: Mapping[str, object], time: float) -> int | None:
    """Return the row of the scenario's table that the hand is on its way to, or the last."""
    times = np.array(metadata.get("row_times", ()), dtype=float)
    return min(int(np.searchsorted(times, time - TIME_TOLERANCE)) + 1, len(times)) or None
