"""The times of events in a run: grasp, lift, release and so on [s]."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..definition.criteria import HELD_FORCE, LIFTED
from ..recording import Recording

Array = NDArray[np.float64]
Events = dict[str, float | None]

SETTLING: Final = 0.5  # [s] from release to the measurement of the block's position
BLOCK_Z: Final = "plant.qpos[12]"
COMMAND: Final = ("controller.pos_cmd", "controller.quat_cmd")


def events(recording: Recording) -> Events:
    """Return the time of each event [s], or None if it did not happen.

    `start` and `end` are those of the recording. `grasp`: the fingers first press on the block.
    `lift`: it is first carried. `release`: the fingers last let go. `placed`: half a second later,
    when its position is measured. `at_rest`: the command stops moving.
    """
    time = recording.time
    ends = {"start": 0, "end": len(time) - 1}
    found: dict[str, int | None] = {
        **ends,
        **_of_the_block(recording),
        **_of_the_command(recording),
    }
    return {
        name: float(time[row]) if row is not None and 0 <= row < len(time) else None
        for name, row in found.items()
    }


def _of_the_block(recording: Recording) -> dict[str, int | None]:
    if "plant.contact_force" not in recording or BLOCK_Z not in recording or not recording.rows:
        return dict.fromkeys(("grasp", "lift", "release", "placed"))
    held = recording["plant.contact_force"] > HELD_FORCE
    height = recording[BLOCK_Z]
    carried = held & (height > height[0] + LIFTED)
    release = last_true(held)
    placed = None if release is None else placed_row(recording.time, release)
    return {
        "grasp": first_true(held),
        "lift": first_true(carried),
        "release": release,
        "placed": placed,
    }


def _of_the_command(recording: Recording) -> dict[str, int | None]:
    if any(name not in recording for name in COMMAND) or not recording.rows:
        return {"at_rest": None}
    moving = np.flatnonzero(moving_rows(recording))
    return {"at_rest": int(moving[-1]) if len(moving) else 0}


def moving_rows(recording: Recording) -> NDArray[np.bool_]:
    """Whether the command moves at each tick (n,)."""
    position, quaternion = (recording[name] for name in COMMAND)
    if not len(position):
        return np.zeros(0, dtype=bool)
    change = np.abs(np.diff(np.hstack((position, quaternion)), axis=0, append=np.nan)).max(axis=1)
    moved = np.nan_to_num(change) > 0.0
    moving: NDArray[np.bool_] = moved | np.roll(moved, 1)
    return moving


def placed_row(time: Array, release: int) -> int | None:
    """Row at which the block's position is measured, or None if the run ends before."""
    if release >= len(time):
        return None
    later = int(np.searchsorted(time, time[release] + SETTLING - 1e-9))
    return later if later < len(time) else None


def first_true(values: NDArray[np.bool_]) -> int | None:
    """Return the first row that holds, or None."""
    rows = np.flatnonzero(values)
    return int(rows[0]) if len(rows) else None


def last_true(values: NDArray[np.bool_]) -> int | None:
    """Return the row after the last one that holds, or None; it may be past the end."""
    rows = np.flatnonzero(values)
    return int(rows[-1]) + 1 if len(rows) else None


__all__ = ["HELD_FORCE", "LIFTED", "SETTLING", "Events", "events", "moving_rows"]
