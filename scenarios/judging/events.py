"""The times of events in a run: grasp, lift, release and so on [s]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..recording import Recording
from .holds import Hold, last_release

Array = NDArray[np.float64]
Events = dict[str, float | None]

SETTLING: Final = 0.5  # [s] from release to the measurement of the block's position
RESTING: Final = 0.005  # [m/s] speed of the hand below which it rests
COMMAND: Final = ("controller.pos_cmd", "controller.quat_cmd")
HAND: Final = "plant.hand_xpos"


def events(recording: Recording, holds: Sequence[Hold]) -> Events:
    """Return the time of each event [s], or None if it did not happen; see `DEFINITIONS`."""
    time = recording.time
    released = last_release(holds, len(time))
    moving = moving_rows(recording)
    rows: dict[str, int | None] = {
        "start": 0,
        "grasp": holds[0].grasp if holds else None,
        "lift": next((hold.lift for hold in holds if hold.lift is not None), None),
        "release_command": released.release_command if released else None,
        "release": released.end if released else None,
        "placed": placed_row(time, holds),
        "command_end": int(moving[-1]) if len(moving) else None,
        "at_rest": _rest(time, recording[HAND]) if HAND in recording else None,
        "end": len(time) - 1,
    }
    return {
        name: float(time[row]) if row is not None and len(time) else None
        for name, row in rows.items()
    }


def placed_row(time: Array, holds: Sequence[Hold]) -> int | None:
    """Return the row half a second after the last release.

    None if the block is not released, the run ends before, or the block is held again by then.
    """
    released = last_release(holds, len(time))
    if released is None:
        return None
    row = int(np.searchsorted(time, time[released.end] + SETTLING - 1e-9))
    held = holds[-1] is not released and holds[-1].grasp <= row
    return row if row < len(time) and not held else None


def moving_rows(recording: Recording) -> NDArray[np.int64]:
    """Return the rows at which the command moves: both rows of each change."""
    if any(name not in recording for name in COMMAND):
        return np.zeros(0, dtype=np.int64)
    pose = np.hstack([recording[name] for name in COMMAND])
    changes = np.flatnonzero(np.abs(np.diff(pose, axis=0)).max(axis=1) > 0.0)
    return np.union1d(changes, changes + 1)


def _rest(time: Array, hand: Array) -> int | None:
    """Return the row from which on the hand rests, or None if it moves at the end."""
    speed = np.linalg.norm(np.diff(hand, axis=0), axis=1) / np.diff(time)
    fast = np.flatnonzero(~(speed < RESTING))
    row = int(fast[-1]) + 1 if len(fast) else 0
    return row if row < len(time) - 1 or not len(speed) else None


__all__ = ["SETTLING", "Events", "events", "moving_rows", "placed_row"]
