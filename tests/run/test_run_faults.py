"""Whatever happens to a run, its recording opens, is complete up to then, and gives the reason."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import forked
from bounded import killed_after, line_of, ran, running, wait_until
from fault_support import build_faulty, processes_with, run_command, run_with_fault, write_scenario
from panda_cosim import InputError, Options, Recording, Scenario, SimulationError, run_scenario
from panda_cosim.fmus.atomic import TEMPORARY
from panda_cosim.fmus.master import nursery

KEPT_BACK = 0.5  # [s] of wall time that a SIGKILL may cost
SCHEDULING = 0.5  # [s] that a busy machine may keep a process from running


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    return build_faulty(tmp_path_factory.mktemp("faulty"))


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.1)


@pytest.fixture(scope="module")
def lasting(tmp_path_factory):
    return write_scenario(tmp_path_factory.mktemp("scenario") / "lasting", 60.0)


def check_rows(recording: Recording) -> None:
    assert recording.time.tolist() == [k * 0.001 for k in range(recording.rows)]
    for name in recording.columns:
        assert np.isfinite(recording[name]).all()


IN_STEP = "SimulationError: at t = 0.019 s, in FMU 'plant': "
EXIT = "Error: .*: exit\\(\\) was called, by an FMU for instance"
# What an FMU does, whether it has a process of its own, the exit code and the line that say so, and
# the rows that are kept: all up to the fault, None that can be relied on, or no folder at all (0).
FAULTS: list[tuple[str, bool, int, str, int | None]] = [
    ("raise@20", False, 1, IN_STEP + "fmi2DoStep returned Fatal: .*told to", 20),
    ("nan@20", False, 1,
     r"SimulationError: at t = 0.020 s, in FMU 'plant', variable hand_xpos\[2\]: value nan", 20),
    ("segfault@20", False, -signal.SIGSEGV, "", None),
    ("c-exit@20", False, 1, EXIT, None),
    ("c-exit@init", False, 1, EXIT, 0),
    ("raise@20", True, 1, IN_STEP + "fmi2DoStep returned .*told to", 20),
    ("segfault@20", True, 1, IN_STEP + "its process was ended by SIGSEGV", 20),
    ("orphan@20", True, 1, IN_STEP + "its process ended with exit code 3", 20),
    ("hang@20", True, 1, IN_STEP + "no answer for 0.4 s, so its process was ended", 20),
    ("exit@init", True, 1, "SimulationError: in FMU 'plant': its process ended", 0),
]  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "isolate", "code", "line", "rows"), FAULTS, ids=[f"{f[0]}-{f[1]}" for f in FAULTS]
)
def test_a_failing_fmu_ends_the_run_as_a_failure_with_its_rows_kept(
    tmp_path, faulty, scenario, fault, isolate, code, line, rows
):
    out = tmp_path / "run"
    options = {"isolate": True, "step_timeout": 0.4} if isolate else {}
    ended = run_with_fault(faulty, scenario, out, fault, **options)
    assert ended.returncode == code, ended.stderr
    last = ended.stderr.strip().splitlines()[-1] if line else ""
    assert re.match(line, last), ended.stderr
    assert "Traceback" not in ended.stderr
    assert processes_with(str(tmp_path)) == []
    assert processes_with("300.25") == []
    assert out.exists() == (rows != 0)
    if rows == 0:
        return
    stream = out / "recording.arrows"
    if rows is None and not stream.stat().st_size:  # it ended before a thread had written the head
        with pytest.raises(InputError, match="is not an Arrow stream"):
            Recording.open(out)
        return
    recording = Recording.open(out)
    check_rows(recording)
    assert not recording.complete
    if rows:
        assert recording.rows == rows
        assert recording.reason == last
        summary = json.loads((out / "summary.json").read_text())
        assert summary["complete"] is summary["success"] is False
        assert summary["reason"] == last


# Signals.


def stop_run(scenario: Path, out: Path, number: int, **options: object) -> SimpleNamespace:
    """Stop a run at the pace of the clock by a signal; see how much of the wall time is lost."""
    command = run_command(scenario, out, realtime=1.0, **options)
    with running(command, stdout=subprocess.PIPE, text=True) as process, killed_after(process):
        assert process.stdout is not None
        ticks, then = process.stdout.readline().split()  # it runs
        time.sleep(random.Random(number).uniform(0.2, 0.9))
        process.send_signal(number)
        killed = time.monotonic()
        for line in process.stdout:
            if float(line.split()[1]) < killed:
                ticks, then = line.split()
        code = process.wait(30)
    recording = Recording.open(out)
    # The last progress before the signal tells when which step was done; steps take 1 ms each.
    lost = killed - float(then) - (recording.rows - float(ticks)) * 0.001
    return SimpleNamespace(code=code, recording=recording, lost=lost)


@pytest.mark.parametrize(
    ("number", "isolate"),
    [(signal.SIGINT, False), (signal.SIGTERM, True), *((signal.SIGKILL, i) for i in (False, True))],
)
def test_an_ended_run_keeps_all_and_a_killed_one_all_but_half_a_second(
    tmp_path, lasting, number, isolate
):
    ended = stop_run(lasting, tmp_path / "run", number, isolate=isolate)
    check_rows(ended.recording)
    assert not ended.recording.complete
    if number == signal.SIGKILL:
        assert ended.code == -number
        assert "killed" in str(ended.recording.reason)
        assert ended.lost <= KEPT_BACK + SCHEDULING
        wait_until(lambda: not processes_with(str(tmp_path)))
        return
    assert ended.code == 128 + number
    assert ended.recording.reason == f"stopped by {signal.Signals(number).name}"
    assert ended.lost <= SCHEDULING  # it runs on for a while: what was done is all there
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["reason"] == ended.recording.reason
    assert processes_with(str(tmp_path)) == []


@pytest.mark.parametrize(("number", "words"), [
    (signal.SIGKILL, "its process was ended by SIGKILL"), (signal.SIGSTOP, "no answer for 0.5 s"),
])  # fmt: skip
def test_an_fmu_whose_process_ends_or_stops_while_c_steps_it_is_told(
    tmp_path, lasting, number, words
):
    command = run_command(lasting, tmp_path / "run", isolate=True, step_timeout=0.5, realtime=1.0)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    marked = {"env": os.environ | {"MARK": str(tmp_path)}}
    with running(command, **streams, **marked) as process, killed_after(process):
        line_of(process)
        os.kill(max(processes_with(str(tmp_path), "remote_slave")), number)
        assert words in process.communicate(timeout=30)[1].decode()
    assert process.returncode == 1
    assert words in str(Recording.open(tmp_path / "run").reason)
    assert not processes_with(str(tmp_path))


def test_a_process_that_cannot_be_started_is_told(scenario, tmp_path, monkeypatch):
    monkeypatch.setattr(nursery, "_CODE", "")
    with pytest.raises(SimulationError, match="FMU 'controller': its process could not be started"):
        run_scenario(Scenario.read(scenario), tmp_path / "run", Options(isolate=True))


def test_a_step_that_hangs_can_be_left_by_asking_twice(tmp_path, faulty, lasting):
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
    assert not Recording.open(tmp_path / "run").complete


# What is left behind.


def test_a_run_leaves_nothing_but_its_folder(tmp_path, scenario, faulty):
    """Nor does it read or print anything."""
    (tmp_path / "tmp").mkdir()
    (tmp_path / "here").mkdir()
    done = ran(
        run_command(scenario, tmp_path / "run", isolate=True, fmus={"plant": str(faulty)}),
        env=os.environ | {"TMPDIR": str(tmp_path / "tmp"), "FAULT": "read@20"},
        cwd=tmp_path / "here",
        input="x" * 1000,
    )
    assert all(line.split()[0].isdigit() for line in done.stdout.splitlines())
    assert list((tmp_path / "tmp").iterdir()) == []
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.own_process
def test_runs_in_eight_threads_do_not_disturb_each_other(tmp_path, scenario):
    def bits(number: int) -> str:
        return run_scenario(scenario, tmp_path / f"{number}").recording.sha256()

    before = [*sys.path, Path.cwd()]
    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(bits, range(16)))) == 1
    assert [*sys.path, Path.cwd()] == before


# FMUs in processes of their own.


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_isolated_fmus_give_the_same_bits(tmp_path, scenario, coupling):
    rows = []
    for isolate in (False, True):
        _, *command = run_command(scenario, tmp_path / f"{isolate}", isolate=isolate,
                                  coupling=coupling)  # fmt: skip
        assert forked.script(*command[2:]).returncode == 0
        rows.append(Recording.open(tmp_path / f"{isolate}").sha256())
        summary = json.loads((tmp_path / f"{isolate}" / "summary.json").read_text())
        assert summary["stepped_by"] == "kernel"
    assert rows[0] == rows[1]


SLOW = """
import time as clock

