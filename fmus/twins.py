"""Whether code in C may stand in for this project's Python code: while both are proven equal.

Plant, controller and the player of a trajectory exist in Python and in C, and so does the master's
step, as `Step.take` and as a kernel. What is read is Python, so that is what must act: `twins.json`
holds digests of the Python files that each twin in C was compared with, bit for bit. Where a file
says something else today, the Python code runs. Only `.ci/stamp.py` writes `twins.json`, after it
has compared both.
"""

from __future__ import annotations

import ast
import hashlib
import json
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]  # the folder of `assets`, `fmus` and the others
PROVEN: Final = ROOT / "fmus" / "twins.json"
RENEW: Final = "python .ci/stamp.py"
FMUS: Final = ("plant", "controller", "trajectory")
IN_RUNS: Final = ("plant", "controller", "kernel")
# What a tick takes longer in Python, in ticks with all twins (docs/measured.md).
LONGER: Final = {"plant": 1.0, "controller": 4.0, "trajectory": 0.3, "kernel": 0.4}
NAMED: Final = 3  # most files that a notice names


@cache
def changed(twin: str) -> tuple[str, ...]:
    """Files that do not say what the twin in C is proven equal to; paths below `ROOT`."""
    different = [each for each in proven()[twin].items() if raw_digest(each[0]) != each[1][0]]
    return tuple(file for file, (_, meaning) in different if meaning_digest(file) != meaning)


def notice(twins: Iterable[str] = IN_RUNS) -> str:
    """One line on what runs in Python, since it differs from its twin in C; "" if nothing does."""
    by_twin = {twin: changed(twin) for twin in twins if changed(twin)}
    if not by_twin:
        return ""
    files = list(dict.fromkeys(file for each in by_twin.values() for file in each))
    more = ", ..." if len(files) > NAMED else ""
    ticks = 1.0 + sum(LONGER[twin] for twin in by_twin)
    return (
        f"{', '.join(files[:NAMED])}{more}: changed, so that Python runs instead of its twin in "
        f"C: {', '.join(by_twin)} (a tick takes about {ticks:.2g} times as long); once the C code "
        f"follows, `{RENEW}` compares both and renews the stamp"
    )


@cache
def proven() -> dict[str, dict[str, tuple[str, str]]]:
    """Digests of bytes and of meaning of the files that each twin was compared with."""
    read: dict[str, dict[str, tuple[str, str]]] = json.loads(PROVEN.read_bytes())
    return read


@cache
def raw_digest(file: str) -> str:
    """Hash of a file's bytes; "" if there is none."""
    try:
        with open(f"{ROOT}/{file}", "rb") as opened:  # noqa: PTH123 - takes half the time
            return _hash(opened.read())
    except OSError:
        return ""


def meaning_digest(file: str) -> str:
    """Hash of what a Python or TOML file says, without comments and docstrings."""
    # It takes 4 ms, and is only asked for where the bytes differ.
    try:
        text = (ROOT / file).read_text(encoding="utf-8")
        return _hash((_code(text) if file.endswith(".py") else repr(tomllib.loads(text))).encode())
    except (OSError, ValueError, SyntaxError):  # it is gone, or no such file any more
        return ""


def _code(text: str) -> str:
    """Return Python code in one form, without comments and strings that stand alone."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [line for line in node.body if not _is_text(line)]
    return ast.unparse(tree)


def _is_text(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(getattr(line.value, "value", None), str)


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
