"""Whatever happens to a run, its recording opens, is complete up to then, and gives the reason."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bounded import killed_after, limited, line_of, running
from fault_support import (
    build_faulty,
    on_a_small_disk,
    processes_with,
    run_command,
    run_with_fault,
    write_scenario,
)
from numpy.typing import NDArray
from panda_cosim.fmus.atomic import TEMPORARY
from panda_cosim.fmus.errors import SimulationError
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.master import Master
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.stopping import stopping_on_signals

pytestmark = pytest.mark.fmu
KEPT_BACK = 0.5  # [s] of wall time that a SIGKILL may cost
SCHEDULING = 0.5  # [s] that a busy machine may keep a process from running
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_faulty(tmp_path_factory.mktemp("faulty"))


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.1)


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenario(tmp_path_factory.mktemp("scenario") / "lasting", 60.0)


# An FMU in the process of the master.


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("raise", "at t = 0.019 s, in FMU 'plant': fmi2DoStep returned Fatal: "),
        ("discard", "at t = 0.019 s, in FMU 'plant': fmi2DoStep returned Discard"),
        ("nan", "at t = 0.020 s, in FMU 'plant', variable hand_xpos[2]: value nan is not finite"),
    ],
)
def test_a_failing_fmu_ends_the_run_with_its_rows_kept(
    tmp_path: Path, faulty: Path, scenario: Path, fault: str, message: str
) -> None:
    ended = run_with_fault(faulty, scenario, tmp_path / "run", f"{fault}@20")
    assert ended.returncode == SimulationError.exit_code
    line = ended.stderr.strip().splitlines()[-1]
    assert line.startswith(f"SimulationError: {message}")
    assert "Traceback" not in ended.stderr
    recording = Recording.open(tmp_path / "run")
    assert recording.time.tolist() == [k * 0.001 for k in range(20)]
    assert not recording.complete
    assert f"SimulationError: {message}" in str(recording.reason)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["complete"] is summary["success"] is False
    assert summary["reason"] == recording.reason


def test_a_crash_in_this_process_leaves_what_was_flushed(
    tmp_path: Path, faulty: Path, scenario: Path
) -> None:
    """Without --isolate a crash ends the process and costs the rows not yet written."""
    ended = run_with_fault(faulty, scenario, tmp_path / "run", "segfault@20")
    assert ended.returncode == -signal.SIGSEGV
    recording = Recording.open(tmp_path / "run")
    assert not recording.complete
    assert "killed" in str(recording.reason)


def test_rows_that_were_saved_stay_if_an_fmu_ends_the_process(
    tmp_path: Path, faulty: Path, lasting: Path
) -> None:
    ended = subprocess.run(
        run_command(lasting, tmp_path / "run", fmus={"plant": str(faulty)}, realtime=1.0),
        env=os.environ | {"FAULT": "c-exit@1500"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == SimulationError.exit_code
    recording = Recording.open(tmp_path / "run")
    assert not recording.complete
    assert 1000 - SCHEDULING * 1000 <= recording.rows <= 1500  # half a second may be lost
    assert not (tmp_path / "run" / "summary.json").exists()


@pytest.mark.parametrize(
    "fault",
    ["c-exit@20", "locked-exit@20", "python-exit@20", "thread-exit@20", "thread-exit-hang@20",
     "new-c-exit", "init-c-exit", "new-python-exit", "init-python-exit"],
)  # fmt: skip
def test_an_fmu_that_ends_the_process_ends_it_as_a_failure(
    tmp_path: Path, faulty: Path, lasting: Path, fault: str
) -> None:
    out = tmp_path / "run"
    ended = run_with_fault(faulty, lasting, out, fault)
    assert ended.returncode == SimulationError.exit_code
    (line,) = [line for line in ended.stderr.splitlines() if "Error" in line]
    assert line.startswith(f"Error: {out}: exit() was called, in an FMU for instance")
    if "@" in fault:
        assert not Recording.open(out).complete
    else:
        assert not out.exists()


def test_a_fork_that_exits_is_no_failure(tmp_path: Path, faulty: Path, scenario: Path) -> None:
    ended = run_with_fault(faulty, scenario, tmp_path / "run", "fork-exit@20")
    assert ended.returncode == 0, ended.stderr
    assert Recording.open(tmp_path / "run").rows == 101
    assert Recording.open(tmp_path / "run").complete


# The master with plain Python slaves.


@dataclass
class Fake:
    """A slave that counts, and does something at a step."""

    name: str
    at: int = -1
    act: Callable[[], object] = lambda: None
    value: float = 0.0
    steps: int = 0
    seen: list[float] = field(default_factory=list)

    def bind_get(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Read its value."""

        def read(row: int) -> None:
            block[row] = self.value

        return read

    def bind_set(self, names: Sequence[str], block: Array) -> Callable[[int], None]:
        """Check its inputs."""
        return lambda row: self.seen.append(float(block[row, 0]))

    def step(self, time: float, step_size: float) -> None:
        """Count; do what is due."""
        if self.steps == self.at:
            self.act()
        self.steps += 1
        self.value += 1.0


