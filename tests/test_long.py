"""Long runs: no drift in tracking, no growing memory, no dropped block.

The hour, which takes about 10 minutes: `pytest -m long -s tests/test_long.py`
"""

from __future__ import annotations

from typing import Any

import long_support
import numpy as np
import pytest
from fmu_support import in_process

pytestmark = pytest.mark.fmu

HOUR = 224  # cycles of 16 s
TRACKING_RMS = 0.05  # [mm] over a cycle
TRACKING_MAX = 0.5  # [mm]
OFF = 2.0  # [mm] of the block from where it began; it is carried by a table, not by sight
TILT = 1.0  # [deg]
LIFT = 295.0  # [mm] that the block must come up by in each cycle: it was not dropped
MEMORY = 8.0  # [MB] between the first cycle and the last
DRIFT = 0.005  # [mm] of the tracking RMS between the first half and the last


def check(figures: list[dict[str, Any]], cycles: int) -> None:
    assert len(figures) == cycles
    for cycle in figures:
        assert cycle["rms_mm"] <= TRACKING_RMS
        assert cycle["max_mm"] <= TRACKING_MAX
        assert cycle["off_mm"] <= OFF
        assert cycle["tilt_deg"] <= TILT
        assert cycle["lift_mm"] >= LIFT
    assert figures[-1]["memory_MB"] - figures[0]["memory_MB"] <= MEMORY


def test_two_cycles_bring_the_block_there_and_back() -> None:
    check(in_process(long_support.carry, 2), 2)


@pytest.mark.long
def test_an_hour_of_cycles_is_like_the_first() -> None:
    figures = in_process(long_support.carry, HOUR, timeout=7200.0)
    first, last = figures[: HOUR // 2], figures[HOUR // 2 :]
    for name in figures[0]:
        print(
            f"{name}: first {figures[0][name]:.4f}, last {figures[-1][name]:.4f}, "
            f"largest {max(f[name] for f in figures):.4f}"
        )
    check(figures, HOUR)
    drift = np.mean([f["rms_mm"] for f in last]) - np.mean([f["rms_mm"] for f in first])
    assert abs(drift) <= DRIFT
