"""Rows of the scenario's table at the instants of a run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...task.trajectory import TIME_TOLERANCE


def table_row(metadata: Mapping[str, object], time: float) -> int | None:
    """Return the row of the scenario's table that the hand is on its way to, or the last."""
    times = np.array(metadata.get("row_times", ()), dtype=float)
    return min(int(np.searchsorted(times, time - TIME_TOLERANCE)) + 1, len(times)) or None