def run_fakes(slave: Fake, steps: int = 1000, coupling: Any = "gauss-seidel") -> tuple[Any, Array]:
    rows: list[Array] = []
    other = Fake("other")
    master = Master(
        [other, slave],
        {"other": ["y"], slave.name: ["x"]},
        [
            Connection((slave.name, "x"), ("other", "u")),
            Connection(("other", "y"), (slave.name, "u")),
        ],
        coupling=coupling,
    )
    error = None
    with stopping_on_signals() as stop:
        stop.watch(master)
        try:
            master.run(steps, np.zeros((steps + 1, 0)), lambda block: rows.append(block.copy()))
        except SimulationError as caught:
            error = caught
    outcome = SimpleNamespace(error=error, signal=stop.signal)
    return outcome, np.concatenate([np.empty((0, 3)), *rows])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("at", [0, 1, 255, 256, 257, 700])
def test_a_signal_inside_a_slave_is_no_error_and_loses_no_step(
    number: int, coupling: str, at: int
) -> None:
    slave = Fake("slave", at, lambda: os.kill(os.getpid(), number))
    outcome, rows = run_fakes(slave, coupling=coupling)
    assert outcome.error is None
    assert outcome.signal == number
    assert slave.steps == at + 1
    assert rows[:, 0].tolist() == [k * 0.001 for k in range(at + 1)]


def test_a_signal_while_fmus_are_opened_stops_the_run_before_its_first_step() -> None:
    slave = Fake("slave")
    master = Master([slave], {"slave": ["x"]}, [])
    with stopping_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        stop.watch(master)
        master.run(10, np.zeros((11, 0)), lambda _: None)
    assert (stop.signal, slave.steps) == (signal.SIGINT, 0)


@pytest.mark.parametrize("at", [0, 1, 255, 256, 257, 700])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("kind", ["raise", "nan", "-inf"])
def test_the_rows_before_a_failing_step_are_kept(kind: str, coupling: str, at: int) -> None:
    slave = Fake("slave", at)

    def fail() -> None:
        if kind == "raise":
            raise SimulationError("told to", instance="slave")
        slave.value = float(kind)

    slave.act = fail
    outcome, rows = run_fakes(slave, coupling=coupling)
    tick = at if kind == "raise" else at + 1
    assert str(outcome.error).startswith(f"at t = {tick / 1000:.3f} s, in FMU 'slave'")
    assert np.isfinite(rows).all()
    assert rows[:, 0].tolist() == [k * 0.001 for k in range(at + 1)]


def test_rows_of_slow_steps_are_given_away_in_time() -> None:
    """Each step takes 30 ms: no row may wait for the hundreds that would fill a block."""
    given: list[tuple[float, int]] = []
    slave = Fake("slave")
    slow = Fake("slow")
    slow.step = lambda time, step: sleep(0.03)  # type: ignore[method-assign]
    master = Master([slow], {"slow": ["x"]}, [])
    master.run(20, np.zeros((21, 0)), lambda block: given.append((time.monotonic(), len(block))))
    assert slave.steps == 0
    assert len(given) >= 4  # of 0.6 s in all
    assert max(count for _, count in given) <= 8


def sleep(seconds: float) -> None:
    time.sleep(seconds)


# Signals, to whole runs.


@dataclass
class Stopped:
    """How a run was stopped: its exit code, recording, and wall time not in the recording [s]."""

    code: int
    recording: Recording
    lost: float


