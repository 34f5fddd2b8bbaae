"""Waits that end: a process that does not answer fails one test, and does not hold up all."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

PATIENCE = 120.0  # [s] for an answer, on a busy machine
_LIMITED = (
    "import os, resource, sys; limits = zip(*[iter(sys.argv[1].split())] * 2); "
    "[resource.setrlimit(getattr(resource, f'RLIMIT_{what}'), 2 * (int(n),)) for what, n in limits]"
    "; os.environ['PYTHONDONTWRITEBYTECODE'] = '1'; os.execvp(sys.argv[2], sys.argv[2:])"
)


@contextmanager
def killed_after(process: Any, seconds: float = PATIENCE) -> Iterator[None]:
    """Kill a process if the block takes too long: what the block reads from it ends then."""
    timer = threading.Timer(seconds, process.kill)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def running(command: Sequence[Any], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a process as `subprocess.Popen` does; at the block's end it is killed if it still runs.

    `Popen`'s own end of the block would wait for it, also after a failed assertion.
    """
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                process.kill()


def ran(
    command: Sequence[Any], code: int | None = 0, timeout: float = 300.0, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command and take what it says; it has to end with an exit code, None for any."""
    options = {"capture_output": True, "text": True} | options
    done = subprocess.run(list(map(str, command)), timeout=timeout, check=False, **options)
    assert code in (None, done.returncode), (
        f"{command}: {done.returncode}{done.stdout}{done.stderr}"
    )
    return done


def line_of(process: subprocess.Popen[Any], seconds: float = PATIENCE) -> Any:
    """Return the next line of a process's output; it is killed if none comes in time."""
    output: IO[Any] | None = process.stdout
    assert output is not None
    with killed_after(process, seconds):
        line = output.readline()
    assert line, f"no further line within {seconds:g} s, or before its end"
    return line


def limited(**limits: int) -> list[str]:
    """Return the beginning of a command line whose process has resource limits, `FSIZE=1000`.

    `preexec_fn` of `subprocess` can hang in a process with threads, and no time limit would end it.
    It writes no bytecode, of which a limited size would leave cut files that end each later start.
    """
    words = " ".join(f"{name} {limit}" for name, limit in limits.items())
    return [sys.executable, "-ISc", _LIMITED, words]


def wait_until(holds: Callable[[], object], process: "subprocess.Popen[str] | None" = None) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert process is None or process.poll() is None
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children(process: int) -> list[int]:
    """Return the processes that a process has started, in any thread."""
    found: list[str] = []
    for thread in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(OSError):  # it has ended
            found += thread.read_text().split()
    return list(map(int, found))
