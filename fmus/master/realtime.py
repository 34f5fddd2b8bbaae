"""How a run went, and keeping it in step with the wall clock."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass


@dataclass
class Report:
    """How a run went.

    Attributes:
        steps: Completed steps.
        wall_time: Time that stepping took [s].
        overruns: Ticks that ended too late for real time.
        worst_lateness: How late the latest was [s].
    """

    steps: int = 0
    wall_time: float = 0.0
    overruns: int = 0
    worst_lateness: float = 0.0


class RealtimePacer:
    """Keeps in step with the wall clock."""

    def __init__(self, period: float, report: Report) -> None:
        self._period = period
        self._report = report
        self._start = clock.perf_counter()

    def wait(self, ticks: int) -> None:
        """Sleep until the tick is due, or count an overrun."""
        ahead = self._start + ticks * self._period - clock.perf_counter()
        if ahead > 0:
            clock.sleep(ahead)
        else:
            self._report.overruns += 1
            self._report.worst_lateness = max(self._report.worst_lateness, -ahead)
