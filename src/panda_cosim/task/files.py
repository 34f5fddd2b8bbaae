"""Text files of scenarios: never written over others, and read with clear errors."""

from __future__ import annotations

import csv
import io
import json
import shlex
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..fmus.atomic import MARK, write_whole
from ..fmus.errors import InputError, excerpt, one_line
from ..fmus.reading import open_regular

MODEL_FILE = "plant.mjb"  # of a foreign plant, in `scenario` in the run's folder
MAX_DIGITS = 40  # of an integer; Python would read any number of them
MAX_NAME = 120  # [byte] of a name that becomes part of a file's name, which may have 255

MAX_TOML = 65_536  # [byte] far more than a scenario or sweep needs, and quick to parse
MAX_BYTES = 256 * 1024 * 1024  # of a table; 100 000 rows of 10 long numbers take 25 MB


@dataclass(frozen=True)
class Csv:
    """Cells of a CSV file: names of the columns, and the other rows by their line."""

    names: list[str]
    rows: Mapping[int, list[str]]


def safe_name(name: str) -> str:
    """Turn a name into the name of one file or folder."""
    # Letters, digits and "_.-" stay; all else, path separators included, becomes "_". Leading dots
    # are dropped, so that it is neither hidden nor "..".
    safe = "".join(c if c.isalnum() or c in "_.-" else "_" for c in name).lstrip(".")
    return safe.encode()[:MAX_NAME].decode(errors="ignore") or "unnamed"


def model_file(recording: Any) -> Path | None:
    """Return the model of a recording's foreign plant, kept in its run's folder, if it has one."""
    model = Path(recording.path).parent / "scenario" / MODEL_FILE
    return model if model.is_file() else None


def scenario_files(folder: Path) -> list[Path]:
    """Return all scenario.toml in a folder and below, but for hidden ones and copies in runs."""
    files = sorted(folder.rglob("scenario.toml"))
    return [f for f in files if "/." not in f"/{f.relative_to(folder)}" and not is_copy(f)]


def is_copy(scenario: Path) -> bool:
    """Whether a scenario.toml is what a run keeps of its scenario."""
    return scenario.parent.name == "scenario" and any(scenario.parent.parent.glob("recording.*"))


def as_argument(folder: Path) -> str:
    """Return a scenario's folder as commands take it in a shell."""
    # A bare name gets a "./", as it could be that of a shipped scenario, which takes precedence.
    return shlex.quote(str(folder) if len(folder.parts) > 1 else f"./{folder}")


def read_integer(text: str) -> int | float:
    """Read an integer of a JSON file; one that no signal or count can be becomes a float."""
    return int(text) if len(text) <= MAX_DIGITS else float(text)


def marked_json(text: str) -> str:
    """Add the mark by which later calls may replace it to a JSON object's text."""
    return json.dumps({"note": MARK, **json.loads(text)}, indent=2) + "\n"


def check_new(paths: Iterable[Path]) -> None:
    """Refuse to write a scenario over files that exist."""
    for path in paths:
        if path.exists():
            raise InputError(f"{path}: already exists; must be another folder")


def write_all(contents: Mapping[Path, str]) -> None:
    """Write several new files, each of them whole."""
    check_new(contents)
    for path, text in contents.items():
        write_whole(path, text)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file that a user writes."""
    text = read_text(path, MAX_TOML)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also an integer of thousands of digits
        raise InputError(f"{path}: {error}; must be TOML") from None


def read_text(path: Path, max_bytes: int) -> str:
    """Read a UTF-8 text file, with or without a byte-order mark."""
    with open_regular(path) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise InputError(f"{path}: is too large; must be at most {max_bytes} bytes")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: line {line}: {error.reason}; must be UTF-8 text") from error


def parse_csv(text: str, check: Callable[[list[str]], None] = lambda _: None) -> Csv:
    """Parse a CSV text whose names of columns pass a check; blank lines are skipped.

    Raises:
        InputError: It is no table, or a name occurs twice; the message begins with the line.
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    lines = (cells for cells in reader if any(map(str.strip, cells)))
    rows = {}
    try:
        names = [name.strip() for name in next(lines, [])]
        check(names)
        for name, count in Counter(names).most_common(1):
            if count > 1:
                raise InputError(f"column {excerpt(name)} occurs {count} times; must occur once")
        for cells in lines:
            if len(cells) != len(names):
                must = f"must be {len(names)} ({one_line(','.join(names))})"
                raise InputError(f"{len(cells)} values; {must}")
            rows[reader.line_num] = cells
    except (csv.Error, InputError) as error:
        raise InputError(f"line {reader.line_num}: {error}") from None
    return Csv(names, rows)


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV, floats exactly, as repr() writes them."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
