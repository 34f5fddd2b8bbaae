"""Ctrl-C leaves no process, and no folder of one."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fault_support import processes_with
from panda_cosim.fmus.atomic import TEMPORARY, cache_folder
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.master.remote_slave import RemoteSlave
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.sweep.backend import Local
from panda_cosim.scenarios.sweep.row import Task
from panda_cosim.scenarios.work import MODULE
from sweep_support import FORCE, job, short_sweep

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]


class Interrupted(BaseException):
    """Stands for the exception of Ctrl-C."""


def raise_it(*_: object) -> None:
    raise Interrupted


COMPILER = """#!/bin/sh
sleep 300.75 &
touch "$COMPILING"
wait
"""
BUILD = """
import sys
from pathlib import Path
from panda_cosim.fmus.build import libraries
from panda_cosim.scenarios.cli import main

libraries.PREBUILT = Path(sys.argv.pop())  # there are none
main()
"""
SLAVE = """
from pythonfmu import Fmi2Slave

class Slave(Fmi2Slave):
    def do_step(self, time, step):
        return True
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("what", ["own", "slave"])
def test_a_first_build_that_is_interrupted_ends_its_compilers(
    tmp_path: Path, number: signal.Signals, what: str
) -> None:
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


def workers(word: str = MODULE) -> list[int]:
    """Processes, of a sweep's workers, that this process has started, defunct ones included."""
    children: list[str] = []
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            children += (thread / "children").read_text(encoding="ascii").split()
    return [child for child in map(int, children) if word in command_line(child)]


def command_line(process: int) -> str:
    return Path(f"/proc/{process}/cmdline").read_text(encoding="utf-8", errors="replace")


@contextlib.contextmanager
def interrupted_when(ready: Callable[[], object]) -> Iterator[None]:
    """Interrupt the block 0.1 s after a condition holds; expect that this ends it."""
    main = threading.get_ident()

    def wait() -> None:
        end = time.monotonic() + 30.0
        while not ready() and time.monotonic() < end:
            time.sleep(0.005)
        time.sleep(0.1)
        signal.pthread_kill(main, signal.SIGUSR1)  # SIGALRM may be the time limit of a test

    before = signal.signal(signal.SIGUSR1, raise_it)
    thread = threading.Thread(target=wait)
    thread.start()
    try:
        with pytest.raises(Interrupted):
            yield
    finally:
        thread.join(60.0)
        signal.signal(signal.SIGUSR1, before)


def test_an_isolated_fmu_that_is_interrupted_while_it_is_freed_is_ended() -> None:
    slave = RemoteSlave("plant", Fmu(build(("plant",))["plant"]))
    slave.initialize({}, 0.0, 1.0)
    (process,) = workers("remote_slave")
    os.kill(process, signal.SIGSTOP)  # so that it does not answer
    with interrupted_when(lambda: True):
        slave.close()
    assert workers("remote_slave") == []


def test_a_sweep_that_is_interrupted_while_its_workers_leave_ends_them(tmp_path: Path) -> None:
    fmus = {name: path.read_bytes() for name, path in build().items()}
    before = set(cache_folder().glob(f"{TEMPORARY}*"))
    local = Local(job(short_sweep(tmp_path), fmus), 1)
    assert [done for done in local.run([Task(0, 0, {FORCE: 1.0})]) if done]
    (worker,) = workers()
    os.kill(worker, signal.SIGSTOP)  # so that it cannot leave by itself
    with interrupted_when(lambda: True):
        local.close()
    assert workers() == []
    assert set(cache_folder().glob(f"{TEMPORARY}*")) == before
