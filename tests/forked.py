"""Commands and jobs in processes of their own, forked from one that has imported everything.

Python takes half a second of processor time to start and to import NumPy, MuJoCo and the package,
and the tests need hundreds of processes. What a start itself does (the interpreter's options, what
is imported when, signals) is for `subprocess`; what a command says and does needs only a process
that nothing else has touched.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NoReturn

PRELOADED = (
    "numpy", "mujoco", "pyarrow.parquet", "fmpy", "scipy.optimize", "scipy.stats",
    "matplotlib.backends.backend_agg", "panda_cosim.fmus.sources.targets",
    "panda_cosim.scenarios.pictures.plot",
)  # fmt: skip
_servers: list[tuple[subprocess.Popen[bytes], str]] = []  # one at most, and its socket's folder
_LENGTH = struct.Struct("!Q")
START = 300.0  # [s] for the first process; on a busy machine the imports take a minute or two

# --- In the tests ------------------------------------------------------------------------------


def command(
    *arguments: object,
    cwd: Path | None = None,
    timeout: float = 300.0,
    **environment: str,
) -> subprocess.CompletedProcess[str]:
    """Run `panda-cosim` with these arguments.

    Args:
        *arguments: The command and its arguments.
        cwd: Working directory.
        timeout: After this many seconds it is killed.
        **environment: Variables to set.

    Raises:
        subprocess.TimeoutExpired: It was killed.
    """
    request = {"arguments": ["panda-cosim", *map(str, arguments)]}
    return _forked(request, cwd, timeout, environment)


def call(
    job: Callable[..., Any], *args: Any, cwd: Path | None = None, timeout: float = 600.0
) -> subprocess.CompletedProcess[str]:
    """Call a function of a module in tests/; the last line of its output is what it returned.

    Args:
        job: The function; what it takes and returns is JSON.
        *args: Its arguments.
        cwd: Working directory.
        timeout: After this many seconds it is killed.
    """
    module = Path(sys.modules[job.__module__].__file__ or "").stem
    return _forked({"job": [module, job.__name__, args]}, cwd, timeout, {})


def script(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code with arguments, as `python -P -c` does; it is killed after a minute.

    Args:
        code: What to run.
        *arguments: For `sys.argv`.
        **environment: Variables to set.
    """
    return _forked({"code": code, "arguments": ["-c", *arguments]}, None, 60.0, environment)


