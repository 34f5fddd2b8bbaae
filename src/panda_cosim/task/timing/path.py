"""The hand's path between two stops, without times.

Straight lines between rows, with corners rounded if allowed. A place on it is the length s [m] from
its start. Where the hand turns more than it moves, the rotation counts, with `TURN_LENGTH` metres
per radian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from .. import rotations
from ..trajectory import Trajectory, turns

TURN_LENGTH = 0.25  # [m/rad]
STILL = 1e-9  # [m] shorter segments are dwells


@dataclass(frozen=True, eq=False)
class Motion:
    """The path from one stop to the next, through rows whose corners are rounded."""

    rows: NDArray[np.intp]  # indices of its rows, both stops included (n,)
    places: Array  # of the rows on the path, from 0 (n,) [m]
    positions: Array  # of the hand at the rows, world (n, 3) [m]
    orientations: Array  # hand to world at the rows, (w, x, y, z) (n, 4)
    blends: Array  # distance within which a corner is rounded (n,) [m]; 0 at both ends

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.places[-1])

    def passed(self, places: Array) -> NDArray[np.intp]:
        """Return the row (m,) passed last at places (m,)."""
        return self.rows[np.searchsorted(self.places, places + STILL, side="right") - 1]

    def poses(self, places: Array) -> Array:
        """Return position and orientation at places (m,) on the path, shape (m, 7)."""
        row = np.clip(np.searchsorted(self.places, places, side="right") - 1, 0, len(self.rows) - 2)
        poses = self._from_row(row, places - self.places[row], row)
        for corner in np.flatnonzero(self.blends > 0.0):
            near = np.abs(places - self.places[corner]) < self.blends[corner]
            poses[near] = self._rounded(int(corner), places[near])
        return poses

    def _from_row(self, row: NDArray[np.intp], way: Array, segment: NDArray[np.intp]) -> Array:
        """Return the poses at distances (m,) [m] from rows along segments; negative: backwards."""
        share = (way / np.diff(self.places)[segment])[:, None]
        turn = rotations.exp(share * turns(self.orientations)[segment])
        position = self.positions[row] + share * np.diff(self.positions, axis=0)[segment]
        return np.hstack((position, rotations.multiply(turn, self.orientations[row])))

    def _rounded(self, corner: int, places: Array) -> Array:
        """Return the poses on a rounded corner, a blend from one line to the next.

        With u from 0 to 1 over the corner, the length along a line is b h(u), h = 2 u^3 - u^4: the
        curve joins the lines in its first two derivatives.
        """
        blend = self.blends[corner]
        u = 0.5 * ((places - self.places[corner]) / blend + 1.0)
        at = np.full(len(u), corner)
        before = self._from_row(at, -blend * _fade(1.0 - u), at - 1)
        after = self._from_row(at, blend * _fade(u), at)
        own = self.orientations[corner]
        turn = rotations.multiply(after[:, 3:], rotations.conjugate(own[None, :]))
        position = before[:, :3] + after[:, :3] - self.positions[corner]
        return np.hstack((position, rotations.multiply(turn, before[:, 3:])))


def _fade(u: Array) -> Array:
    return np.asarray(u**3 * (2.0 - u))


def motions(trajectory: Trajectory, blends: Array) -> list[Motion]:
    """Split a trajectory at its stops: both ends, dwells, and rows whose blend (n,) [m] is 0."""
    lengths = segment_lengths(trajectory)
    return [
        _motion(trajectory, lengths, blends, first, last) for first, last in _spans(lengths, blends)
    ]


def segment_lengths(trajectory: Trajectory) -> Array:
    """Return the length of each segment between two rows (n - 1,) [m]; below `STILL`: a dwell."""
    shifts = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    angles = np.linalg.norm(turns(trajectory.orientations)[:-1], axis=1)
    return np.asarray(np.maximum(shifts, TURN_LENGTH * angles))


def _spans(lengths: Array, blends: Array) -> Iterator[tuple[int, int]]:
    """Yield the first and last row of each motion."""
    first = 0
    for row in range(1, len(lengths) + 1):
        if lengths[row - 1] < STILL:
            first = row
        elif row == len(lengths) or blends[row] == 0.0 or lengths[row] < STILL:
            yield first, row
            first = row


def _motion(trajectory: Trajectory, lengths: Array, blends: Array, first: int, last: int) -> Motion:
    own = lengths[first:last]
    inner = np.zeros(last - first + 1)
    inner[1:-1] = blends[first + 1 : last]
    # Neighbouring corners share the segment between them.
    room = np.where((inner[:-1] > 0.0) & (inner[1:] > 0.0), 0.5, 1.0) * own
    inner[1:-1] = np.minimum(inner[1:-1], np.minimum(room[:-1], room[1:]))
    return Motion(
        np.arange(first, last + 1),
        np.concatenate(([0.0], np.cumsum(own))),
        trajectory.positions[first : last + 1],
        trajectory.orientations[first : last + 1],
        inner,
    )
