"""Ctrl-C at any instant leaves no temporary file or folder, and no process."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from fault_support import processes_with
from panda_cosim.fmus import processes, replacing
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.master.remote_slave import RemoteSlave
from panda_cosim.fmus.packaging import scratch
from panda_cosim.fmus.packaging.build import build
from panda_cosim.fmus.packaging.cache import cache_folder
from panda_cosim.fmus.packaging.scratch import SWEEP, UNPACK
from panda_cosim.scenarios.recording import Column, Recorder, Recording, storage
from panda_cosim.scenarios.recording import recorder as recorder_module
from panda_cosim.scenarios.recording.storage import PARQUET_FILE, STREAM_FILE
from panda_cosim.scenarios.sweep.pool import WORKER, Pool
from panda_cosim.scenarios.sweep.row import Job, Task
from sweep_support import FORCE, job, short_sweep

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]


FILES = {
    module.__file__
    for module in (
        contextlib, shutil, subprocess, scratch, replacing, processes, recorder_module, storage,
    )
}  # fmt: skip


class Interrupted(BaseException):
    """Stands for the exception of Ctrl-C."""


def raise_it(*_: object) -> None:
    raise Interrupted


def interrupted_at(line: int, do: Callable[[], object]) -> bool:
    """Call a function; raise an exception before the given line of what it executes in `FILES`.

    Returns:
        Whether there were so many lines.
    """
    left = line

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal left
        if event == "line" and frame.f_code.co_filename in FILES:
            left -= 1
            if left == 0:
                raise Interrupted
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        do()
    except (Interrupted, OSError):  # between two lines, shutil closes a folder twice
        assert left == 0
    finally:
        sys.settrace(before)
    return left <= 0


def test_a_temporary_folder_is_removed_whichever_line_is_interrupted(tmp_path: Path) -> None:
    line = 0

    def work() -> None:
        # Each time another one: if its lock is not released now, it is when the process ends.
        with scratch.scratch_folder(tmp_path / str(line), UNPACK) as folder:
            (folder / "part").mkdir()

    while interrupted_at(line := line + 1, work):
        left = [*tmp_path.glob("*/*"), *tmp_path.glob("*/.*")]
        assert not left, f"line {line}"
    assert line > 50


def test_a_file_is_the_old_or_the_new_one_whichever_line_is_interrupted(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"

    def work() -> None:
        with replacing.replacing(path) as partial:
            partial.write_text("new")

    line, found = 0, set()
    path.write_text("old")
    while interrupted_at(line := line + 1, work):
        assert list(tmp_path.iterdir()) == [path], f"line {line}"
        found.add(path.read_text())
        path.write_text("old")
    assert found == {"old", "new"}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyarrow's own
def test_no_flushed_row_is_lost_whichever_line_of_a_recording_s_end_is_interrupted(
    tmp_path: Path,
) -> None:
    rows = np.arange(20.0).reshape(10, 2)
    columns = [Column("time", "s"), Column("x")]
    line = 0

    def work() -> None:
        with Recorder(tmp_path / str(line), columns, {"scenario": "x"}) as recorder:
            recorder.append(rows)
            recorder.flush()
            nonlocal flushed
            flushed = True
            recorder.close(complete=True)

    while True:
        line += 1
        flushed = False
        reached = interrupted_at(line, work)
        names = {path.name for path in tmp_path.glob(f"{line}/*")}
        assert names <= {STREAM_FILE, PARQUET_FILE}, f"line {line}"
        if flushed:
            recording = Recording.open(tmp_path / str(line))
            assert recording["x"].tolist() == rows[:, 1].tolist(), f"line {line}"
        if not reached:
            break


WHILE_LOADING = """
import os, signal, sys, time
from panda_cosim.scenarios.cli.interrupts import ending

def profile(frame, event, argument):
    if event == "call" and frame.f_code.co_name == "register":
        sys.setprofile(None)
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))