def stop_run(scenario: Path, out: Path, number: int, delay: float, **options: object) -> Stopped:
    """Start a run at the pace of the clock, and send it a signal after a delay."""
    command = run_command(scenario, out, realtime=1.0, **options)
    with running(command, stdout=subprocess.PIPE, text=True) as process, killed_after(process):
        assert process.stdout is not None
        ticks, then = process.stdout.readline().split()  # it runs
        time.sleep(delay)
        process.send_signal(number)
        killed = time.monotonic()
        for line in process.stdout:
            if float(line.split()[1]) < killed:
                ticks, then = line.split()
        code = process.wait(30)
    recording = Recording.open(out)
    # The last progress before the signal tells when which step was done; steps take 1 ms each.
    lost = killed - float(then) - (recording.rows - float(ticks)) * 0.001
    return Stopped(code, recording, lost)


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_run_keeps_all_that_was_done(
    tmp_path: Path, lasting: Path, number: int, code: int, isolate: bool
) -> None:
    delay = random.Random(number).uniform(0.0, 0.6)
    stopped = stop_run(lasting, tmp_path / "run", number, delay, isolate=isolate)
    assert stopped.code == code
    assert stopped.recording.path.name == "recording.parquet"
    assert stopped.recording.reason == f"stopped by {signal.Signals(number).name}"
    assert not stopped.recording.complete
    assert stopped.lost <= SCHEDULING  # it runs on for a while: what was done is all there
    check_rows(stopped.recording)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["reason"] == stopped.recording.reason
    assert processes_with(str(tmp_path)) == []


def check_rows(recording: Recording) -> None:
    assert recording.time.tolist() == [k * 0.001 for k in range(recording.rows)]
    for block in recording.blocks():
        assert np.isfinite(block).all()


@pytest.mark.parametrize("delay", [0.7, 1.1])
@pytest.mark.parametrize("isolate", [False, True])
def test_a_killed_run_loses_half_a_second_at_most(
    tmp_path: Path, lasting: Path, delay: float, isolate: bool
) -> None:
    killed = stop_run(lasting, tmp_path / "run", signal.SIGKILL, delay, isolate=isolate)
    assert killed.code == -signal.SIGKILL
    assert killed.recording.path.name == "recording.arrows"
    assert not killed.recording.complete
    assert "killed" in str(killed.recording.reason)
    assert killed.lost <= KEPT_BACK + SCHEDULING
    assert killed.recording.rows > 0
    check_rows(killed.recording)
    wait_until(lambda: not processes_with(str(tmp_path)))


def wait_until(done: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


@pytest.mark.long
def test_sixty_kills_at_random_moments(tmp_path: Path, lasting: Path) -> None:
    chance = random.Random(7)
    lost = []
    for count in range(60):
        out = tmp_path / str(count)
        delay = chance.uniform(0.0, 3.0)
        killed = stop_run(lasting, out, signal.SIGKILL, delay, isolate=count % 2 == 0)
        assert killed.code == -signal.SIGKILL
        assert not killed.recording.complete
        check_rows(killed.recording)
        wait_until(lambda: not processes_with(str(out)))  # noqa: B023 - called here and now
        lost.append(killed.lost)
    print(f"60 kills survived; lost at most {max(lost):.3f} s, on average {np.mean(lost):.3f} s")
    assert max(lost) <= KEPT_BACK + SCHEDULING
    assert np.median(lost) <= KEPT_BACK


def test_a_step_that_hangs_can_be_left_by_asking_twice(
    tmp_path: Path, faulty: Path, lasting: Path
) -> None:
    command = run_command(lasting, tmp_path / "run", fmus={"plant": str(faulty)})
    environment = os.environ | {"FAULT": "hang@800"}
    with running(command, env=environment, stdout=subprocess.PIPE) as process:
        line_of(process)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)  # so soon, it is the same wish
        time.sleep(1.3)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == -signal.SIGINT
    recording = Recording.open(tmp_path / "run")
    assert not recording.complete
    check_rows(recording)


# Disks.


