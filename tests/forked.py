"""Commands and jobs in processes of their own, forked from one that has imported everything.

Python takes half a second of processor time to start and to import NumPy, MuJoCo and the package,
and the tests need hundreds of processes. What a start itself does (the interpreter's options, what
is imported when, signals) is for `subprocess`; what a command says and does needs only a process
that nothing else has touched.
"""

import atexit
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from panda_cosim.cli.commands import COMMANDS, ELSEWHERE
from panda_cosim.fmus import processes
from panda_cosim.study import work

QUIET = ("--no-video", "--no-view", "--no-plot")  # of `run`
_context = get_context("forkserver")
_context.set_forkserver_preload([
    "pytest", "numpy", "mujoco", "pyarrow.parquet", "fmpy", "scipy.optimize", "scipy.stats",
    "matplotlib.backends.backend_agg", "control", "panda_cosim.fmus.sources.targets",
    "panda_cosim.result.pictures.plot",
    *(f"panda_cosim.cli.commands.{name}" for name in COMMANDS if name not in ELSEWHERE),
])  # fmt: skip


def command(
    *arguments: object,
    code: int | None = None,
    cwd: Path | None = None,
    timeout: float = 300.0,
    **environment: str,
) -> subprocess.CompletedProcess[str]:
    """Run `panda-cosim`, which has to end with the exit code and is killed after `timeout` [s]."""
    words = ["panda-cosim", *map(str, arguments)]
    done = _forked(_command, words, cwd, timeout, environment)
    assert code in (None, done.returncode), f"{words}: {done.returncode}{done.stdout}{done.stderr}"
    return done


def call(
    job: Callable[..., Any], *args: Any, cwd: Path | None = None, timeout: float = 600.0
) -> subprocess.CompletedProcess[str]:
    """Call a function of a module in tests/; the last line of its output is what it returned."""
    file = Path(sys.modules[job.__module__].__file__ or "")
    return _forked(_job, [str(file.parent), file.stem, job.__name__, *args], cwd, timeout, {})


def script(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code with arguments, as `python -P -c` does; it is killed after a minute."""
    return _forked(_script, [code, *arguments], None, 60.0, environment)


def run_pytest(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder."""
    code = "import os, sys, pytest; os.chdir(sys.argv[1]); sys.exit(pytest.main(sys.argv[2:]))"
    return script(code, *map(str, (folder, "-p", "no:cacheprovider", *arguments)))


@contextmanager
def workers() -> Iterator[None]:
    """Have this process fork the workers of sweeps and suites; to start one takes a second."""
    replaced = SimpleNamespace(**{**vars(subprocess), "Popen": _started})
    with patch.object(processes, "subprocess", replaced):
        yield


def _started(command: Sequence[str], **settings: Any) -> Any:
    is_worker = work.MODULE in command
    return (_Worker if is_worker else subprocess.Popen)(command, **settings)


class _Worker(get_context("fork").Process):  # type: ignore[name-defined,misc]
    """A fork, in place of `subprocess.Popen`."""

    returncode = property(lambda self: self.exitcode)

    def __init__(self, command: Sequence[str], env: Mapping[str, str], **_: object) -> None:
        super().__init__(target=_work, args=(*map(int, command[-2:]), env), daemon=True)
        self.start()

    def wait(self, timeout: float | None = None) -> int:
        self.join(timeout)
        if self.exitcode is None:
            raise subprocess.TimeoutExpired("worker", timeout or 0.0)
        return int(self.exitcode)


def _work(socket: int, parent: int, environment: Mapping[str, str]) -> None:
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(work.STANDARD_ERROR, 1)
    os.closerange(3, socket)
    os.closerange(socket + 1, 4096)
    os.environ.clear()
    os.environ.update(environment)
    work.main(socket, parent)


def _forked(
    task: Callable[[list[Any]], None],
    arguments: list[Any],
    cwd: Path | None,
    timeout: float,
    environment: Mapping[str, str],
) -> subprocess.CompletedProcess[str]:
    with tempfile.TemporaryDirectory(prefix="panda-forks-") as folder:
        files = [Path(folder, name) for name in ("output", "errors")]
        args = (files, cwd or Path.cwd(), {**os.environ, **environment}, task, arguments)
        process = _context.Process(target=_begin, args=args)
        process.start()
        process.join(timeout)
        if process.exitcode is None:
            process.kill()
            process.join(60)
            raise subprocess.TimeoutExpired(list(map(str, arguments)), timeout)
        texts = (file.read_text(errors="replace") if file.exists() else "" for file in files)
        return subprocess.CompletedProcess(arguments, process.exitcode, *texts)


# In the forked process.


def _begin(
    files: Sequence[Path],
    cwd: Path,
    environment: Mapping[str, str],
    task: Callable[[list[Any]], None],
    arguments: list[Any],
) -> None:
    for number, path in enumerate(files, 1):
        file = os.open(path, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    try:
        with workers():
            task(arguments)
    finally:  # as at Python's own end
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()


def _command(arguments: list[str]) -> None:
    from panda_cosim.cli import main  # noqa: PLC0415 - in the tests it is not needed

    sys.argv = arguments
    main()


def _script(arguments: list[str]) -> None:
    sys.argv = ["-c", *arguments[1:]]
    exec(arguments[0], {"__name__": "__main__"})


def _job(arguments: list[Any]) -> None:
    folder, module, name, *values = arguments
    sys.path.insert(0, folder)
    result = getattr(import_module(module), name)(*values)
    print(f"\nRESULT {json.dumps(result)}", flush=True)
