"""A Dask cluster gives the same table as this machine's pool, also where workers are lost."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from bounded import killed_after
from fmu_support import in_process
from panda_cosim.scenarios.sweep.engine import sweep
from panda_cosim.scenarios.sweep.store import Store
from sweep_support import rows_of, short_sweep, write_sweep

distributed = pytest.importorskip("distributed")
import dask_jobs  # noqa: E402 - needs it

pytestmark = pytest.mark.fmu
SAMPLES = 16
PANDA_COSIM = str(Path(sys.executable).with_name("panda-cosim"))


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sweep on this machine's pool."""
    folder = tmp_path_factory.mktemp("dask")
    sweep(short_sweep(folder, SAMPLES), folder / "pool", jobs=2)
    return folder


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start one of Dask's programs in a folder of its own, with a cache of its own."""
    folder.mkdir()
    environment = os.environ | {"PANDA_COSIM_CACHE": str(folder / "cache")}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + arguments[0], *arguments[1:]],
            cwd=folder, env=environment, stdout=log, stderr=log,
        )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        with killed_after(process, 30):
            process.wait(60)


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start a scheduler; yields it and its address."""
    port = free_port()
    ports = ("--port", str(port), "--no-dashboard", "--host", "127.0.0.1")
    with started(folder, "dask_scheduler", *ports) as process:
        yield process, f"tcp://127.0.0.1:{port}"


def worker(folder: Path, address: str) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Start a worker of one thread."""
    more = ("--no-nanny", "--nthreads", "1", "--no-dashboard", "--death-timeout", "60")
    return started(folder, "dask_worker", address, *more)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def test_a_local_cluster_gives_the_table_of_the_pool_though_a_worker_is_killed(
    base: Path, tmp_path: Path
) -> None:
    pytest.importorskip("cryptography")
    out = tmp_path / "out"
    assert in_process(dask_jobs.local_cluster, str(base), str(out), SAMPLES, timeout=540) == 1
    assert rows_of(out) == rows_of(base / "pool")


def test_a_lost_scheduler_ends_the_sweep_in_order(tmp_path: Path) -> None:
    samples = 4000  # more than are done by then
    write_sweep(tmp_path, samples)
    with (
        scheduler(tmp_path / "scheduler") as (lost, address),
        worker(tmp_path / "worker", address),
    ):
        arguments = [PANDA_COSIM, "sweep", "sweep.toml", "--dask", address]
        pipe = subprocess.PIPE
        running = subprocess.Popen(arguments, cwd=tmp_path, stderr=pipe, text=True)
        with killed_after(running, 300):
            while running.poll() is None and not any(tmp_path.glob("runs/*/results/part-*")):
                time.sleep(0.05)
            lost.kill()
            said = running.communicate(timeout=120)[1]
    assert running.returncode == 1
    assert "Traceback" not in said
    assert f"Error: --dask {address}: the scheduler was lost: " in said
    (folder,) = (tmp_path / "runs").iterdir()
    done = len(Store(folder).done())
    assert 0 < done < samples
    assert f"The same command with --out runs/{folder.name} resumes it." in said


def test_a_cluster_that_is_not_there_is_reported(base: Path, tmp_path: Path) -> None:
    said, seconds = in_process(dask_jobs.nowhere, str(base), str(tmp_path / "out"), timeout=540)
    assert said.startswith("--dask tcp://127.0.0.1:9")
    assert seconds < 60
