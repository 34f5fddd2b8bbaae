"""Commands that are killed at random instants leave nothing half done, and lose nothing.

100 kills of each command with each signal, about half an hour of processor time:
`pytest -m long tests/test_kills.py`; fewer, and one command: `python tests/kill_support.py 10 run`
"""

from __future__ import annotations

import random
import signal
import sys
from pathlib import Path

import forked
import pytest
from kill_support import COMMANDS, SIGNALS, Box, Build, kill_often

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]
KILLS = 100


def test_a_killed_run_leaves_all_in_order(tmp_path: Path) -> None:
    (kill,) = kill_often("run", {signal.SIGINT: 1}, tmp_path / "box")
    assert not kill.fault


KILLED = """
import os, resource, signal, sys
from panda_cosim.scenarios.cli import main

folder, change, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
changes = ("open", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "shutil.rmtree")

def count(event, arguments):
    global change
    if event in changes and str(arguments[0]).startswith(folder):
        if event != "open" or arguments[2] & os.O_ACCMODE != os.O_RDONLY:
            change -= 1
            if change == 0:
                os.kill(os.getpid(), signal.SIGKILL)

sys.argv[1:4] = []
sys.addaudithook(count)
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # it ends the process in the midst of writing
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
main()
"""
FAR = 1 << 40


def test_a_build_that_is_killed_before_each_change_of_a_file_or_within_leaves_whole_files(
    tmp_path: Path,
) -> None:
    box = Box(tmp_path / "box")
    command = Build("build", box, random.Random(1))

    def killed(change: int, size: int) -> int:
        box.age()
        arguments = [box.folder, change, size, *command.line(change % 2, 2 + change // 2 % 2)]
        done = forked.script(KILLED, *map(str, arguments), **box.environment)
        command.check(0, gently=False)
        return done.returncode

    for size in (0, 1_000_000, command.largest - 1):
        assert killed(FAR, size) == -signal.SIGXFSZ
    change = 1
    while code := killed(change, FAR):
        assert code == -signal.SIGKILL
        change += 1
    assert change > 12, change  # at least: make, open and rename four files
    assert not box.left()


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_a_hundred_kills_with_each_signal_leave_all_in_order(tmp_path: Path, name: str) -> None:
    kills = kill_often(name, dict.fromkeys(SIGNALS, KILLS), tmp_path / "box")
    assert not [kill for kill in kills if kill.fault]
    assert len(kills) == KILLS * len(SIGNALS)
