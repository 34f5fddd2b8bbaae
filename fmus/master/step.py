"""The master's step: from the values at t_k to those at t_k+1 = t_k + step size.

All values are in the rows of the recording: slaves set their inputs from row k, and write their
outputs to row k or k + 1. There is no other copy of them.

Gauss-Seidel: a slave that feeds a later one is a leader, such as the controller, which feeds the
plant. Its outputs act within the same step. The other slaves are followers.
Jacobi: there are no leaders, so all outputs act one step later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .wiring import BoundSlave

Coupling = Literal["gauss-seidel", "jacobi"]
COUPLINGS: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")


class Step:
    """One communication step of a coupled system."""

    fed_back: list[int]  # columns of outputs that a leader or an earlier one reads in the next step

    def __init__(
        self,
        slaves: Sequence[BoundSlave],  # in the order of stepping
        coupling: Coupling,
        size: float,  # [s]
        rows: NDArray[np.float64],  # (n, columns) that the slaves are bound to
        complete: Callable[[int], None],  # called with a row's index before followers read it
    ) -> None:
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.leaders = _leaders(slaves) if coupling == "gauss-seidel" else []
        self.followers = [slave for slave in slaves if slave not in self.leaders]
        self.leader_columns = _columns(self.leaders)
        self.fed_back = _columns(_feeding_back(self.leaders))
        self.size, self._rows, self._complete = size, rows, complete

    def take(self, row: int, time: float) -> None:
        """Step from `time` [s]; its row has the external inputs and the followers' outputs."""
        size, followers = self.size, self.followers
        self.lead(row, time)
        self._complete(row)
        for follower in followers:
            follower.set_inputs(row)
        for follower in followers:
            follower.step(time, size)
        for follower in followers:
            follower.get_outputs(row + 1)
        if self.fed_back:  # read by this or an earlier leader in the next step
            self._rows[row + 1, self.fed_back] = self._rows[row, self.fed_back]

    def lead(self, row: int, time: float) -> None:
        """Step the leaders from `time`, so that all values of its row are known."""
        for leader in self.leaders:
            leader.set_inputs(row)
            leader.step(time, self.size)
            leader.get_outputs(row)


def _leaders(slaves: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Slaves that feed a later one."""
    return [
        slave
        for i, slave in enumerate(slaves)
        if any(slave.feeds(later) for later in slaves[i + 1 :])
    ]


def _feeding_back(leaders: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Leaders that feed themselves or an earlier leader."""
    return [
        leader
        for i, leader in enumerate(leaders)
        if any(leader.feeds(earlier) for earlier in leaders[: i + 1])
    ]


def _columns(slaves: Sequence[BoundSlave]) -> list[int]:
    return [column for slave in slaves for column in slave.outputs]
