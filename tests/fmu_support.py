"""What the tests of FMUs share: jobs in processes of their own, and a host written in C."""

from __future__ import annotations

import json
import math
import os
import select
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import forked
from bounded import PATIENCE, killed_after

JOBS = Path(__file__).parent
HOST_SOURCE = JOBS / "c_host" / "host.c"
OK, WARNING, DISCARD, ERROR, FATAL = range(5)
_RUN_JOB = """
import json, sys
sys.path.insert(0, sys.argv[1])
from importlib import import_module
job = getattr(import_module(sys.argv[2]), sys.argv[3])
print("\\nRESULT " + json.dumps(job(*json.load(sys.stdin))), flush=True)
"""


_WORK = """
import json, sys, traceback
sys.path.insert(0, sys.argv[1])
from importlib import import_module
for line in sys.stdin:
    module, name, arguments = json.loads(line)
    try:
        answer = ["RESULT", getattr(import_module(module), name)(*arguments)]
    except BaseException:
        answer = ["ERROR", traceback.format_exc()]
    print("\\n" + json.dumps(answer), flush=True)
"""


class JobError(AssertionError):
    """A job did not come to its end."""


def in_process(
    job: Callable[..., Any],
    *args: Any,
    cwd: Path | None = None,
    timeout: float = 600.0,
    **environment: str,
) -> Any:
    """Call a function of a module in tests/ in a new process; a forked one, without variables.

    Args:
        job: The function; what it takes and returns is JSON.
        *args: Its arguments.
        cwd: Working directory.
        timeout: After this many seconds it is killed.
        **environment: Variables to set.

    Returns:
        What it returned.

    Raises:
        JobError: It raised, or its process died.
    """
    if environment:
        child = _started(job, args, cwd, timeout, environment)
    else:
        child = forked.call(job, *args, cwd=cwd, timeout=timeout)
    results = [line for line in child.stdout.splitlines() if line.startswith("RESULT ")]
    if child.returncode or not results:
        raise JobError(f"{job.__name__} ended with {child.returncode}\n{child.stderr[-6000:]}")
    return json.loads(results[-1][7:])


def _started(
    job: Callable[..., Any],
    args: Sequence[Any],
    cwd: Path | None,
    timeout: float,
    environment: Mapping[str, str],
) -> subprocess.CompletedProcess[str]:
    """Start Python with these variables for a job."""
    module = Path(sys.modules[job.__module__].__file__ or "").stem
    return subprocess.run(
        [sys.executable, "-c", _RUN_JOB, str(JOBS), module, job.__name__],
        input=json.dumps(args),
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env=os.environ | environment,
        timeout=timeout,
    )


class Worker:
    """A process that does one job after the other; much faster than one for each.

    Args:
        folder: Folder for its standard error.
    """

    def __init__(self, folder: Path) -> None:
        self._errors = (folder / "worker.log").open("w+")
        self._process = subprocess.Popen(
            [sys.executable, "-c", _WORK, str(JOBS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )

    def do(self, job: Callable[..., Any], *args: Any, seconds: float = 600.0) -> Any:
        """Call a function there, as `in_process` does; the process is killed after these [s]."""
        module = Path(sys.modules[job.__module__].__file__ or "").stem
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps([module, job.__name__, args]) + "\n")
        self._process.stdin.flush()
        with killed_after(self._process, seconds):
            for line in self._process.stdout:
                if line.startswith('["'):
                    kind, result = json.loads(line)
                    if kind == "ERROR":
                        raise JobError(result)
                    return result
        self._errors.seek(0)
        said = self._errors.read()[-6000:]
        raise JobError(f"the process died, or had no answer for {seconds:g} s:\n{said}")

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.close()
        self._process.wait(30)
        self._process.stdout.close()
        self._errors.close()


def compiler() -> str | None:
    """Path of a C compiler, or None."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def compile_host(folder: Path) -> Path:
    """Compile the host; returns the program."""
    program = folder / "host"
    tool = compiler()
    assert tool
    subprocess.run(
        [tool, "-std=gnu11", "-Wall", "-Wextra", "-O1", "-o", program, HOST_SOURCE, "-ldl"],
        check=True,
        timeout=300,
    )
    return program


def resources_uri(folder: Path) -> str:
    """URI of an unpacked FMU's resources."""
    return "file://" + quote(str(folder / "resources"))


class Answer(list[float]):
    """What the host answered: values, with status, log messages and text beside them."""

    status: int
    messages: list[str]
    text: str


class Host:
    """A running host, with an empty environment.

    Args:
        program: What `compile_host` made.
        environment: Variables that it has.
        log: File for its standard error.
    """

    def __init__(
        self, program: Path, environment: Mapping[str, str] | None = None, log: Path | None = None
    ) -> None:
        self.errors = (log or program.with_suffix(".log")).open("w+b")
        self._buffer = b""
        self.process = subprocess.Popen(
            [program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env=dict(environment or {}),
            text=True,
            bufsize=1 << 16,
        )

    def __enter__(self) -> Host:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE)
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            pipe.close()  # type: ignore[union-attr]

    def send(self, *words: object) -> None:
        """Give a command."""
        assert self.process.stdin
        self.process.stdin.write(" ".join(map(_word, words)) + "\n")

    def answer(self) -> Answer:
        """Take the answer of one command."""
        assert self.process.stdin
        self.process.stdin.flush()
        answer = Answer()
        answer.messages = []
        while line := self._line():
            if line.startswith("!"):
                answer.messages.append(line[2:].rstrip("\n"))
            elif line.startswith("="):
                status, _, rest = line[2:].rstrip("\n").partition(" ")
                answer.status, answer.text = int(status), rest
                answer.extend(_values(rest))
                return answer
        code = self.process.wait(PATIENCE)
        self.errors.seek(0)
        raise JobError(f"the host died with {code}:\n{self.errors.read().decode()[-3000:]}")

    def _line(self) -> str:
        """Take the next line of its output, or nothing at its end."""
        assert self.process.stdout
        while b"\n" not in self._buffer:
            if not select.select([self.process.stdout], [], [], PATIENCE)[0]:
                raise JobError(f"the host has no answer for {PATIENCE:g} s")
            part = os.read(self.process.stdout.fileno(), 1 << 16)
            if not part:
                return ""
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode() + "\n"

    def __call__(self, *words: object) -> Answer:
        """Give a command and take its answer."""
        self.send(*words)
        return self.answer()

    def load(self, library: int, folder: Path, model: str) -> Answer:
        """Load an unpacked FMU's library."""
        return self("lib", library, folder / "binaries" / "linux64" / f"{model}.so")

    def close(self) -> int:
        """Let the host end by itself; returns its exit code."""
        assert self.process.stdin
        self.process.stdin.close()
        return self.process.wait(30)


def _values(rest: str) -> Sequence[float]:
    try:
        return [float.fromhex(word) for word in rest.split()]
    except ValueError:  # a String variable's
        return []


def _word(value: object) -> str:
    if isinstance(value, float):
        return value.hex() if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple)):
        return " ".join(map(_word, value))
    return str(value)
