"""Jobs of tests in processes of their own, and the C compiler."""

import json
import os
import pickle
import shutil
import signal
import sys
import tempfile
import traceback
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn

import pytest

import forked
from panda_cosim.fmus.build import libraries
from panda_cosim.fmus.build.native import NativeFmu
from panda_cosim.fmus.master.calls import Experiment
from panda_cosim.fmus.sources import targets

# The Reference-FMUs of the Modelica Association.
REFERENCE_FMUS = Path(os.environ.get("REFERENCE_FMUS", "missing")).absolute()
needs_reference_fmus = pytest.mark.skipif(
    not (REFERENCE_FMUS / "fmi2" / "Feedthrough.fmu").is_file(), reason="needs REFERENCE_FMUS"
)


def changed_plant(kind: targets.Kind, old: bytes, new: bytes) -> NativeFmu:
    """Return our plant in Python with other code in one place."""
    own = targets.own_code("plant")
    assert sum(text.count(old) for text in own.values()) == 1
    code = {name: text.replace(old, new) for name, text in own.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(targets, "own_code", lambda _: code)
        return targets.own_fmu("plant", kind)


class JobError(AssertionError):
    """A job did not come to its end."""


def in_fork(job: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Call a function in a forked process; return what it returned, or raise JobError."""
    with tempfile.TemporaryFile() as file:
        child = os.fork()
        if child == 0:
            _run_and_exit(file, job, args, options)
        try:
            _, status = os.waitpid(child, 0)
        except BaseException:  # its time is over
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise
        if status:
            raise JobError(f"the process ended with {os.waitstatus_to_exitcode(status)}")
        file.seek(0)
        return pickle.load(file)


def _run_and_exit(
    file: IO[bytes], job: Callable[..., Any], args: Sequence[Any], options: Mapping[str, Any]
) -> NoReturn:
    status = 0
    try:
        pickle.dump(job(*args, **options), file)
        file.flush()
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def in_process(
    job: Callable[..., Any], *args: Any, cwd: Path | None = None, timeout: float = 600.0
) -> Any:
    """Call a function of a module in tests/ in a process that no test has touched.

    What it takes and returns is JSON; it is killed after `timeout` [s].
    """
    child = forked.call(job, *args, cwd=cwd, timeout=timeout)
    results = [line for line in child.stdout.splitlines() if line.startswith("RESULT ")]
    if child.returncode or not results:
        raise JobError(f"{job.__name__} ended with {child.returncode}\n{child.stderr[-6000:]}")
    return json.loads(results[-1][7:])


def copy_libraries(folder: Path, *left_out: str) -> None:
    """Copy what is compiled for this platform, which takes seconds each, but for some backends."""
    folder.mkdir(parents=True, exist_ok=True)
    for backend in libraries.BACKENDS.keys() - set(left_out):
        shutil.copy(libraries.library(backend, libraries.this_platform()), folder)


def initialize(slave: Any, values: Mapping[str, Any]) -> None:
    """Go through initialization, for a second."""
    slave.enter_initialization(values, Experiment(None, 0.0, 1.0))
    slave.exit_initialization()


def members(archive: Path) -> dict[str, bytes]:
    """What is in an archive, an FMU for instance, by name."""
    with zipfile.ZipFile(archive) as file:
        return {name: file.read(name) for name in file.namelist()}


def pack(archive: Path, content: Mapping[str, bytes | str]) -> Path:
    """Write an archive; returns its path."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for name, member in content.items():
            file.writestr(name, member)
    return archive


def compiler() -> str | None:
    """Path of a C compiler, or None."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def sanitizes() -> bool:
    """Whether the C compiler is the machine's: ziglang has no `address`, and builds `thread`."""
    return b"ziglang" not in Path(compiler() or os.devnull).read_bytes()[:200]
