"""Commands that are killed at random instants leave nothing half done, and lose nothing.

100 kills of each command with each signal, about two hours of processor time:
`pytest -m long -s tests/test_kills.py`; fewer: `python tests/kill_support.py sweep SIGKILL 10`
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from kill_support import COMMANDS, kill_often

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
KILLS = 100


def test_a_killed_run_leaves_all_in_order(tmp_path: Path) -> None:
    assert not kill_often("run", signal.SIGINT, 1, tmp_path / "box").faults


@pytest.mark.long
@pytest.mark.parametrize("number", SIGNALS, ids=[number.name for number in SIGNALS])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_hundred_kills_leave_all_in_order(
    tmp_path: Path, name: str, number: signal.Signals
) -> None:
    done = kill_often(name, number, KILLS, tmp_path / "box")
    print(
        f"\n{name} {number.name}: {done.killed} killed, {done.finished} came to their end, "
        f"{done.slowest:.2f} s from the signal to the end at most"
    )
    assert not done.faults
