"""The long run: the block is carried to the table and back, again and again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from panda_cosim.assets import STEP_SIZE
from panda_cosim.assets.franka import HOME_XQUAT
from panda_cosim.fmus.master.system import open_system, panda_system
from panda_cosim.scenarios import rotations
from panda_cosim.scenarios.definition.scenario import Scenario
from panda_cosim.scenarios.definition.table import TableRow, TrajectoryTable
from panda_cosim.scenarios.running.external import ScenarioInputs
from panda_cosim.scenarios.running.start import start_values

Array = NDArray[np.float64]

QUARTER_TURN = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])  # about z
START, PLACE = (0.4, -0.2), (0.6, 0.35)  # [m] of the block, on the floor and on the table
GRASP = {START: 0.185, PLACE: 0.385}  # [m] height of the hand, fingers about the block
ABOVE = {START: 0.385, PLACE: 0.485}  # [m] of the hand on its way, clear of the table
OPEN, CLOSED = 0.08, 0.0  # [m] between the fingertips
# The block slips by fractions of a millimetre along the fingers while it is carried, but is centred
# between them each time. So it is carried with the fingers along y there, along x back.
HANDS = (tuple(HOME_XQUAT), tuple(rotations.multiply(QUARTER_TURN, HOME_XQUAT)))
# Time of each point [s], end of the way that it is at, height of the hand there, gripper.
HALF_CYCLE = (
    (0.0, 0, ABOVE, OPEN),
    (0.7, 0, GRASP, CLOSED),
    (1.3, 0, GRASP, CLOSED),
    (2.0, 0, ABOVE, CLOSED),
    (3.5, 1, ABOVE, CLOSED),
    (4.2, 1, GRASP, OPEN),
    (5.2, 1, GRASP, OPEN),
    (5.9, 1, ABOVE, OPEN),
)
HALF_TIME = 8.0  # [s]; at its end the hand turns
CYCLE_TIME = 2 * HALF_TIME
CYCLE_TICKS = round(CYCLE_TIME / STEP_SIZE)
APPROACH = 1.2  # [s] from home to above the block


def cycles(count: int) -> Scenario:
    """Return a scenario in which the block goes to its place and back `count` times."""
    rows = [TableRow(0.0, "home", (0.0, 0.0, 0.0), OPEN)]
    for half in range(2 * count):
        ends = (START, PLACE) if half % 2 == 0 else (PLACE, START)
        for time, end, height, grip in HALF_CYCLE:
            at, position = APPROACH + half * HALF_TIME + time, (*ends[end], height[ends[end]])
            rows.append(TableRow(at, "world", position, grip, HANDS[half % 2]))
    duration = round(APPROACH + count * CYCLE_TIME, 3)
    return Scenario("cycles", TrajectoryTable(tuple(rows)), duration=duration)


class Watch:
    """A sink that keeps figures of each cycle, not rows.

    Attributes:
        figures: Of each cycle: tracking error RMS and maximum [mm], distance of the block from
            where it began [mm], its tilt [deg], memory of the process [MB].
    """

    def __init__(self, columns: list[tuple[str, str]]) -> None:
        index = {name: i + 1 for i, name in enumerate(columns)}
        self._hand = [index["plant", f"hand_xpos[{i}]"] for i in (1, 2, 3)]
        self._command = [index["controller", f"pos_cmd[{i}]"] for i in (1, 2, 3)]
        self._block = [index["plant", f"qpos[{i}]"] for i in range(10, 17)]
        self.figures: list[dict[str, float]] = []
        self._start: Array | None = None
        self._squares = self._worst = self._highest = 0.0
        self._count = 0

    def __call__(self, rows: Array) -> None:
        """Take rows."""
        for row in rows:
            self._take(row)

    def _take(self, row: Array) -> None:
        if self._start is None:
            self._start = row[self._block].copy()
        error = math.dist(row[self._hand], row[self._command])
        self._squares += error * error
        self._worst = max(self._worst, error)
        self._highest = max(self._highest, row[self._block[2]])
        self._count += 1
        # A cycle ends while the hand is above the floor, the block at its start.
        ticks = self._count - round(APPROACH / STEP_SIZE)
        if ticks == 0:
            self._squares = self._worst = 0.0
        elif ticks > 0 and ticks % CYCLE_TICKS == 0:
            self._close(row)

    def _close(self, row: Array) -> None:
        assert self._start is not None
        _, x, y, _ = row[self._block][3:]
        self.figures.append(
            {
                "rms_mm": 1e3 * math.sqrt(self._squares / CYCLE_TICKS),
                "max_mm": 1e3 * self._worst,
                "off_mm": 1e3 * math.dist(row[self._block][:3], self._start[:3]),
                "tilt_deg": math.degrees(math.acos(max(-1.0, 1 - 2 * (x * x + y * y)))),
                "lift_mm": 1e3 * float(self._highest - self._start[2]),
                "memory_MB": _memory(),
            }
        )
        self._squares = self._worst = self._highest = 0.0


def _memory() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def carry(count: int) -> list[dict[str, Any]]:
    """Run cycles; return the figures of each."""
    scenario = cycles(count)
    values = start_values(scenario)
    external = ScenarioInputs(scenario, values)
    with open_system(panda_system(), values, stop=scenario.duration) as session:
        watch = Watch(session.master.columns)
        session.master.run(scenario.ticks, external, watch)
    return watch.figures
