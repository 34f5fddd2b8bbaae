"""A resolved table as an FMI slave."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from ...assets import STEP_SIZE
from ...assets.franka import HOME_XPOS, HOME_XQUAT, OPENING_MAX
from ..interface.tables import TABLE_FILE, TRAJECTORY
from .base import Array, SharedSlave

NAMES: Final = tuple(name for v in TRAJECTORY.of("output") for name in v.names())
HOME: Final = (*HOME_XPOS, *HOME_XQUAT, *(0.0,) * 6, OPENING_MAX)
TIME_TOLERANCE: Final = 1e-9  # [s]


class TrajectorySlave(SharedSlave):
    """Plays a table of commands, a row per millisecond from t = 0 on; the last row stays."""

    interface = TRAJECTORY

    def __init__(self, resources: str = "", **arguments: Any) -> None:
        super().__init__(resources=resources, **arguments)
        path, self._built_in = Path(resources, TABLE_FILE), np.array([HOME])
        if path.is_file():  # read now: a host may remove the folder later
            self._built_in = np.frombuffer(path.read_bytes(), "<f8").reshape(-1, len(NAMES))

    def rebuild(self, start_time: float) -> None:
        """Read the table."""
        path = cast(str, self.parameter("table"))
        self._table = read_commands(Path(path)) if path else self._built_in
        self._tick = round(start_time / STEP_SIZE)
        self._show()

    def _show(self) -> None:
        self._outputs[:] = self._table[min(max(self._tick, 0), len(self._table) - 1)]

    def advance(self, count: int) -> None:
        """Go to a later row."""
        self._tick += count
        self._show()

    def get_state(self) -> bytes:
        """The row."""
        return str(self._tick).encode()

    def set_state(self, state: bytes) -> None:
        """Restore it."""
        self._tick = int(state)


def read_commands(path: Path) -> Array:
    """Read commands (n, 14) at 1 ms from t = 0 on: a CSV with `time` and the command inputs."""
    try:
        with path.open(encoding="utf-8") as file:
            header = [name.strip().strip('"') for name in file.readline().split(",")]
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ValueError(f"table: {path}: cannot be read: {error}") from error
    if header != ["time", *NAMES]:
        raise ValueError(f"table: {path}: line 1: columns {header}; must be time, {NAMES}")
    grid = np.arange(len(rows)) * STEP_SIZE
    on_time = np.allclose(rows[:, 0], grid, rtol=0.0, atol=TIME_TOLERANCE)
    if not rows.size or rows.shape[1] != len(header) or not np.isfinite(rows).all() or not on_time:
        raise ValueError(f"table: {path}: must be 15 finite numbers per {STEP_SIZE} s, from 0 on")
    return np.ascontiguousarray(rows[:, 1:])
