"""The processes that the project starts: their environment, and how they end."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

# For every Python process: files in the working directory are data and are never imported.
# Unlike `-P`, it also holds for the Pythons that this one starts.
SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}
PR_SET_PDEATHSIG: Final = 1  # Ref: prctl(2)
STANDARD_ERROR: Final = 2
# What runs a program that ends with its parent, whose number comes first.
_LEASHED: Final = (
    "import os, sys; from panda_cosim.fmus.processes import end_with; end_with(int(sys.argv[1])); "
    "os.execv(sys.argv[2], sys.argv[2:])"
)
ENTERS: Final = "\n" * 1000  # for programs that ask for the key Enter
KEPT_LINES: Final = 50  # of a program's output, which fit a traceback
STARTING: Final = 60.0  # [s] for a nursery to import what is needed
CLOSING: Final = 1.0  # [s] for the last output of a program that has ended


class _Beside:
    """A process that runs beside this one, until `end`."""

    def __init__(self, command: Sequence[str], **settings: Any) -> None:
        self._process = _start(command, **settings).result()

    def ended(self, limit: float | None = None) -> int | None:
        """Wait for its end, for a time [s]; return the exit code, or minus the signal."""
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(limit)
        return None

    def kill(self) -> None:
        """Kill it with all that it has started; who waits for its answer gets an EOFError."""
        _kill_group(self._process)


class Child(_Beside):
    """A Python process with which this one talks over `connection`, and that ends with it.

    Workers, isolated FMUs and the renderer start one each; it calls `listen` for the other end.
    Unlike a process of `multiprocessing`, it neither runs the caller's script nor takes over its
    module path. A program that is only run to its end needs `run`.
    """

    def __init__(
        self,
        *program: str,
        output: int | None = None,
        environment: Mapping[str, str] = MappingProxyType({}),
        files: Sequence[int] = (),  # descriptors that it gets, too
    ) -> None:
        from multiprocessing.connection import Pipe  # noqa: PLC0415 - slow to import

        self.connection, there = Pipe()
        with there:
            super().__init__(
                [sys.executable, *program, str(there.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.DEVNULL if output == subprocess.DEVNULL else None,
                pass_fds=[there.fileno(), *files],
                env={**os.environ, **SAFE_PATH, **environment},
            )

    def end(self) -> int:
        """Kill it, and return how it ended, as `ended` does; may be called again."""
        # One that has ended may have left what it has started; later, its number may be another's.
        if self._process.returncode is None or not self.connection.closed:
            self.kill()
        self.connection.close()
        return self._process.wait()


class Nursery(Child):
    """A Python process that imports once what others need, and forks them, each a `Forked`.

    It calls `nurse`. This process itself is not forked: the locks that its threads hold would stay
    locked.
    """

    def ask(self, number: int, limit: float, files: Sequence[int] = ()) -> Any:
        """Fork a process (0) that gets descriptors, or wait for the end of one for a time [s].

        Returns the number of the new process, or how the other ended, as `Child.ended` does; raises
        EOFError or OSError if there is no answer.
        """
        from multiprocessing.reduction import send_handle  # noqa: PLC0415 - slow to import

        try:
            self.connection.send((number, limit, len(files)))
            for file in files:
                send_handle(self.connection, file, None)
            if not self.connection.poll(limit + CLOSING):
                raise EOFError
            return self.connection.recv()
        except BaseException:  # whatever answer comes later, it is not for the next question
            self.connection.close()
            raise


class Forked:
    """A process that a `Nursery` has forked; otherwise as a `Child`."""

    def __init__(self, nursery: Nursery, *files: int) -> None:
        from multiprocessing.connection import Pipe  # noqa: PLC0415 - slow to import

        self._nursery = nursery
        self._code: int | None = None  # with which it has ended
        self.connection, there = Pipe()
        with there:
            self._number: int = nursery.ask(0, STARTING, [there.fileno(), *files])

    def ended(self, limit: float = CLOSING) -> int | None:
        """Wait for its end, for a time [s]; return the exit code, or minus the signal."""
        if self._code is None:
            try:
                self._code = self._nursery.ask(self._number, limit)
            except (EOFError, OSError):  # it has ended, and all that it has forked with it
                self._code = -signal.SIGKILL
        return self._code

    def end(self) -> None:
        """Kill it with all that it has started; may be called again."""
        if not self.connection.closed:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._number, signal.SIGKILL)
            self.connection.close()
            self.ended()


class Program(_Beside):
    """Any program that runs beside this process, and ends with it.

    The client of a scenario is one. `hear` gets each line of its output, in a thread. Its input is
    empty lines. A Python process with which this one talks is a `Child`; a program that is only run
    to its end needs `run`.
    """

    def __init__(self, command: Sequence[str], folder: Path, hear: Callable[[str], None]) -> None:
        environment = {n: v for n, v in os.environ.items() if n not in SAFE_PATH}
        super().__init__(
            [sys.executable, "-P", "-c", _LEASHED, str(os.getpid()), *command],
            cwd=folder,
            env=environment | {"PYTHONUNBUFFERED": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self.last: deque[str] = deque(maxlen=KEPT_LINES)  # lines of its output
        self._hear = hear
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        process: Any = self._process
        with suppress(OSError), process.stdin as entered:  # it may have ended
            entered.write(ENTERS)
        for line in process.stdout:
            self.last.append(line.rstrip())
            self._hear(line.rstrip())

    def ended(self, limit: float | None = 0.0) -> int | None:
        """Wait for its end and its last output, see `_Beside.ended`."""
        code = super().ended(limit)
        if code is not None:
            self._reader.join(CLOSING)
        return code

    def end(self) -> None:
        """Kill it with all that it has started."""
        self.kill()
        self.ended(None)


def _kill_group(process: subprocess.Popen[Any]) -> None:
    """Kill a process that leads a session, with all that it has started."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def listen(descriptor: int, parent: int) -> Connection:
    """In a child: return its end of the connection, and end with its parent."""
    from multiprocessing.connection import Connection  # noqa: PLC0415 - slow to import

    os.set_inheritable(descriptor, False)  # or a process that an FMU starts would keep it open
    end_with(parent)
    return Connection(descriptor)