ending.listen()
try:
    sys.setprofile(profile)
    import lxml.etree
    assert sys.getprofile() is None
    time.sleep(10)
except BaseException:
    sys.exit(ending.code)
"""


@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_is_not_lost_in_a_compiled_module_that_is_being_loaded(
    number: str, code: int
) -> None:
    """Cython's modules drop all exceptions while they register with collections.abc."""
    command = [sys.executable, "-P", "-c", WHILE_LOADING, number]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (code, "")


WHILE_STARTING = """
import os, signal, sys
from panda_cosim.scenarios.cli import main

def profile(frame, event, argument):
    if event == "call" and frame.f_code.co_name == "start":  # of a thread
        sys.setprofile(None)
        os.kill(os.getpid(), getattr(signal, sys.argv.pop()))

sys.setprofile(profile)
main()
"""


@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_may_come_while_the_command_starts_to_listen(number: str, code: int) -> None:
    command = [sys.executable, "-P", "-c", WHILE_STARTING, "list", number]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


WHILE_WAITING = """
import signal, sys, threading, time
from panda_cosim.scenarios.cli.interrupts import ending

def send():
    time.sleep(0.2)
    # To this thread: the main one is not told, as where the signal comes just before it waits.
    signal.pthread_kill(threading.get_ident(), getattr(signal, sys.argv[1]))
    time.sleep(30)

ending.listen()
try:
    threading.Thread(target=send, daemon=True).start()
    threading.Event().wait()
except BaseException:
    sys.exit(ending.code)
"""


@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_is_taken_though_the_main_thread_was_about_to_wait(number: str, code: int) -> None:
    command = [sys.executable, "-P", "-c", WHILE_WAITING, number]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (code, "")


COMPILER = """#!/bin/sh
sleep 300.75 &
touch "$COMPILING"
wait
"""
BUILD = """
import sys
from pathlib import Path
from panda_cosim.fmus.packaging import libraries
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
    assert not [*cache.rglob(f"{scratch.BUILD}*")]


def test_a_program_is_ended_whichever_line_of_its_start_is_interrupted(tmp_path: Path) -> None:
    mark = f"PROGRAM={tmp_path}"
    environment = os.environ | {"PROGRAM": str(tmp_path)}

    def work() -> None:
        processes.run(["sleep", "2.75"], environment=environment)

    line = 0
    while interrupted_at(line := line + 1, work):
        assert processes_with(mark, "2.75") == [], f"line {line}"
    assert line > 5


def workers(word: str = WORKER) -> list[int]:
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
    (process,) = workers("remote_host")
    os.kill(process, signal.SIGSTOP)  # so that it does not answer
    with interrupted_when(lambda: True):
        slave.close()
    assert workers("remote_host") == []


def test_a_sweep_that_is_interrupted_while_its_workers_leave_ends_them(tmp_path: Path) -> None:
    fmus = {name: path.read_bytes() for name, path in build().items()}
    before = set(cache_folder().glob(f"{SWEEP}*"))
    pool = Pool(job(short_sweep(tmp_path), fmus), 1)
    assert [done for done in pool.run([Task(0, 0, {FORCE: 1.0})]) if done]
    (worker,) = workers()
    os.kill(worker, signal.SIGSTOP)  # so that it cannot leave by itself
    with interrupted_when(lambda: True):
        pool.close()
    assert workers() == []
    assert set(cache_folder().glob(f"{SWEEP}*")) == before


def test_a_sweep_that_is_interrupted_while_it_sends_its_job_ends_the_worker() -> None:
    thread = threading.get_native_id()
    main = Path(f"/proc/self/task/{thread}/children")
    with Pool(Job((), {"plant": bytes(1 << 24)}), 1) as pool:  # too large for a socket's buffer

        def begun() -> bool:
            return any(WORKER in command_line(int(child)) for child in main.read_text().split())

        with interrupted_when(begun):
            next(pool.run([Task(0, 0, {})]))
        assert workers() == []
