"""Long runs: no drift in tracking, no growing memory, no dropped block.

The hour takes about 2 minutes of processor time, the day 38: `pytest -m long -s tests/test_long.py`
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import long_support
import numpy as np
import pytest
from fmu_support import in_process

pytestmark = pytest.mark.fmu

HOUR, DAY = 224, 5399  # cycles of 16 s
TRACKING_RMS = 0.05  # [mm] over a cycle
TRACKING_MAX = 0.5  # [mm]
OFF = 2.0  # [mm] of the block from its place, and from where it began; it is not seen
TILT = 1.0  # [deg]
LIFT = 295.0  # [mm] that the block must come up by in each half cycle: it was not dropped
SLIP = 2.0  # [mm] in the hand
MEMORY = 8.0  # [MB] between the first cycle and the last
DRIFT = 0.005  # [mm] of the tracking RMS between the first half and the last
BOUNDS = {"rms_mm": TRACKING_RMS, "max_mm": TRACKING_MAX, "placed_mm": OFF, "off_mm": OFF,
          "tilt_deg": TILT, "slip_mm": SLIP}  # fmt: skip


def check(figures: list[dict[str, Any]], cycles: int) -> None:
    assert len(figures) == cycles
    for number, cycle in enumerate(figures, 1):
        over = {name: cycle[name] for name, bound in BOUNDS.items() if cycle[name] > bound}
        assert not over, f"cycle {number}"
        assert cycle["lift_mm"] >= LIFT, f"cycle {number}"
    first, last = figures[0], figures[-1]
    assert last["memory_MB"] - first["memory_MB"] <= MEMORY
    assert last["files"] == first["files"]


def show(figures: list[dict[str, Any]]) -> None:
    for name in figures[0]:
        values = [f[name] for f in figures]
        print(
            f"{name}: first {values[0]:.4f}, last {values[-1]:.4f}, "
            f"smallest {min(values):.4f}, largest {max(values):.4f}"
        )


def test_two_cycles_bring_the_block_there_and_back(tmp_path: Path) -> None:
    log = tmp_path / "cycles.jsonl"
    figures = in_process(long_support.carry, 2, str(log))
    check(figures, 2)
    logged = [json.loads(line) for line in log.read_text().splitlines()]
    assert [line["rms_mm"] for line in logged] == [cycle["rms_mm"] for cycle in figures]


@pytest.mark.long
@pytest.mark.parametrize("cycles", [HOUR, DAY], ids=["hour", "day"])
def test_many_cycles_are_like_the_first(tmp_path: Path, cycles: int) -> None:
    log = tmp_path / "cycles.jsonl"
    print(f"\nfigures of each cycle: {log}")
    figures = in_process(long_support.carry, cycles, str(log), timeout=36_000.0)
    show(figures)
    check(figures, cycles)
    first, last = figures[: cycles // 2], figures[cycles // 2 :]
    drift = np.mean([f["rms_mm"] for f in last]) - np.mean([f["rms_mm"] for f in first])
    assert abs(drift) <= DRIFT
