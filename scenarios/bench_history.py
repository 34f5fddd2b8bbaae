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
MACHINE: Final = ("processor", "cores", "system")  # what makes a machine
Line = dict[str, Any]


def append(path: Path, result: BenchResult, kind: str) -> list[Line]:
    """Append a run to a history, and return all lines of its kind and machine, the new one last."""
    earlier = read(path)
    ratios = {name: ratio.median for name, ratio in result.ratios.items()}
    ratios |= {name: value for name, value in result.figures.items() if "_by_" in name}
    made = {"kind": kind, "machine": {key: result.machine[key] for key in MACHINE}}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    new = {"date": date, "commit": _commit(), **made, "ratios": ratios}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(new) + "\n")
    return [*(line for line in earlier if made.items() <= line.items()), new]


def read(path: Path) -> list[Line]:
    """Return the lines of a history; a file that is not there has none."""
    texts = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [_line(f"{path}: line {number}", text) for number, text in enumerate(texts, 1)]


def _line(place: str, text: str) -> Line:
    try:
        line: Line = json.loads(text)
        if all(ratio > 0.0 for ratio in line["ratios"].values()):
            return line
    except (ValueError, TypeError, KeyError, AttributeError):
        pass
    raise InputError(f"{place}: {excerpt(text)}; must be a line of `bench --history`")


def medians(lines: list[Line]) -> dict[str, float]:
    """Median by ratio of the last lines before the newest, of which there must be `FEWEST`."""
    values = {
        name: [line["ratios"][name] for line in lines[:-1] if name in line["ratios"]][-LAST:]
        for name in lines[-1]["ratios"]
    }
    return {name: median(each) for name, each in values.items() if len(each) >= FEWEST}


def is_worse(name: str, now: float, before: float) -> bool:
    """Whether a ratio is worse than the median before it by more than `SLACK`."""
    return (before / now if name in HIGHER_IS_BETTER else now / before) > SLACK


def _commit() -> str:
    """Commit of the code, or "" if it is not a checkout."""
    try:
        return run(["git", "rev-parse", "--short", "HEAD"], Path(__file__).parent).stdout.strip()
    except OSError:  # there is no git
        return ""
