"""Holds, the spans in which the fingers hold the block, and the other events.

The block's metrics, the shading of the plot and the labels of the view are made of them, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ...task.criteria import HELD_FORCE, LIFTED
from ..recording import Recording, by_rows

Events = dict[str, float | None]

FORCE: Final = "plant.contact_force"
BLOCK: Final = ("plant.qpos[10]", "plant.qpos[11]", "plant.qpos[12]")  # its centre
OPENING: Final = "controller.grip_cmd"
SETTLING: Final = 0.5  # [s] from release to the measurement of the block's position
RESTING: Final = 0.005  # [m/s] speed of the hand below which it rests
COMMAND: Final = ("controller.pos_cmd", "controller.quat_cmd")
HAND: Final = "plant.hand_xpos"
CONTACT: Final = tuple(f"controller.joint_contact[{i}]" for i in range(1, 8))
COLLISION: Final = 2.0  # of joint_contact
SHORT: Final = 0.05 - 1e-9  # [s] a shorter gap belongs to a hold, a shorter span is none


@dataclass(frozen=True)
class Hold:
    """One hold, in rows of the recording."""

    grasp: int  # its first row
    end: int  # the first row after it; the number of rows if it lasts to the end
    # At which the gripper is commanded to open; `end` if it is not; None: that is not recorded.
    release_command: int | None
    lift: int | None  # when the block is first more than LIFTED from its place at `grasp`

    @property
    def let_go(self) -> int:
        """The release command; where that is not recorded, the end."""
        return self.end if self.release_command is None else self.release_command

    @property
    def carried(self) -> slice:
        """Rows from lift to release command, both included; none without one of them."""
        if self.lift is None or self.release_command is None:
            return slice(0, 0)
        return slice(self.lift, min(self.release_command + 1, self.end))


def find_holds(recording: Recording) -> list[Hold]:
    """Return the holds of a run in order; none without contact force and position of the block."""
    if any(name not in recording for name in (FORCE, *BLOCK)):
        return []
    spans = _spans(recording.time, recording[FORCE])
    block = np.column_stack([recording[name] for name in BLOCK])
    opening = recording[OPENING] if OPENING in recording.columns else None
    return [_hold(block, opening, *span) for span in spans]


def _spans(time: Array, force: Array) -> list[tuple[int, int]]:
    """Return the first row of each hold, and the first after it."""
    edges = np.flatnonzero(np.diff(force > HELD_FORCE, prepend=False, append=False))
    begins, ends = edges[::2], edges[1::2]
    if not len(begins):
        return []
    length = np.append(time, time[-1:])[ends] - time[begins]
    # Fingers that open brush the block with short and weak touches; a heavy one that slips rattles.
    inside = np.repeat(length >= SHORT, ends - begins)
    firm = force[force > HELD_FORCE][inside].mean() if inside.any() else math.inf
    counts = (length >= SHORT) | (np.maximum.reduceat(force, begins) > firm)
    begins, ends = begins[counts], ends[counts]
    apart = time[begins[1:]] - time[ends[:-1]] >= SHORT
    first, last = np.append(True, apart)[: len(begins)], np.append(apart, True)[: len(begins)]
    spans = zip(begins[first].tolist(), ends[last].tolist(), strict=True)
    return [(a, b) for a, b in spans if time[min(b, len(time) - 1)] - time[a] >= SHORT]


def _hold(block: Array, opening: Array | None, grasp: int, end: int) -> Hold:
    release_command = None if opening is None else _release_command(opening, grasp, end)
    away = np.flatnonzero(np.linalg.norm(block[grasp:end] - block[grasp], axis=1) > LIFTED)
    return Hold(grasp, end, release_command, grasp + int(away[0]) if len(away) else None)


def _release_command(opening: Array, grasp: int, end: int) -> int:
    """Return the last row at which the opening begins to rise to stay above what it was."""
    # A grip that becomes weaker while the block is carried rises before, and does not let go.
    held = opening[grasp:end]
    rises = np.diff(held) > 0.0
    least_later = np.minimum.accumulate(held[::-1])[::-1][1:]
    begins = rises & ~np.append(False, rises)[: len(rises)] & (least_later > held[:-1])
    rows = np.flatnonzero(begins)
    return grasp + 1 + int(rows[-1]) if len(rows) else end


def last_release(holds: Sequence[Hold], rows: int) -> Hold | None:
    """Return the last hold that ended in a recording of so many rows, or None."""
    return next((hold for hold in reversed(holds) if hold.end < rows), None)


def events(recording: Recording, holds: Sequence[Hold]) -> Events:
    """Return the time of each event [s], or None if it did not happen; see `DEFINITIONS`."""
    time = recording.time
    released = last_release(holds, len(time))
    moving = np.flatnonzero(moving_rows(recording))
    rows: dict[str, int | None] = {
        "start": 0,
        "grasp": holds[0].grasp if holds else None,
        "lift": next((hold.lift for hold in holds if hold.lift is not None), None),
        "release_command": released.release_command if released else None,
        "release": released.end if released else None,
        "placed": placed_row(time, holds),
        "command_end": int(moving[-1]) if len(moving) else None,
        "at_rest": _rest(recording, len(time)) if HAND in recording else None,
        "end": len(time) - 1,
        "collision": first_collision(recording),
    }
    return {name: instant(time, row) for name, row in rows.items()}


def instant(time: Array, row: int | None) -> float | None:
    """Return the time of a row [s]; None if there is none."""
    return None if row is None or not 0 <= row < len(time) else float(time[row])


def first_collision(recording: Recording) -> int | None:
    """Return the row at which a joint first collides; None: none does, or it is not recorded."""
    if CONTACT[0] not in recording:
        return None
    collided = np.max([recording[name] for name in CONTACT], axis=0) == COLLISION
    return int(np.argmax(collided)) if collided.any() else None


def placed_row(time: Array, holds: Sequence[Hold]) -> int | None:
    """Return the row half a second after the last release."""
    # None if the block is not released, the run ends before, or the block is held again by then.
    released = last_release(holds, len(time))
    if released is None:
        return None
    row = int(np.searchsorted(time, time[released.end] + SETTLING - 1e-9))
    held = holds[-1] is not released and holds[-1].grasp <= row
    return row if row < len(time) and not held else None


def moving_rows(recording: Recording) -> NDArray[np.bool_]:
    """Return whether the command moves at each row: both rows of each change, if it is recorded."""
    moving = np.zeros(recording.rows, dtype=bool)
    if all(name in recording for name in COMMAND):

        def step(*pose: Array) -> Any:
            return np.abs(np.diff(np.hstack(pose), axis=0)).max(axis=1)

        moving[1:] = by_rows(recording, step, *COMMAND, before=1) > 0.0
        moving[:-1] |= moving[1:]
    return moving


def _rest(recording: Recording, rows: int) -> int | None:
    """Return the row from which on the hand rests, or None if it moves at the end."""

    def speed(time: Array, hand: Array) -> Any:
        return np.linalg.norm(np.diff(hand, axis=0), axis=1) / np.diff(time)

    fast = np.flatnonzero(~(by_rows(recording, speed, "time", HAND, before=1) < RESTING))
    row = int(fast[-1]) + 1 if len(fast) else 0
    return row if row < rows - 1 or rows <= 1 else None
