"""The long run: the block is carried to the table and back, again and again."""

from __future__ import annotations

import json
import math
import os
import time as clock
from pathlib import Path
from typing import IO, Any

import numpy as np
from couple_support import panda_system
from numpy.typing import NDArray
from panda_cosim.assets import STEP_SIZE
from panda_cosim.assets.franka import HOME_XQUAT
from panda_cosim.fmus.master.system import open_system
from panda_cosim.scenarios import rotations
from panda_cosim.scenarios.run.start import start_pose, start_values
from panda_cosim.scenarios.scenario.scenario import Scenario
from panda_cosim.scenarios.scenario.table import TableRow, TrajectoryTable
from panda_cosim.scenarios.scenario.trajectory import COMMANDS, Trajectory

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
CHUNK = 16_384  # ticks whose commands are computed at a time
GRASPED, RELEASED, AWAY = 1.3, 4.2, 5.9  # [s] of a half cycle


def cycles(count: int) -> tuple[TableRow, ...]:
    """Return waypoints that bring the block to its place and back `count` times."""
    rows = [TableRow(0.0, "home", (0.0, 0.0, 0.0), OPEN)]
    for half in range(2 * count):
        ends = (START, PLACE) if half % 2 == 0 else (PLACE, START)
        for time, end, height, grip in HALF_CYCLE:
            at, position = APPROACH + half * HALF_TIME + time, (*ends[end], height[ends[end]])
            rows.append(TableRow(at, "world", position, grip, HANDS[half % 2]))
    return tuple(rows)


class Commands:
    """The commands at each tick, without the bound of an hour that scenarios have.

    Args:
        trajectory: The hand's path.
        ticks: Number of communication steps.
    """

    def __init__(self, trajectory: Trajectory, ticks: int) -> None:
        self.shape = (ticks + 1, len(COMMANDS))
        self._trajectory = trajectory
        self._first, self._part = 0, np.empty((0, len(COMMANDS)))

    def __getitem__(self, ticks: slice, /) -> Array:
        """Return the rows of a range of ticks, at most `CHUNK` of them."""
        first, end, _ = ticks.indices(self.shape[0])
        if not self._first <= first <= end <= self._first + len(self._part):
            times = STEP_SIZE * np.arange(first, min(first + CHUNK, self.shape[0]))
            self._first, self._part = first, self._trajectory.sample(times)
        return self._part[first - self._first : end - self._first]


class Watch:
    """A sink that keeps figures of each cycle, not rows.

    Args:
        columns: Instance and variable of each column after the time.
        log: File that gets the figures of each cycle, one JSON object a line, at once.

    Attributes:
        figures: Of each cycle, see `_figures`.
    """

    def __init__(self, columns: list[tuple[str, str]], log: IO[str]) -> None:
        index = {name: i + 1 for i, name in enumerate(columns)}
        wanted = {
            "hand": ("plant", "hand_xpos", 3),
            "turn": ("plant", "hand_xquat", 4),
            "command": ("controller", "pos_cmd", 3),
            "qpos": ("plant", "qpos", 16),
        }
        self._columns = {
            key: [index[instance, f"{name}[{i}]"] for i in range(1, count + 1)]
            for key, (instance, name, count) in wanted.items()
        }
        self._rows = np.empty((CYCLE_TICKS, len(columns) + 1))
        self._filled = -round(APPROACH / STEP_SIZE)  # negative: on the way to the block
        self._start: Array | None = None
        self._cost = clock.process_time()
        self._log = log
        self.figures: list[dict[str, float]] = []

    def __call__(self, rows: Array) -> None:
        """Take rows."""
        if self._start is None:
            self._start = rows[0, self._columns["qpos"][9:12]].copy()
        skipped = min(max(-self._filled, 0), len(rows))
        self._filled += skipped
        rows = rows[skipped:]
        while len(rows):
            taken = rows[: CYCLE_TICKS - self._filled]
            self._rows[self._filled : self._filled + len(taken)] = taken
            self._filled += len(taken)
            rows = rows[len(taken) :]
            if self._filled == CYCLE_TICKS:
                self._close()

    def _close(self) -> None:
        """Note the figures of the cycle."""
        values = {key: self._rows[:, columns] for key, columns in self._columns.items()}
        now = clock.process_time()
        figures = _figures(values, self._start) | {
            "memory_MB": _memory(),
            "files": len(list(Path("/proc/self/fd").iterdir())),
            "step_us": 1e6 * (now - self._cost) / CYCLE_TICKS,
        }
        self.figures.append(figures)
        self._log.write(json.dumps({"end_s": self._rows[-1, 0]} | figures) + "\n")
        self._log.flush()
        os.fsync(self._log.fileno())
        self._filled, self._cost = 0, clock.process_time()


def _figures(values: dict[str, Array], start: Array | None) -> dict[str, float]:
    """Return the figures of a cycle.

    Tracking error of the hand: RMS and maximum [mm]. The block: distance in the plane from its
    place when the hand has left it there [mm], from its start at the end [mm]; its tilt then [deg];
    how far it came up in each half [mm]; how far it slipped in the hand while carried [mm].
    """
    error = np.linalg.norm(values["hand"] - values["command"], axis=1)
    block, quaternion = values["qpos"][:, 9:12], values["qpos"][:, 12:]
    in_hand = rotations.rotate(rotations.conjugate(values["turn"]), block - values["hand"])
    half = CYCLE_TICKS // 2
    carried = [in_hand[first + _tick(GRASPED) : first + _tick(RELEASED)] for first in (0, half)]
    tilt = 2 * np.arcsin(np.hypot(quaternion[:, 1], quaternion[:, 2]))
    still = [_tick(AWAY), half + _tick(AWAY)]
    return {
        "rms_mm": 1e3 * math.sqrt(np.mean(error**2)),
        "max_mm": 1e3 * float(error.max()),
        "placed_mm": 1e3 * math.dist(block[still[0], :2], PLACE),
        "off_mm": 1e3 * math.dist(block[-1], start),
        "tilt_deg": math.degrees(tilt[still].max()),
        "lift_mm": 1e3 * float(min(block[:half, 2].max(), block[half:, 2].max()) - start[2]),
        "slip_mm": 1e3 * max(float(np.linalg.norm(c - c[0], axis=1).max()) for c in carried),
    }


def _tick(time: float) -> int:
    return round(time / STEP_SIZE)


def _memory() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def carry(count: int, log: str) -> list[dict[str, Any]]:
    """Run cycles; return the figures of each.

    Args:
        count: Number of cycles.
        log: File that gets the figures as they come.
    """
    rows = cycles(count)
    home = Scenario("cycles", TrajectoryTable(rows[:2]), duration=APPROACH)
    values = start_values(home)
    trajectory = Trajectory.from_table(TrajectoryTable(rows), start_pose(values["plant"]))
    duration = APPROACH + count * CYCLE_TIME
    ticks = round(duration / STEP_SIZE)
    with (
        Path(log).open("w") as file,
        open_system(panda_system(), values, stop=duration) as session,
    ):
        watch = Watch(session.master.columns, file)
        session.master.run(ticks, Commands(trajectory, ticks), watch)
    return watch.figures
