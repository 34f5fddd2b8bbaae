"""Sweeps on Dask, in processes of their own: its threads and workers end with them."""

import multiprocessing
import os
import signal
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import distributed
import pytest

from panda_cosim.fmus.errors import CosimError
from panda_cosim.study.sweep import backend
from panda_cosim.study.sweep.sweeping import sweep
from sweep_support import short_sweep


def local_cluster(base: str, out: str, samples: int) -> int:
    """Sweep on a cluster started here, and kill one of its workers; returns how many."""
    killed: list[int] = []

    def disturb(done: int, _: int) -> None:
        if done and not killed:
            address = distributed.get_client().scheduler.address
            assert address.startswith("tls://127.0.0.1:")
            with pytest.raises(OSError, match=":"):  # another user has no key
                distributed.Client(address.replace("tls", "tcp"), timeout=2)
            port = distributed.get_client().cluster.scheduler.http_server.port
            with pytest.raises(HTTPError, match="404"):  # nor is there anything to read
                urlopen(f"http://127.0.0.1:{port}/info/main/workers.html", timeout=10)
            worker = multiprocessing.active_children()[0]
            os.kill(worker.pid or 0, signal.SIGKILL)
            killed.append(worker.pid or 0)

    sweep(short_sweep(Path(base), samples), Path(out), dask="local", jobs=2, progress=disturb)
    return len(killed)


def nowhere(base: str, out: str) -> list[object]:
    """Ask for a cluster that is not there; returns the message, and how long it took [s]."""
    backend.CONNECTING = 1.0  # type: ignore[misc]
    began = time.monotonic()
    try:
        sweep(short_sweep(Path(base), 4), Path(out), dask="tcp://127.0.0.1:9")
    except CosimError as error:
        return [str(error), time.monotonic() - began]
    return ["", 0.0]