def nurse(serve: Callable[..., None], descriptor: int, parent: int) -> None:
    """In a nursery: fork processes, each of which serves, and say how they end."""
    from multiprocessing.reduction import recv_handle  # noqa: PLC0415 - slow to import

    connection, nursery = listen(descriptor, parent), os.getpid()
    with suppress(EOFError, OSError):
        while True:
            number, limit, count = connection.recv()
            if number:
                connection.send(_exit_code(number, limit))
                continue
            files = [recv_handle(connection) for _ in range(count)]
            if os.fork() == 0:
                try:
                    os.setsid()
                    connection.send(os.getpid())
                    connection.close()
                    serve(*files, nursery)
                finally:
                    os._exit(1)
            for file in files:
                os.close(file)


def _exit_code(number: int, limit: float) -> int | None:
    """Wait for the end of a child for a time [s]; return its exit code, or minus the signal."""
    until = time.monotonic() + limit
    while not (ended := os.waitpid(number, os.WNOHANG))[0]:
        if time.monotonic() > until:
            return None
        time.sleep(0.0002)
    return os.waitstatus_to_exitcode(ended[1])


def run(
    command: Sequence[str], folder: Path | None = None, environment: Mapping[str, str] = os.environ
) -> subprocess.CompletedProcess[str]:
    """Run a program, such as a compiler, to its end; if Ctrl-C ends the wait for it, kill it."""
    started = _start(
        command,
        cwd=folder,
        env=dict(environment),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",  # they may write anything
    )
    try:
        output, errors = started.result().communicate()
    except BaseException:
        with started.result() as process:
            _kill_group(process)
        raise
    return subprocess.CompletedProcess(command, started.result().returncode, output, errors)


def _start(command: Sequence[str], **settings: Any) -> Future[subprocess.Popen[Any]]:
    """Start a process that gets no Ctrl-C, and can be killed with all that it has started."""
    # In a thread that lasts: for Linux it is the parent. The exception of a signal, for which
    # `Popen` would forget a process that has just begun, does not come there.
    return _lasting_thread().submit(
        lambda: subprocess.Popen(command, start_new_session=True, **settings)
    )


def last_line(text: str) -> str:
    """Return what a program that failed has said last."""
    return (text.strip().splitlines() or ["no reason is known"])[-1]


def pip(*arguments: str, folder: Path) -> str:
    """Get wheels, with temporary files in a folder; return why it failed, or "" if it did not."""
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:")
    command = [sys.executable, "-m", "pip", *arguments, *options]
    done = run(command, environment=os.environ | {"TMPDIR": str(folder)})
    return last_line(done.stderr) if done.returncode else ""


@cache
def _lasting_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)


os.register_at_fork(after_in_child=_lasting_thread.cache_clear)  # a fork has none of the threads


def end_with(parent: int) -> None:
    """Have the kernel kill this process when its parent ends, for whatever reason; Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it has already ended
            os._exit(1)
