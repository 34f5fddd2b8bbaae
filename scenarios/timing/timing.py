"""The result of retiming: the new times, and the shares of the limits that they use."""

from __future__ import annotations

from dataclasses import dataclass

from ..definition.table import TrajectoryTable
from ..definition.trajectory import Trajectory
from .demand import Shares


@dataclass(frozen=True)
class Timing:
    """A trajectory with new times.

    Attributes:
        trajectory: Commands at those times.
        shares: The largest share of each limit that it uses [1].
        table: New rows, in the world, to be interpolated by `spline`; None: the rows are the old
            ones, at the trajectory's times.
    """

    trajectory: Trajectory
    shares: Shares
    table: TrajectoryTable | None = None

    @property
    def cycle(self) -> float:
        """Time of the last row [s]."""
        return float(self.trajectory.times[-1])
