"""Runs rows on a Dask cluster, in chunks. Workers need the installed package and no shared folder.

The job, FMUs included, is sent once to each worker, and rows come back as data. A chunk runs in a
process beside its worker, as on the pool, so that a crash or a hang costs only a row.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
        self._job = job
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
        """Run tasks, see `Pool.run`."""
        job = self._client.scatter(self._job, broadcast=True)
        waiting = iter(tasks)
        pending: dict[Any, list[Task]] = {}
        while True:
            for chunk in self._chunks(waiting, len(pending)):
                future = self._client.submit(run_chunk, job, chunk, pure=False)
                pending[future] = chunk
            if not pending:
                return
            try:
                ready = self._dask.wait(
                    list(pending), HEARTBEAT, return_when="FIRST_COMPLETED"
                ).done
            except TimeoutError:
                ready = ()
            for future in ready:
                yield from self._result(future, pending.pop(future))
            yield None

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
        """Yield a chunk's rows; if it ended several workers, row by row."""
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
