"""Keeps a run in step with the wall clock, and counts its overruns."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass


@dataclass
class RunStatistics:
    """Steps, wall time and overruns of a run.

    Attributes:
        steps: Completed steps.
        wall_time: Wall time of all steps [s].
        overruns: Ticks that ended too late for real time.
        worst_lateness: Largest delay of a tick [s].
    """

    steps: int = 0
    wall_time: float = 0.0
    overruns: int = 0
    worst_lateness: float = 0.0


class RealtimePacer:
    """Keeps in step with the wall clock."""

    def __init__(self, period: float, statistics: RunStatistics) -> None:
        self._period = period
        self._statistics = statistics
        self._start = clock.perf_counter()

    def wait(self, ticks: int) -> None:
        """Sleep until the tick is due, or count an overrun."""
        ahead = self._start + ticks * self._period - clock.perf_counter()
        if ahead > 0:
            clock.sleep(ahead)
        else:
            self._statistics.overruns += 1
            self._statistics.worst_lateness = max(self._statistics.worst_lateness, -ahead)