class Slow:
    "Holds the arm, slowly."

    def update(self, time, qpos):
        clock.sleep(0.002)
        return [*qpos[:7], 255.0]
"""


@pytest.mark.parametrize("way", [(), ("--master", "fmpy"), ("--isolate",)])
def test_a_profile_tells_which_fmu_takes_the_time_and_in_which_call(tmp_path, scenario, way):
    (tmp_path / "slow.py").write_text(SLOW)
    law = ("--controller", f"{tmp_path}/slow.py:Slow", "--no-video", "--no-view")
    words = ("run", scenario, *law, "--profile", "--out", tmp_path / "run", *way)
    told = forked.command(*words).stdout
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    spent, whole = summary["profile"], summary["timing"]["wall_s"]
    assert spent.keys() == {"controller", "plant"}
    step = "step" if "--isolate" in way else "fmi2DoStep"
    assert 0.1 / 0.001 * 0.002 <= spent["controller"][step] <= whole  # [s] in which it slept
    assert sum(sum(calls.values()) for calls in spent.values()) <= whole
    first = next(line for line in told.splitlines() if f" s of {whole:.3g} s: " in line)
    assert first.startswith("controller (Python): ")


def test_a_killed_master_takes_its_fmus_along(tmp_path, faulty, scenario):
    """Even one that hangs in a step, and so cannot see that the other side has gone."""
    command = run_command(scenario, tmp_path / "run", fmus={"plant": str(faulty)}, isolate=True)
    mark, hangs = str(tmp_path / "hangs"), tmp_path / "hangs"
    environment = os.environ | {"FAULT": "hang@20", "FAULT_FILE": str(hangs)}
    with running(command, env=environment, stdout=subprocess.DEVNULL):  # it is killed at the end
        wait_until(hangs.exists)
        assert len(processes_with(mark, "remote_slave")) == 3  # two, and what forks them
    wait_until(lambda: not processes_with(mark, "remote_slave"))


@pytest.mark.parametrize("seconds", [0.0, float("nan"), float("inf")])
def test_a_step_timeout_is_a_number_above_zero_of_an_isolated_fmu(seconds):
    with pytest.raises(InputError, match=r"--step-timeout: value .*; must be a number above 0"):
        Options(isolate=True, step_timeout=seconds)
    with pytest.raises(InputError, match="needs --isolate"):
        Options(step_timeout=1.0)


# Ctrl-C leaves no process, and no folder of one: it interrupts the build as soon as it has begun.
COMPILER = """#!/bin/sh
sleep 300.75 &
kill -s "$INTERRUPT" $PPID
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
    assert ran([sys.executable, "-c", UNSEEN, str(int(number))], code=128 + number).stderr == ""


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize(("number", "what"), [(signal.SIGINT, "own"), (signal.SIGTERM, "slave")])
def test_a_first_build_that_is_interrupted_ends_its_compilers(tmp_path, number, what):
    compiler, cache = tmp_path / "bin" / "cc", tmp_path / "cache"
    compiler.parent.mkdir()
    compiler.write_text(COMPILER)
    compiler.chmod(0o755)
    variables = {
        "PATH": f"{compiler.parent}{os.pathsep}{os.environ['PATH']}",
        "PANDA_COSIM_CACHE": str(cache),
        "INTERRUPT": number.name.removeprefix("SIG"),
    }
    more = ["--slave", Path(__file__).parents[1] / "slaves" / "decay.py"] if what == "slave" else []
    build = ["build", "--out", tmp_path / "out", *more, tmp_path / "none"]
    done = ran(
        [sys.executable, "-P", "-c", BUILD, *build], code=128 + number, env=os.environ | variables
    )
    assert "Traceback" not in done.stderr
    wait_until(lambda: not processes_with(str(cache), "300.75"))  # the killed may take a moment
    assert not [*cache.rglob(f"{TEMPORARY}*")]
