"""No test waits without an end: one process that hangs would hold up all tests."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

FILES = sorted(Path(__file__).parent.glob("*.py"))
RUNS = ("subprocess.run", "subprocess.check_output", "subprocess.check_call")
WAITS = ("wait", "communicate", "join")  # without arguments: without an end
FORKS = "fmu_support.py"  # and ends with its test


def without_end(call: ast.Call, file: str) -> bool:
    """Whether a call may wait for ever, as far as its text tells."""
    function, named = ast.unparse(call.func), {each.arg for each in call.keywords}
    if "preexec_fn" in named:  # hangs now and then where there are threads
        return True
    if function in RUNS:
        return "timeout" not in named
    if function in ("os.fork", "os.wait", "os.waitpid"):  # of a process with threads, likewise
        return file != FORKS
    waits = isinstance(call.func, ast.Attribute) and call.func.attr in WAITS
    return waits and not call.args and "timeout" not in named


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_every_wait_has_an_end(path):
    calls = [node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Call)]
    endless = [f"line {c.lineno}: {ast.unparse(c)}" for c in calls if without_end(c, path.name)]
    assert endless == [], "give it a timeout; see bounded.py"
