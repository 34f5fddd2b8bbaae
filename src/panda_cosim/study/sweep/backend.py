"""Runs rows in processes of this machine, or on a Dask cluster.

Workers of a cluster need the installed package and no shared folder: the job, FMUs included, goes
once to each, and rows come back as data, in chunks. A chunk runs in a process beside its worker, so
that a crash or a hang costs only a row there, too.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import ExitStack
from copy import copy
from functools import partial
from itertools import islice
from typing import Any, Final

from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.errors import CosimError, one_line
from ...fmus.extras import needing
from ..work import Workers
from .row import Done, Job, Task, first_columns, run_rows, unpack_job

HEARTBEAT: Final = 0.5  # [s] at most between two results, or Nones
GRACE: Final = 5.0  # [s] beyond its time limit after which a row's process is killed
ATTEMPTS: Final = 2  # tries of a row whose process died: the machine may be at fault, not the row
CHUNK: Final = 30.0  # [s] aimed duration of a chunk; a lost worker of a cluster costs this much
FIRST: Final = 4  # rows of a chunk before a row's time is known
LARGEST: Final = 2000  # rows
AHEAD: Final = 2  # chunks handed out for each thread of a cluster
CONNECTING: Final = 30.0  # [s]
# Of a cluster on this machine: what it would tell any user without a key.
NO_HTTP: Final[Mapping[str, list[str]]] = {
    f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker")
}

Rows = Future[list[Done]]


class Backend(ExitStack):
    """Runs rows until it is closed, when those under way are lost."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self._job = job

    def run(self, tasks: Iterable[Task]) -> Iterator[Done | None]:
        """Yield the results of tasks, taken as there is room for them, and None now and then."""
        waiting = iter(tasks)
        pending: dict[Rows, list[Task]] = {}
        while True:
            for _ in range(self._room() - len(pending)):
                if not (chunk := list(islice(waiting, self._size()))):
                    break
                pending[self._submit(chunk)] = chunk
            if not pending:
                return
            for future in wait(pending, HEARTBEAT, FIRST_COMPLETED).done:
                yield from self._result(future, pending.pop(future))
            yield None

    @abstractmethod
    def _room(self) -> int:
        """Return how many chunks may be under way."""

    @abstractmethod
    def _submit(self, chunk: list[Task]) -> Rows:
        """Begin a chunk."""

    def _size(self) -> int:
        """Return how many rows the next chunk should have."""
        return 1

    def _result(self, future: Rows, chunk: list[Task]) -> list[Done]:
        return future.result()

    def _lost(self, status: str, chunk: list[Task], error: str) -> list[Done]:
        """Return the rows of a chunk without an answer."""
        said = {"status": status, "error": error}
        return [Done(task, first_columns(self._job, task) | said) for task in chunk]


class Local(Backend):
    """Runs rows in processes of this machine, so many at a time."""

    def __init__(self, job: Job, jobs: int) -> None:
        super().__init__(job)
        self._jobs = jobs
        self._folder = self.enter_context(temporary_folder(cache_folder()))
        unpack_job(job, self._folder)
        self._workers = self.enter_context(Workers(jobs, ATTEMPTS))

    def _room(self) -> int:
        return self._jobs

    def _submit(self, chunk: list[Task]) -> Rows:
        limit = self._job.time_limit
        late = f"killed {GRACE:g} s after its time limit of {limit or 0:g} s"
        return self._workers.submit(
            run_rows,
            (self._folder, chunk),
            died=partial(self._lost, "failed", chunk),
            late=lambda _: self._lost("timeout", chunk, late),
            time_limit=None if limit is None else limit + GRACE,
        )


def run_chunk(job: Job, tasks: list[Task]) -> list[Done]:
    """Run rows one after the other; called by a cluster's worker."""
    with Local(job, 1) as here:
        return [done for done in here.run(tasks) if done is not None]


class Cluster(Backend):
    """Runs rows on the Dask cluster at an address, or of so many workers here if it is "local"."""

    def __init__(self, job: Job, jobs: int, address: str) -> None:
        super().__init__(job)
        self._address = address
        # What its client logs, with a traceback, is also raised.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            with needing("distributed", "dask", f"--dask {address}"):  # and cryptography
                self._client = self._connected(jobs, address)
        except (OSError, ValueError, TypeError) as error:
            raise CosimError(f"--dask {address}: {one_line(error)}") from error
        self.callback(self._client.close)
        self._submits = self._client.get_executor(pure=False).submit
        # A task, not scattered data: Dask makes a result again if its worker is lost.
        self._shared = self._client.submit(copy, job, pure=False)
        self._seconds = self._rows = 0.0

    def _connected(self, jobs: int, address: str) -> Any:
        import dask  # noqa: PLC0415 - an extra
        import distributed  # noqa: PLC0415

        library: Any = distributed  # it has no types
        cluster = address
        if address == "local":  # with keys of its own, since other users reach its port, too
            with dask.config.set(NO_HTTP):
                cluster = library.LocalCluster(
                    n_workers=jobs, threads_per_worker=1, dashboard_address=None, security=True
                )
            self.callback(cluster.close)
        return library.Client(cluster, timeout=CONNECTING)

    def run(self, tasks: Iterable[Task]) -> Iterator[Done | None]:
        """Run tasks, see `Backend.run`."""
        try:
            yield from super().run(tasks)
        except (CancelledError, OSError) as error:
            raise CosimError(
                f"--dask {self._address}: the scheduler was lost: {one_line(error)}"
            ) from error

    def _room(self) -> int:
        return AHEAD * max(int(sum(self._client.nthreads().values())), 1)

    def _submit(self, chunk: list[Task]) -> Rows:
        submitted: Rows = self._submits(run_chunk, self._shared, chunk)
        return submitted

    def _size(self) -> int:
        if not self._rows:
            return FIRST
        return int(min(max(CHUNK * self._rows / max(self._seconds, 1e-3), 1), LARGEST))

    def _result(self, future: Rows, chunk: list[Task]) -> list[Done]:
        if error := future.exception():  # Dask has given it up
            return self._lost("failed", chunk, f"the cluster lost it: {one_line(error)}")
        self._rows += len(chunk)
        self._seconds += sum(done.row.get("wall_s", 0.0) for done in future.result())
        return future.result()