def _forked(
    request: dict[str, Any], cwd: Path | None, timeout: float, environment: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    request |= {"cwd": str(cwd or Path.cwd()), "environment": {**os.environ, **environment}}
    process = Forked(request)
    try:
        output, errors = process.communicate(timeout)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        raise
    assert process.returncode is not None
    return subprocess.CompletedProcess(list(request), process.returncode, output, errors)


def start(arguments: Sequence[object], cwd: Path, environment: Mapping[str, str]) -> Forked:
    """Start `panda-cosim` with these arguments, in a session of its own."""
    request = {"arguments": ["panda-cosim", *map(str, arguments)], "session": True}
    return Forked(request | {"cwd": str(cwd), "environment": dict(environment)})


class Forked:
    """A forked process, used as a `subprocess.Popen`.

    Args:
        request: What it is to do.

    Attributes:
        pid: Its number.
        returncode: Its exit code; None: it has not been seen to end.
    """

    def __init__(self, request: dict[str, Any]) -> None:
        self._request = list(request)
        self.returncode: int | None = None
        self._output: IO[bytes] = tempfile.TemporaryFile("w+b")  # noqa: SIM115 - open to its end
        self._errors: IO[bytes] = tempfile.TemporaryFile("w+b")  # noqa: SIM115 - likewise
        self._connection = socket.socket(socket.AF_UNIX)
        self._connection.settimeout(START)
        self._connection.connect(_server())
        text = json.dumps(request).encode()
        with Path(os.devnull).open("rb") as nothing:
            files = [nothing.fileno(), self._output.fileno(), self._errors.fileno()]
            socket.send_fds(self._connection, [_LENGTH.pack(len(text))], files)
        self._connection.sendall(text)
        self.pid = _number(self._connection)

    def wait(self, timeout: float) -> int:
        """Return its exit code, as soon as it has ended.

        Raises:
            subprocess.TimeoutExpired: It goes on.
        """
        if self.returncode is None:
            self._connection.settimeout(max(timeout, 1e-3))
            try:
                self.returncode = _number(self._connection)
            except TimeoutError:
                raise subprocess.TimeoutExpired(self._request, timeout) from None
            self._connection.close()
        return self.returncode

    def poll(self) -> int | None:
        """Return its exit code if it has ended."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Wait for its end; return what it wrote to standard output and standard error."""
        self.wait(timeout)
        with self._output, self._errors:
            return _text(self._output), _text(self._errors)


def _number(connection: socket.socket) -> int:
    """Receive an integer."""
    content = connection.recv(8, socket.MSG_WAITALL)
    assert len(content) == 8, "the process that forks has died"
    return int.from_bytes(content, "big", signed=True)


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


@cache
def _server() -> str:
    """Start the process that forks; returns the path of its socket."""
    folder = tempfile.mkdtemp(prefix="panda-forks-")
    path = str(Path(folder) / "socket")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(path)
        listening.listen(16)
        process = subprocess.Popen(
            [sys.executable, "-P", __file__, str(listening.fileno()), str(os.getpid())],
            pass_fds=[listening.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
    _servers.append((process, folder))
    return path


def end() -> None:
    """End the process that forks, if it has been started."""
    _server.cache_clear()
    while _servers:
        process, folder = _servers.pop()
        process.kill()
        process.wait(30)
        shutil.rmtree(folder, ignore_errors=True)


# --- In the process that forks -------------------------------------------------------------------


def serve(listening: socket.socket, parent: int) -> Callable[[], None]:
    """Answer requests; in a forked process, return what it is to do."""
    gc.freeze()  # so that collections in forked processes touch, and copy, no page of this one
    listening.settimeout(10.0)
    while os.getppid() == parent:
        try:
            connection, _ = listening.accept()
        except TimeoutError:
            continue
        if os.fork() == 0:
            listening.close()
            return _begin(connection)
        connection.close()
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
    raise SystemExit  # the tests have died


def _begin(connection: socket.socket) -> Callable[[], None]:
    """Fork once more, wait for that process, and tell how it ended; in it, return its task."""
    head, files, _, _ = socket.recv_fds(connection, _LENGTH.size, 3)
    (length,) = _LENGTH.unpack(head)
    request = json.loads(connection.recv(length, socket.MSG_WAITALL))
    if "session" in request:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the command listens to it
    child = os.fork()
    if child:
        for file in files:
            os.close(file)
        _report(connection, child)
    connection.close()
    if "session" in request:
        os.setsid()
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    return _task(request)


def _report(connection: socket.socket, child: int) -> NoReturn:
    """Tell a process's number, wait for it, and tell its exit code."""
    with suppress(OSError):
        connection.sendall(child.to_bytes(8, "big", signed=True))
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        connection.sendall(code.to_bytes(8, "big", signed=True))
    os._exit(0)


def _task(request: dict[str, Any]) -> Callable[[], None]:
    if "arguments" in request:
        from panda_cosim.scenarios.cli import main  # noqa: PLC0415

        sys.argv = request["arguments"]
        code = request.get("code")
        return main if code is None else partial(exec, code, {"__name__": "__main__"})
    module, name, arguments = request["job"]

    def run() -> None:
        result = getattr(import_module(module), name)(*arguments)
        print(f"\nRESULT {json.dumps(result)}", flush=True)

    return run


def _main(listening: int, parent: int) -> None:
    """Import what takes time, and fork from then on."""
    sys.path.insert(0, str(Path(__file__).parent))
    from panda_cosim.scenarios.cli.app import load  # noqa: PLC0415
    from panda_cosim.scenarios.cli.commands import COMMANDS  # noqa: PLC0415

    for module in PRELOADED:
        import_module(module)
    for name in COMMANDS:
        load(name)
    task = serve(socket.socket(socket.AF_UNIX, fileno=listening), parent)
    code = 0
    try:
        task()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    # Python's own end, but without taking every module apart, which would copy all memory.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    _main(*map(int, sys.argv[1:]))
