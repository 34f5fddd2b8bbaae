"""The history of `bench`: a line of JSON a run, and whether a ratio has become worse."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any, Final

from ..fmus.errors import InputError
from ..fmus.messages import excerpt
from ..fmus.processes import run
from .benchmark import BenchResult

LAST: Final = 10  # earlier lines whose median counts
FEWEST: Final = 3  # fewer have no median
SLACK: Final = 1.05  # a ratio of the median from which a ratio is worse
HIGHER_IS_BETTER: Final = ("b/c",)
Line = dict[str, Any]


def append(path: Path, result: BenchResult, kind: str) -> list[Line]:
    """Append a run to a history, and return all lines of its kind and machine, the new one last."""
    machine = {key: result.machine[key] for key in ("processor", "cores", "system")}
    same = {"kind": kind, "machine": machine}
    ratios = {name: ratio.median for name, ratio in result.ratios.items()}
    ratios |= {name: value for name, value in result.figures.items() if "_by_" in name}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    new = {"date": date, "commit": _commit(), **same, "ratios": ratios}
    earlier = [line for line in read(path) if same.items() <= line.items()]
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(new) + "\n")
    return [*earlier, new]


def read(path: Path) -> list[Line]:
    """Return the lines of a history; a file that is not there has none."""
    lines = []
    for number, text in enumerate(path.read_text("utf-8").splitlines() if path.exists() else (), 1):
        try:
            lines.append(json.loads(text))
            usable = min(lines[-1]["ratios"].values()) > 0.0
        except (ValueError, TypeError, KeyError, AttributeError):
            usable = False
        if not usable:
            place = f"{path}: line {number}"
            raise InputError(f"{place}: {excerpt(text)}; must be a line of `bench --history`")
    return lines


def compared(lines: list[Line]) -> dict[str, tuple[float, float | None, bool]]:
    """By ratio: the newest, the median of the last ones before it, and whether it is worse."""
    result = {}
    for name, now in lines[-1]["ratios"].items():
        last = [line["ratios"][name] for line in lines[:-1] if name in line["ratios"]][-LAST:]
        before = median(last) if len(last) >= FEWEST else None
        change = 1.0 if before is None else now / before
        result[name] = now, before, (1 / change if name in HIGHER_IS_BETTER else change) > SLACK
    return result


def _commit() -> str:
    """Commit of the code, or "" if it is not a checkout."""
    try:
        return run(["git", "rev-parse", "--short", "HEAD"], Path(__file__).parent).stdout.strip()
    except OSError:  # there is no git
        return ""
