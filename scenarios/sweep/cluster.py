"""Runs rows on a Dask cluster, in chunks. Workers need the installed package and no shared folder.

The job, FMUs included, goes once to each worker, and rows come back as data. A chunk runs in a
process beside its worker, as on the pool, so that a crash or a hang costs only a row.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from itertools import islice
from typing import Any, Final

from ...fmus.errors import CosimError, InputError
from ...fmus.messages import one_line
from .pool import HEARTBEAT, Pool, lost
from .row import Done, Job, Task

CHUNK: Final = 30.0  # [s] wanted duration of a chunk; a lost worker costs this much
FIRST: Final = 4  # rows of a chunk before a row's time is known
LARGEST: Final = 2000  # rows
AHEAD: Final = 2  # chunks handed out for each thread of the cluster
CONNECTING: Final = 30.0  # [s]


def keep(job: Job) -> Job:
    """Return the job; called by a worker, which holds the result for its chunks."""
    return job


def run_chunk(job: Job, tasks: list[Task]) -> list[Done]:
    """Run rows one after the other; called by a worker."""
    with Pool(job, 1) as pool:
        return [done for done in pool.run(tasks) if done is not None]


class Cluster:
    """Runs tasks on a Dask cluster.

    Args:
        job: What the tasks share.
        jobs: Workers of a cluster that is started here.
        address: The scheduler's address, or "local" to start one.

    Raises:
        InputError: Dask is not installed.
        CosimError: The address does not answer.
    """

    def __init__(self, job: Job, jobs: int, address: str) -> None:
        try:
            import distributed  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            raise InputError(f"--dask: {error}; pip install 'panda-cosim[dask]'") from None
        # What its client logs, with a traceback, is also raised.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._job, self._address = job, address
        self._dask: Any = distributed  # it has no types
        self._local: Any = None
        self._client: Any
        if address == "local":
            self._local = self._started(jobs)
            self._client = self._dask.Client(self._local)
        else:
            try:
                self._client = self._dask.Client(address, timeout=CONNECTING)
            except (OSError, ValueError, TypeError) as error:
                raise CosimError(f"--dask {address}: {one_line(error)}") from error
        # A task, not scattered data: Dask makes a result again if its worker is lost.
        self._shared = self._client.submit(keep, job, pure=False)
        self._seconds = self._rows = 0.0

    def _started(self, jobs: int) -> Any:
        """Start a cluster here, with keys of its own.

        A scheduler runs what anybody sends to its port, and other users of the machine reach it.
        """
        try:
            return self._dask.LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, security=True
            )
        except ImportError as error:  # of cryptography
            raise InputError(
                f"--dask local: {one_line(error)}; pip install 'panda-cosim[dask]'"
            ) from None

    def close(self) -> None:
        """Cancel running chunks, and end a cluster started here."""
        try:
            self._client.close()
        finally:
            if self._local is not None:
                self._local.close()

    def run(self, tasks: Iterable[Task]) -> Iterator[Done | None]:
        """Run tasks, see `Pool.run`.

        Raises:
            CosimError: The scheduler is gone.
        """
        waiting = iter(tasks)
        pending: dict[Any, list[Task]] = {}
        while True:
            try:
                ready = self._step(waiting, pending)
            except (CancelledError, OSError) as error:
                raise CosimError(
                    f"--dask {self._address}: the scheduler was lost: {one_line(error)}"
                ) from error
            for future in ready:
                yield from self._result(future, pending.pop(future))
            if not (ready or pending):
                return
            yield None

    def _step(self, waiting: Iterator[Task], pending: dict[Any, list[Task]]) -> set[Any]:
        """Hand out chunks, and wait a moment; returns what is ready."""
        for chunk in self._chunks(waiting, len(pending)):
            pending[self._client.submit(run_chunk, self._shared, chunk, pure=False)] = chunk
        if not pending:
            return set()
        try:
            return set(
                self._dask.wait(list(pending), HEARTBEAT, return_when="FIRST_COMPLETED").done
            )
        except TimeoutError:
            return set()

    def _chunks(self, waiting: Iterator[Task], pending: int) -> Iterator[list[Task]]:
        """Yield chunks, as many as the cluster's threads should have queued."""
        threads = sum(self._client.nthreads().values())
        for _ in range(max(threads, 1) * AHEAD - pending):
            if not (chunk := list(islice(waiting, self._size()))):
                return
            yield chunk

    def _size(self) -> int:
        if not self._rows:
            return FIRST
        return int(min(max(CHUNK * self._rows / max(self._seconds, 1e-3), 1), LARGEST))

    def _result(self, future: Any, chunk: list[Task]) -> Iterator[Done]:
        """Yield a chunk's rows; where Dask has given it up, a failed row for each task."""
        if future.status == "finished":
            for done in future.result():
                self._rows += 1
                self._seconds += done.row.get("wall_s", 0.0)
                yield done
        else:
            said = one_line(future.exception())
            for task in chunk:
                yield lost(self._job, task, "failed", f"the cluster lost it: {said}")


__all__ = ["Cluster"]
