"""FMUs in processes of their own: the same bits, and nothing that they do ends the run unsaved."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bounded import running
from fault_support import build_faulty, processes_with, run_command, write_scenario
from panda_cosim.fmus.errors import InputError, SimulationError
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.master import remote_slave
from panda_cosim.fmus.master.remote_slave import RemoteSlave
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.run.run import run_scenario
from panda_cosim.scenarios.run.session import Session

pytestmark = pytest.mark.fmu


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_faulty(tmp_path_factory.mktemp("faulty"))


@pytest.fixture(scope="module")
def fmus(faulty: Path) -> dict[str, Path]:
    return build(("controller",)) | {"plant": faulty}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.1)


def digest_of(folder: Path) -> str:
    content = hashlib.sha256()
    for block in Recording.open(folder).blocks():
        content.update(block.tobytes())
    return content.hexdigest()


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_isolated_fmus_give_the_same_bits(tmp_path: Path, scenario: Path, coupling: str) -> None:
    found = []
    for isolate in (False, True):
        out = tmp_path / str(isolate)
        subprocess.run(
            run_command(scenario, out, isolate=isolate, coupling=coupling), check=True, timeout=60
        )
        found.append(digest_of(out))
    assert Recording.open(out).rows == 101
    assert found[0] == found[1]


# What the FMU does at its 20th step, what the message must say, and the time that it names.
FAULTS = {
    "raise": (r"fmi2DoStep returned \w+: .*told to", 19),
    "discard": ("fmi2DoStep returned Discard", 19),
    "nan": (r"variable hand_xpos\[2\]: value nan is not finite", 20),
    # What the wrapper does with a list that is too short may crash it there and then.
    "short": ("fmi2GetReal failed|its process was ended by", 19),
    "segfault": ("its process was ended by SIGSEGV", 19),
    "exit": ("its process ended with exit code 3", 19),
    "orphan": ("its process ended with exit code 3", 19),
    "hang": ("no answer for 0.4 s, so its process was ended", 19),
    "close-fds": ("its process closed its connection", 19),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_whatever_an_isolated_fmu_does_the_run_ends_well(
    tmp_path: Path,
    fmus: dict[str, Path],
    scenario: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
) -> None:
    monkeypatch.setenv("FAULT", f"{fault}@20")
    monkeypatch.setenv("MARK", str(tmp_path))  # by which this test knows its processes
    message, tick = FAULTS[fault]
    options = Options(fmus=fmus, isolate=True, step_timeout=0.4)
    with pytest.raises(SimulationError, match=message) as failed:
        run_scenario(scenario, tmp_path / "run", options)
    assert str(failed.value).startswith(f"at t = {tick / 1000:.3f} s, in FMU 'plant'")
    check_kept(tmp_path / "run", failed.value)
    assert processes_with(f"MARK={tmp_path}", "remote_slave") == []
    assert processes_with(f"MARK={tmp_path}", "300.25") == []


def check_kept(out: Path, error: SimulationError) -> None:
    """Check that a run that failed in its 20th step has kept all rows up to then."""
    recording = Recording.open(out)
    assert recording.path.name == "recording.parquet"
    assert not recording.complete
    assert recording.reason == f"SimulationError: {error}"
    assert recording.time.tolist() == [k * 0.001 for k in range(20)]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["complete"] is summary["success"] is False
    assert summary["reason"] == recording.reason
    left = ["recording.parquet", "scenario", "summary.json"]
    assert sorted(p.name for p in out.iterdir()) == left


@pytest.mark.parametrize("fault", ["new-raise", "new-segfault", "init-raise", "init-exit"])
def test_a_failure_before_the_first_step_is_reported(
    tmp_path: Path,
    fmus: dict[str, Path],
    scenario: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
) -> None:
    monkeypatch.setenv("FAULT", fault)
    with pytest.raises(SimulationError, match=r"^in FMU 'plant': ."):
        run_scenario(scenario, tmp_path / "run", Options(fmus=fmus, isolate=True))
    assert not (tmp_path / "run").exists()


def test_a_hang_before_the_first_step_is_ended_too(
    faulty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_slave, "START_TIMEOUT", 2.0)
    monkeypatch.setenv("FAULT", "init-hang")
    slave = RemoteSlave("plant", Fmu(faulty), step_timeout=0.5)
    with pytest.raises(SimulationError, match="no answer for 2 s"):
        slave.initialize({}, 0.0, 1.0)
    assert slave._process.returncode == -signal.SIGKILL
    slave.close()


def test_a_killed_master_takes_its_fmus_along(tmp_path: Path, faulty: Path, scenario: Path) -> None:
    """Even one that hangs in a step, and so cannot see that the other side has gone."""
    command = run_command(scenario, tmp_path / "run", fmus={"plant": str(faulty)}, isolate=True)
    mark, hangs = str(tmp_path / "hangs"), tmp_path / "hangs"
    environment = os.environ | {"FAULT": "spin@20", "FAULT_FILE": str(hangs)}
    with running(command, env=environment, stdout=subprocess.DEVNULL) as master:
        try:
            wait_until(hangs.exists)
            assert len(processes_with(mark, "remote_slave")) == 2
        finally:
            master.kill()
            master.wait(30)
        wait_until(lambda: not processes_with(mark, "remote_slave"))


def wait_until(done: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def test_closing_twice_and_in_any_state_leaves_no_process(
    faulty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAULT", "none")
    fresh = RemoteSlave("plant", Fmu(faulty))
    fresh.close()
    fresh.close()
    ready = RemoteSlave("plant", Fmu(faulty))
    ready.initialize({}, 0.0, 1.0)
    ready.close()
    ready.close()
    killed = RemoteSlave("plant", Fmu(faulty))
    killed.initialize({}, 0.0, 1.0)
    killed._process.kill()
    killed.close()
    for slave in (fresh, ready, killed):
        assert slave._process.returncode is not None


def test_values_go_through_bit_for_bit(faulty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAULT", "none")
    values = np.array(
        [[0.1, -0.0, 5e-324], [np.inf, np.nan, 1.7976931348623157e308], [1.0, 2.0, 3.0]]
    )
    names = [f"push_force[{i}]" for i in (1, 2, 3)]
    slave = RemoteSlave("plant", Fmu(faulty))
    try:
        slave.initialize({"block_mass": 0.3}, 0.0, 1.0)
        read = np.zeros_like(values)
        put, get = slave.bind_set(names, values), slave.bind_get(names, read)
        for row in range(3):
            put(row)
            get(row)
            slave.step(row * 0.001, 0.001)
        assert read.tobytes() == values.tobytes()
        assert slave.get_real(names).tolist() == [1.0, 2.0, 3.0]
        assert slave.get_real(["block_mass"]).tolist() == [0.3]
    finally:
        slave.close()


@pytest.mark.parametrize("seconds", [0.0, float("nan"), float("inf")])
def test_a_step_timeout_is_a_number_above_zero_of_an_isolated_fmu(seconds: float) -> None:
    with pytest.raises(InputError, match=r"--step-timeout: value .*; must be a number above 0"):
        Options(isolate=True, step_timeout=seconds)
    with pytest.raises(InputError, match="without --isolate"):
        Options(step_timeout=1.0)


def test_what_an_fmu_prints_and_reads_does_not_disturb(
    tmp_path: Path, faulty: Path, scenario: Path
) -> None:
    """The conversation goes over a socket of its own, not over standard input and output."""
    done = subprocess.run(
        run_command(scenario, tmp_path / "run", fmus={"plant": str(faulty)}, isolate=True),
        env=os.environ | {"FAULT": "read@20"},
        input="x" * 1000,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert all(line.split()[0].isdigit() for line in done.stdout.splitlines())


def test_isolated_fmus_outlast_the_thread_that_opened_them(tmp_path: Path, scenario: Path) -> None:
    session = Session(scenario, tmp_path / "run", Options(isolate=True))
    thread = threading.Thread(target=session.open)
    thread.start()
    thread.join(60)
    try:
        time.sleep(0.2)  # enough for a signal to arrive
        assert session.step(20) == 20
    finally:
        session.close()
