"""Commands that are killed at random instants leave nothing half done, and lose nothing.

100 kills of each command with each signal, about half an hour of processor time:
`pytest -m long tests/test_kills.py`; fewer, and one command: `python tests/kill_support.py 10 run`
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from kill_support import COMMANDS, SIGNALS, kill_often

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]
KILLS = 100


def test_a_killed_run_leaves_all_in_order(tmp_path: Path) -> None:
    (kill,) = kill_often("run", {signal.SIGINT: 1}, tmp_path / "box")
    assert not kill.fault


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_a_hundred_kills_with_each_signal_leave_all_in_order(tmp_path: Path, name: str) -> None:
    kills = kill_often(name, dict.fromkeys(SIGNALS, KILLS), tmp_path / "box")
    assert not [kill for kill in kills if kill.fault]
    assert len(kills) == KILLS * len(SIGNALS)
