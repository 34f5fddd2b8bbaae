"""A pool of processes on this machine: a crash or a hang costs one row."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from itertools import count
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Final, Self

from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.processes import SAFE_PATH
from ..regression.runner import ONE_THREAD
from .row import Done, Job, Task, first_columns

WORKER: Final = "panda_cosim.scenarios.sweep.worker"
HEARTBEAT: Final = 0.5  # [s] at most between two checks of the clock
GRACE: Final = 5.0  # [s] beyond its time limit after which a row's process is killed
MAX_ROWS: Final = 1000  # rows per process: memory that FMUs leak is returned
ATTEMPTS: Final = 2  # tries of a row whose process died: the machine may be at fault, not the row


class _Worker:
    """A process, and the row it is running.

    Args:
        job: What the rows share.
        folder: New folder for its files.
    """

    def __init__(self, job: Job, folder: Path) -> None:
        here, there = Pipe()
        self.connection: Connection = here
        self.task: Task | None = None
        self.began = math.inf
        self.rows = 0
        self._folder = folder
        self._is_ready = False
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", WORKER),
                *(str(there.fileno()), str(os.getpid()), str(folder)),
            ],
            stdin=subprocess.DEVNULL,
            pass_fds=(there.fileno(),),
            start_new_session=True,
            env={**os.environ, **ONE_THREAD, **SAFE_PATH},
        )
        there.close()
        try:
            with suppress(OSError):  # it has died already; reading its answer will show that
                here.send(job)
        except BaseException:  # Ctrl-C, for example: nobody else knows of the process yet
            self.end()
            raise

    def give(self, task: Task) -> None:
        """Give it a row; its time counts from when the process is ready."""
        self.task = task
        self.began = time.monotonic() if self._is_ready else math.inf
        self.rows += 1
        with suppress(OSError):  # likewise
            self.connection.send(task)

    def ready(self) -> None:
        """Note that it has loaded what it needs and begins with its first row."""
        self._is_ready, self.began = True, time.monotonic()

    def end(self) -> int:
        """End it at once; return its exit code."""
        self.process.kill()
        self.connection.close()
        code = self.process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
        return code

    def leave(self) -> int:
        """Let it end by itself, as its connection has ended; return its exit code."""
        self.connection.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(GRACE)
        return self.end()


class Pool:
    """Runs tasks in several processes.

    Args:
        job: What the tasks share.
        jobs: How many processes.
    """

    def __init__(self, job: Job, jobs: int) -> None:
        self._job = job
        self._jobs = jobs
        self._workers: list[_Worker] = []
        self._again: deque[Task] = deque()
        self._deaths: Counter[int] = Counter()
        self._stack = ExitStack()
        self._folder = self._stack.enter_context(temporary_folder(cache_folder()))
        self._numbers = count()

    def run(self, tasks: Iterable[Task]) -> Iterator[Done | None]:
        """Run tasks, taken from the iterable when there is a free process; the processes stay.

        Yields:
            The result of each task as it ends, and None now and then.
        """
        waiting = iter(tasks)
        try:
            while True:
                self._hand_out(waiting)
                if not any(worker.task for worker in self._workers):
                    return
                done = list(self._collect())
                yield from done
                yield None
        except BaseException:  # the caller has stopped: running rows are lost
            self.close()
            raise

    def close(self) -> None:
        """End all processes; rows under way are lost."""
        with self._stack:  # Ctrl-C may come while idle processes leave: all are ended even so
            for worker in self._workers:
                self._stack.callback(worker.end)
                if worker.task is None:
                    worker.connection.close()
            for worker in self._workers:
                if worker.task is None:
                    worker.leave()
            self._workers.clear()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self.close()

    def _hand_out(self, waiting: Iterator[Task]) -> None:
        idle = [worker for worker in self._workers if worker.task is None]
        while idle or len(self._workers) < self._jobs:
            task = self._again.popleft() if self._again else next(waiting, None)
            if task is None:
                return
            worker = idle.pop() if idle else None
            if worker is not None and worker.rows >= MAX_ROWS:
                self._workers.remove(worker)
                worker.leave()
                worker = None
            if worker is None:
                worker = _Worker(self._job, self._folder / str(next(self._numbers)))
                self._workers.append(worker)
            worker.give(task)

    def _collect(self) -> Iterator[Done]:
        busy = {worker.connection: worker for worker in self._workers if worker.task}
        for connection in wait(list(busy), HEARTBEAT):
            worker = busy[connection]  # type: ignore[index]  # what was waited for
            try:
                done: Done | None = worker.connection.recv()
            except (EOFError, OSError):
                yield from self._died(worker)
            else:
                if done is None:
                    worker.ready()
                    continue
                worker.task = None
                yield done
        if self._job.time_limit is not None:
            yield from self._overdue(self._job.time_limit)

    def _died(self, worker: _Worker) -> Iterator[Done]:
        """Try the row once more; it fails if it ends its process again."""
        self._workers.remove(worker)
        task, code = worker.task, worker.leave()
        assert task is not None  # it was busy
        self._deaths[task.index] += 1
        if self._deaths[task.index] < ATTEMPTS:
            self._again.append(task)
            return
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        yield lost(self._job, task, "failed", f"its process ended with {how}")

    def _overdue(self, limit: float) -> Iterator[Done]:
        """Kill a process that hangs inside an FMU, where a run cannot check the clock."""
        for worker in list(self._workers):
            seconds = time.monotonic() - worker.began
            if worker.task and seconds > limit + GRACE:
                self._workers.remove(worker)
                worker.end()
                said = f"killed {seconds - limit:.0f} s after its time limit of {limit:g} s"
                yield lost(self._job, worker.task, "timeout", said)


def lost(job: Job, task: Task, status: str, error: str) -> Done:
    """Return the row of a task without an answer."""
    row = first_columns(job.scenarios[task.scenario], task)
    return Done(task, {**row, "status": status, "error": error})


__all__ = ["Pool", "lost"]