def test_a_full_disk_ends_the_run_with_its_rows_kept(tmp_path: Path, lasting: Path) -> None:
    build()
    limit = 1_500_000  # [byte]; a flush writes about 0.4 MB at the pace of the clock
    ended = subprocess.run(
        [*limited(FSIZE=limit), *run_command(lasting, tmp_path / "run", realtime=1.0)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    check_full_disk(ended, tmp_path / "run")


def check_full_disk(ended: subprocess.CompletedProcess[str], run: Path) -> None:
    assert ended.returncode == SimulationError.exit_code, ended.stderr
    line = ended.stderr.strip().splitlines()[-1]
    assert "recording failed after" in line
    assert "free some space or choose another folder" in line
    assert "Traceback" not in ended.stderr
    recording = Recording.open(run)
    assert f"recording failed after {recording.rows} rows" in line
    assert recording.rows > 500
    assert not recording.complete
    check_rows(recording)


def test_a_real_full_disk_does_the_same(tmp_path: Path, lasting: Path) -> None:
    build()
    disk = tmp_path / "disk"
    command = run_command(lasting, disk / "run", realtime=1.0)
    script = '"$@"; code=$?; cp -r "$DISK/run" "$KEEP"; exit $code'
    ended = on_a_small_disk(disk, "1500k", script, command, KEEP=str(tmp_path / "kept"))
    check_full_disk(ended, tmp_path / "kept")


# What is left behind.


def test_a_start_that_is_killed_does_not_harm_the_next(tmp_path: Path, scenario: Path) -> None:
    """Killed while it builds or unpacks."""
    cache = tmp_path / "cache"
    environment = os.environ | {"PANDA_COSIM_CACHE": str(cache)}
    for count, pause in enumerate((0.0, 0.02, 0.3)):
        for place in cache.glob("*"):
            shutil.rmtree(place)
        command = run_command(scenario, tmp_path / f"run{count}")
        with running(command, env=environment, stdout=subprocess.DEVNULL) as process:
            wait_until(lambda: any(cache.rglob(f"{TEMPORARY}*")), 60.0)
            time.sleep(pause)
            process.kill()
        wait_until(lambda: not processes_with(str(tmp_path)))
        done = subprocess.run(
            run_command(scenario, tmp_path / f"next{count}"),
            env=environment,
            check=False,
            timeout=120,
        )
        assert done.returncode == 0


def test_a_run_leaves_nothing_but_its_folder(tmp_path: Path, scenario: Path) -> None:
    """Neither in the working directory nor in the folder for temporary files."""
    build()
    (tmp_path / "tmp").mkdir()
    (tmp_path / "here").mkdir()
    for isolate in (False, True):
        subprocess.run(
            run_command(scenario, tmp_path / f"run-{isolate}", isolate=isolate),
            env=os.environ | {"TMPDIR": str(tmp_path / "tmp")},
            cwd=tmp_path / "here",
            check=True,
            timeout=60,
        )
    assert list((tmp_path / "tmp").iterdir()) == []
    assert list((tmp_path / "here").iterdir()) == []


THREADS = """
import hashlib, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from panda_cosim import run_scenario

scenario, out = sys.argv[1:]
before = [*sys.path, Path.cwd()]

def run(number):
    content = hashlib.sha256()
    for block in run_scenario(scenario, f"{out}/{number}").recording.blocks():
        content.update(block.tobytes())
    return content.hexdigest()

with ThreadPoolExecutor(8) as pool:
    assert len(set(pool.map(run, range(24)))) == 1
assert [*sys.path, Path.cwd()] == before
"""


OPENED = """
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from panda_cosim.fmus.master.fmu import working_directory
from panda_cosim.fmus.master.system import open_slave
from panda_cosim.fmus.files.fmu_file import Fmu

here, fmus = Path.cwd(), [Fmu(Path(path)) for path in sys.argv[1:]]
sys.setswitchinterval(1e-6)  # between any two lines
# Each is elsewhere for a while, in which others would see that.
sys.addaudithook(lambda event, _: time.sleep(0.003) if event == "os.chdir" else None)

def open_and_close(number):
    for i in range(10):
        open_slave("it", fmus[(number + i) % len(fmus)]).close()
        assert working_directory() == here

with ThreadPoolExecutor(8) as pool:
    list(pool.map(open_and_close, range(8)))
"""


def test_eight_threads_that_load_fmus_stay_in_the_working_directory(
    tmp_path: Path, faulty: Path
) -> None:
    """FMPy changes it while it loads a library."""
    controller = build(("controller",), target=Target("python"))["controller"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", OPENED, str(faulty), str(controller)],
        cwd=tmp_path,
        env=os.environ | {"FAULT": "none"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def test_runs_in_eight_threads_do_not_disturb_each_other(tmp_path: Path, scenario: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-c", THREADS, str(scenario), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
