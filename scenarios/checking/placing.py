"""Whether the table carries the block where the fingers let go of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ...plant.scene import BLOCK_HALF_HEIGHT, TABLE_CENTRE, TABLE_HALF_SIZE, TABLE_TOP

MARGIN: Final = 0.0005  # [m] closer to the edge than this, chance decides whether the block stands
LOWER: Final = 0.005  # [m] of its bottom below the table's top: it is not meant for the table

_LIMITS: Final = tuple(
    (centre - half + MARGIN, centre + half - MARGIN)
    for centre, half in zip(TABLE_CENTRE, TABLE_HALF_SIZE, strict=True)
)


@dataclass(frozen=True)
class Release:
    """A moment in which the fingers let go of the block.

    Attributes:
        time: When they are told to open [s].
        position: Of the block's centre, world frame [m].
        pressing: Force of each finger on the block when the hand moves on [N].
    """

    time: float
    position: tuple[float, float, float]
    pressing: float

    @property
    def is_off_the_table(self) -> bool:
        """Whether the block is as high as the table, with its centre on or beyond the edge."""
        if self.position[2] - BLOCK_HALF_HEIGHT < TABLE_TOP - LOWER:
            return False
        places = zip(self.position[:2], _LIMITS, strict=True)
        return not all(low <= place <= high for place, (low, high) in places)

    def __str__(self) -> str:
        """Say in one line where it is, and where it would stand."""
        x, y, _ = self.position
        (left, right), (near, far) = _LIMITS
        return (
            f"at t = {self.time:.3f} s the block is let go with its centre at [{x:.4f}, {y:.4f}] "
            "m, on or beyond the table's edge, where it topples; must be within "
            f"x = {left:.4f} to {right:.4f} m and y = {near:.4f} to {far:.4f} m"
        )


__all__ = ["Release"]
