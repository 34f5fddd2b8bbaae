"""Long runs: no drift in tracking, no growing memory, no dropped block.

The block is carried to the table and back, again and again. An hour of that takes about 3 minutes:
`pytest -m long tests/test_long.py`
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from couple_support import panda_system
from fmu_support import in_process
from panda_cosim import Scenario, TableRow, Trajectory, TrajectoryTable
from panda_cosim.assets import STEP_SIZE
from panda_cosim.assets.franka import HOME_XQUAT
from panda_cosim.fmus.master.system import open_system
from panda_cosim.run.start import start_pose, start_values
from panda_cosim.task import rotations

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
HALF_TICKS = round(8.0 / STEP_SIZE)  # at its end the hand turns
AWAY = round(5.9 / STEP_SIZE)  # of a half cycle: the hand has left the block
APPROACH = 1.2  # [s] from home to above the block
HOUR = 224  # cycles

# Of the hand, of its command and of the block, whose position and quaternion are the last of qpos.
COLUMNS = [
    *(("plant", f"hand_xpos[{i}]") for i in (1, 2, 3)),
    *(("controller", f"pos_cmd[{i}]") for i in (1, 2, 3)),
    *(("plant", f"qpos[{i}]") for i in range(10, 17)),
]

# Bounds of a cycle's figures.
BOUNDS = {
    "rms_mm": 0.05,  # of the hand's distance from its command
    "max_mm": 0.5,
    "off_mm": 2.0,  # of the block, which is not seen, from its place and from where it began
    "tilt_deg": 1.0,
}
LIFT = 295.0  # [mm] that the block must come up by in each half cycle: it was not dropped
MEMORY = 8.0  # [MB] between the first cycle and the last
DRIFT = 0.005  # [mm] of the tracking RMS between the first half and the last


def waypoints(cycles: int) -> tuple[TableRow, ...]:
    """Return waypoints that bring the block to its place and back so often."""
    rows = [TableRow(0.0, "home", (0.0, 0.0, 0.0), OPEN)]
    for half in range(2 * cycles):
        ends = (START, PLACE) if half % 2 == 0 else (PLACE, START)
        for time, end, height, grip in HALF_CYCLE:
            at = APPROACH + half * HALF_TICKS * STEP_SIZE + time
            rows.append(
                TableRow(at, "world", (*ends[end], height[ends[end]]), grip, HANDS[half % 2])
            )
    return tuple(rows)


def figures_of(rows: Array) -> dict[str, float]:
    """Return the figures of a cycle from its rows of `COLUMNS`."""
    hand, command, block, quaternion = np.split(rows, (3, 6, 9), axis=1)
    distance = 1e3 * np.linalg.norm(hand - command, axis=1)
    ends = math.dist(block[AWAY, :2], PLACE), math.dist(block[-1, :2], START)
    heights = block[:HALF_TICKS, 2], block[HALF_TICKS:, 2]
    still = quaternion[[AWAY, HALF_TICKS + AWAY]]
    tilt = 2 * np.arcsin(np.hypot(still[:, 1], still[:, 2]))
    return {
        "rms_mm": float(np.sqrt(np.mean(distance**2))),
        "max_mm": float(distance.max()),
        "off_mm": 1e3 * max(ends),
        "tilt_deg": math.degrees(tilt.max()),
        "lift_mm": 1e3 * float(min(map(np.max, heights)) - block[-1, 2]),
    }


def carry(cycles: int) -> tuple[list[dict[str, float]], float]:
    """Run cycles; return the figures of each, and how memory has grown after the first one [MB]."""
    points = waypoints(cycles)
    values = start_values(Scenario("cycles", TrajectoryTable(points[:2]), duration=APPROACH))
    trajectory = Trajectory.from_table(TrajectoryTable(points), start_pose(values))
    first = round(APPROACH / STEP_SIZE)
    ticks = first + 2 * cycles * HALF_TICKS
    commands = trajectory.sample(STEP_SIZE * np.arange(ticks + 1))
    rows = np.full((ticks + 1, len(COLUMNS)), np.nan)  # all of its memory is in use from now on
    count, memory = 0, [0.0]
    with open_system(panda_system(), values, stop=ticks * STEP_SIZE) as system:
        places = [system.master.columns.index(column) + 1 for column in COLUMNS]

        def watch(block: Array) -> None:
            nonlocal count
            rows[count : count + len(block)] = block[:, places]
            count += len(block)
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            memory.append(pages * 4096 / 1e6)
            if count < first + 2 * HALF_TICKS:
                memory[0] = memory[-1]

        system.master.run(ticks, commands, watch)
    return [figures_of(part) for part in np.split(rows[first:-1], cycles)], memory[-1] - memory[0]


def check(figures: list[dict[str, Any]], growth: float) -> None:
    for number, cycle in enumerate(figures, 1):
        over = {name: cycle[name] for name, bound in BOUNDS.items() if cycle[name] > bound}
        assert not over, f"cycle {number}"
        assert cycle["lift_mm"] >= LIFT, f"cycle {number}"
    assert growth <= MEMORY


def test_two_cycles_bring_the_block_there_and_back():
    check(*in_process(carry, 2))


@pytest.mark.long
def test_an_hour_of_cycles_is_like_the_first():
    figures, growth = in_process(carry, HOUR, timeout=36_000.0)
    check(figures, growth)
    rms = [cycle["rms_mm"] for cycle in figures]
    assert abs(np.mean(rms[HOUR // 2 :]) - np.mean(rms[: HOUR // 2])) <= DRIFT
