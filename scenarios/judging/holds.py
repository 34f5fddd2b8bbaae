"""Holds: the spans in which the fingers hold the block, and what it does in them.

The metrics, the events, the shading of the plot and the labels of the view are all made of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from ..definition.criteria import HELD_FORCE, LIFTED

Array = NDArray[np.float64]

FORCE: Final = "plant.contact_force"
BLOCK: Final = ("plant.qpos[10]", "plant.qpos[11]", "plant.qpos[12]")  # its centre
OPENING: Final = "controller.grip_cmd"
SHORT: Final = 0.05 - 1e-9  # [s] a shorter gap belongs to a hold, a shorter span is none


class Rows(Protocol):
    """What is read of a recording."""

    @property
    def time(self) -> Array:
        """Instants of the rows (n,) [s]."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of all columns."""

    def __getitem__(self, name: str) -> Array:
        """A column's values (n,)."""


@dataclass(frozen=True)
class Hold:
    """One hold, in rows of the recording.

    Attributes:
        grasp: Its first row.
        end: The first row after it; the number of rows if it lasts to the end.
        release_command: Row at which the gripper is told to let go; `end` if it is not told.
        lift: Row at which the block is first more than `LIFTED` from where it was at `grasp`, at
            the release command at the latest; None: it stays.
    """

    grasp: int
    end: int
    release_command: int
    lift: int | None

    @property
    def carried(self) -> slice:
        """Rows from lift to release command, both included; none without a lift."""
        if self.lift is None:
            return slice(0, 0)
        return slice(self.lift, min(self.release_command + 1, self.end))


def find_holds(recording: Rows) -> list[Hold]:
    """Return the holds of a run in order; none without contact force and position of the block."""
    columns = frozenset(recording.columns)
    if not {FORCE, *BLOCK} <= columns:
        return []
    spans = _spans(recording.time, recording[FORCE] > HELD_FORCE)
    if not spans:
        return []
    block = np.column_stack([recording[name] for name in BLOCK])
    opening = recording[OPENING] if OPENING in columns else np.zeros(len(block))
    return [_hold(block, opening, *span) for span in spans]


def _spans(time: Array, pressed: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first row of each hold, and the first after it."""
    edges = np.flatnonzero(np.diff(pressed, prepend=False, append=False))
    begins, ends = edges[::2], edges[1::2]
    apart = time[begins[1:]] - time[ends[:-1]] >= SHORT
    first, last = np.append(True, apart)[: len(begins)], np.append(apart, True)[: len(begins)]
    spans = zip(begins[first].tolist(), ends[last].tolist(), strict=True)
    return [(a, b) for a, b in spans if time[min(b, len(time) - 1)] - time[a] >= SHORT]


def _hold(block: Array, opening: Array, grasp: int, end: int) -> Hold:
    release_command = _release_command(opening, grasp, end)
    way = np.linalg.norm(block[grasp : min(release_command + 1, end)] - block[grasp], axis=1)
    away = np.flatnonzero(way > LIFTED)
    return Hold(grasp, end, release_command, grasp + int(away[0]) if len(away) else None)


def _release_command(opening: Array, grasp: int, end: int) -> int:
    """Return the last row at which the opening begins to rise to stay above what it was.

    A grip that becomes weaker while the block is carried rises before, and does not let go.
    """
    held = opening[grasp:end]
    rises = np.diff(held) > 0.0
    least_later = np.minimum.accumulate(held[::-1])[::-1][1:]
    begins = rises & ~np.append(False, rises)[: len(rises)] & (least_later > held[:-1])
    rows = np.flatnonzero(begins)
    return grasp + 1 + int(rows[-1]) if len(rows) else end


def last_release(found: Sequence[Hold], rows: int) -> Hold | None:
    """Return the last hold that ended, or None.

    Args:
        found: The holds.
        rows: Number of rows of the recording.
    """
    return next((hold for hold in reversed(found) if hold.end < rows), None)


__all__ = ["Hold", "find_holds", "last_release"]
