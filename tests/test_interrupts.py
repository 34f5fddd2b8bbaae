"""Ctrl-C leaves no process, and no folder of one."""

import os
import signal
import subprocess
import sys
import time

import pytest

from bounded import ran
from fault_support import processes_with
from panda_cosim.fmus.atomic import TEMPORARY

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")


COMPILER = """#!/bin/sh
sleep 300.75 &
touch "$COMPILING"
wait
"""
BUILD = """
import sys
from pathlib import Path
from panda_cosim.fmus.build import libraries
from panda_cosim.cli import main

libraries.PREBUILT = Path(sys.argv.pop())  # there are none
main()
"""
SLAVE = """
from pythonfmu import Fmi2Slave

class Slave(Fmi2Slave):
    def do_step(self, time, step):
        return True
"""


# A signal comes while code runs whose exceptions nobody sees, as in a callback of a C library.
UNSEEN = """
import os, sys, time
from panda_cosim import cli

class Unseen:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))
        time.sleep(0.01)

cli.ending.listen()
try:
    Unseen()
    time.sleep(60)
except cli.INTERRUPTS as error:
    sys.exit(cli.exit_code(error))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_whose_exception_nobody_sees_ends_the_command(number):
    command = [sys.executable, "-c", UNSEEN, str(int(number))]
    done = ran(command, code=128 + number)
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("number", "what"), [(signal.SIGINT, "own"), (signal.SIGTERM, "slave")], ids=["own", "slave"]
)
def test_a_first_build_that_is_interrupted_ends_its_compilers(tmp_path, number, what):
    """The project's own FMUs are compiled in threads, a single one in the main thread."""
    compiler, slave = tmp_path / "bin" / "cc", tmp_path / "slave.py"
    compiler.parent.mkdir()
    compiler.write_text(COMPILER, encoding="utf-8")
    compiler.chmod(0o755)
    slave.write_text(SLAVE, encoding="utf-8")
    begun, cache = tmp_path / "begun", tmp_path / "cache"
    mark = f"COMPILING={begun}"
    environment = os.environ | {
        "PATH": f"{compiler.parent}{os.pathsep}{os.environ['PATH']}",
        "PANDA_COSIM_CACHE": str(cache),
        "COMPILING": str(begun),
    }
    more = ["--slave", str(slave)] if what == "slave" else []
    command = [sys.executable, "-P", "-c", BUILD, "build", "--out", str(tmp_path / "out"), *more]
    with subprocess.Popen(
        [*command, str(tmp_path / "none")], env=environment, stderr=subprocess.PIPE, text=True
    ) as building:
        try:
            end = time.monotonic() + 60.0
            while not begun.exists():
                assert time.monotonic() < end, "no compiler was started"
                time.sleep(0.01)
            building.send_signal(number)
            _, complaint = building.communicate(timeout=60.0)
        finally:
            building.kill()
            end = time.monotonic() + 10.0  # a killed process may take a moment to go
            while (left := processes_with(mark, "300.75")) and time.monotonic() < end:
                time.sleep(0.05)
            for process in left:
                os.kill(process, signal.SIGKILL)
    assert building.returncode == 128 + number
    assert "Traceback" not in complaint
    assert left == []
    assert not [*cache.rglob(f"{TEMPORARY}*")]
