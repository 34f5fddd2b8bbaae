"""What the tests of mutated files do in a process of its own: one command after the other."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import re
import resource
import sys
from pathlib import Path

from panda_cosim.scenarios.cli.app import app
from panda_cosim.scenarios.sweep.definition import load_sweep
from panda_cosim.scenarios.sweep.engine import check_sweep
from typer.testing import CliRunner

LIMIT = 60  # [s] of wall time, after which the process is ended and its stacks are told
MEMORY = 6 << 30  # [bytes]
LONGEST = 4100  # characters of a line
TABLES = ("check", "regress")
BAD = re.compile(r"please report it|Traceback|\.py:\d+: \w*Warning|\w(Error|Exception)\(")


def attempt(folder: str, arguments: list[str]) -> str:
    """Run a command in a folder.

    Args:
        folder: Working directory.
        arguments: Of the command.

    Returns:
        What is wrong with how it ended; empty if nothing is.
    """
    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    before = _listed(Path(folder))
    faulthandler.dump_traceback_later(LIMIT, exit=True, file=sys.stderr)
    try:
        if arguments[0] == "sweep" and _is_accepted(arguments[1]):
            return ""
        done = CliRunner().invoke(app, arguments)
    finally:
        faulthandler.cancel_dump_traceback_later()
    new = sorted(_listed(Path(folder)) - before)
    return _wrong(done.exit_code, done.output, new, arguments)


def _is_accepted(file: str) -> bool:
    """Whether a sweep is accepted; it may have 10^6 rows then, and is not run."""
    if file in ("report", "promote"):
        return False
    try:
        check_sweep(load_sweep(file))
    except Exception:
        return False
    return True


def _wrong(code: int, output: str, new: list[str], arguments: list[str]) -> str:
    """What is wrong; `check` and `regress` tell in their tables what they refuse."""
    starts = ("Error:", "wrong ") if arguments[0] == "check" else ("Error:",)
    lines = [line for line in output.splitlines() if line.startswith(starts)]
    may_fail = arguments[0] in ("run", "regress")
    faults = {
        "not an exit code of the program": code not in (0, 1, 2, 3),
        "a fault of the program": "FMU's code cannot start" not in output
        and BAD.search(output) is not None,
        "1 although nothing was simulated": code == 1 and not may_fail,
        f"{len(lines)} lines of error": code == 2
        and len(lines) != 1
        and arguments[0] not in TABLES,
        "a line of many characters": any(len(line) > LONGEST for line in lines),
        f"refused, but wrote {new[:5]}": code == 2 and bool(new),
    }
    found = [fault for fault, holds in faults.items() if holds]
    return f"{', '.join(found)}; exit {code}: {output[-1500:]}" if found else ""


def _listed(folder: Path) -> set[str]:
    """Files and folders, with the sizes and times of files."""
    found = set()
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):
            facts = path.lstat()
            found.add(f"{path} {'' if path.is_dir() else (facts.st_size, facts.st_mtime_ns)}")
    return found
