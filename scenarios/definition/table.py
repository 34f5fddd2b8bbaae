"""The trajectory table: what the hand shall do, one row a point on its way.

A CSV file with the header `time,frame,x,y,z,qw,qx,qy,qz,grip`. The four q columns may be missing,
or blank in a row, for the hand's home orientation.
"""

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from ...fmus.errors import InputError
from ..checks import (
    check_choice,
    check_number,
    check_numbers,
    excerpt,
    read_text,
    suggestion,
)

FRAMES = ("world", "home", "target")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
COLUMNS = ("time", "frame", "x", "y", "z", *QUATERNION_COLUMNS, "grip")

MAX_TIME = 86_400.0  # s, a day
MIN_GAP = 1e-6  # s between rows; a smaller one is a slip, and its velocity no number
MAX_POSITION = 10.0  # m; the arm reaches 0.855 m
MAX_GRIP = 0.08  # m, the Franka Hand's travel
MAX_QUATERNION_PART = 1e6  # its length is scaled to 1, so any sane scale will do
MIN_QUATERNION_LENGTH = 1e-6
MAX_ROWS = 100_000
_MAX_BYTES = 64 * 1024 * 1024  # 100 000 rows of 10 long numbers take 25 MB

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I | re.A)


@dataclass(frozen=True)
class TableRow:
    """One point on the hand's way.

    Attributes:
        time: When the hand shall be there [s].
        frame: What the position is relative to: the `world` origin, the hand's `home` position,
            or the block's `target` site at the start.
        position: Offset (x, y, z) of the hand's origin from there, in world axes [m].
        grip: Opening between the fingertips [m], from this row's time on.
        orientation: Hand to world, (w, x, y, z), scaled to length 1; None for that of `home`.

    Raises:
        InputError: A value is out of its bounds.
    """

    time: float
    frame: str
    position: tuple[float, float, float]
    grip: float
    orientation: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check all values and scale the orientation."""
        check_choice("column frame", self.frame, FRAMES)
        time = check_number("column time", self.time, 0.0, MAX_TIME, "s")
        grip = check_number("column grip", self.grip, 0.0, MAX_GRIP, "m")
        places = [f"column {axis}" for axis in "xyz"]
        position = check_numbers(places, self.position, -MAX_POSITION, MAX_POSITION, "m")
        for name, value in (("time", time), ("grip", grip), ("position", position)):
            object.__setattr__(self, name, value)
        if self.orientation is not None:
            object.__setattr__(self, "orientation", _unit_quaternion(self.orientation))


@dataclass(frozen=True)
class TrajectoryTable:
    """The rows of a trajectory, in the order of time.

    Raises:
        InputError: There are too few or too many rows, or times repeat or go back.
    """

    rows: tuple[TableRow, ...]

    def __post_init__(self) -> None:
        """Check the number of rows and the order of their times."""
        object.__setattr__(self, "rows", tuple(self.rows))
        if len(self.rows) < 2:
            raise InputError(f"{len(self.rows)} rows; must be at least 2")
        if len(self.rows) > MAX_ROWS:
            raise InputError(f"{len(self.rows)} rows; must be at most {MAX_ROWS}")
        for number, (before, after) in enumerate(zip(self.rows, self.rows[1:], strict=False), 2):
            try:
                _check_order(before.time, after.time)
            except InputError as error:
                raise InputError(f"row {number}, {error}") from None

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a table from a CSV file (UTF-8, byte-order mark and CRLF accepted).

        Raises:
            InputError: The file cannot be used; the message names line, column and value.
        """
        text = read_text(Path(path), _MAX_BYTES)
        try:
            rows = _parse(text)
            return cls(tuple(rows))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _unit_quaternion(parts: object) -> tuple[float, ...]:
    bound = MAX_QUATERNION_PART
    places = [f"column {name}" for name in QUATERNION_COLUMNS]
    quaternion = check_numbers(places, parts, -bound, bound)
    length = math.hypot(*quaternion)
    if length < MIN_QUATERNION_LENGTH:
        raise InputError(
            f"columns qw to qz: quaternion {excerpt(quaternion)} of length {length:g}; "
            "must be longer than 0, or blank for the home orientation"
        )
    return tuple(part / length for part in quaternion)


def _check_order(before: float, after: float) -> None:
    if after - before < MIN_GAP:
        slip = "repeats" if after == before else "goes back" if after < before else "is too close"
        raise InputError(
            f"column time: value {after!r} {slip}; must be at least {MIN_GAP:g} s after {before!r}"
        )


def _parse(text: str) -> list[TableRow]:
    """Parse the file's text; errors name the line."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: tuple[str, ...] | None = None
    rows: list[TableRow] = []
    try:
        for cells in reader:
            stripped = [cell.strip() for cell in cells]
            if not any(stripped) and len(stripped) <= 1:
                continue  # a blank line
            if header is None:
                header = _check_header(stripped)
                continue
            rows.append(_parse_row(dict(_pair(header, stripped))))
            if len(rows) > MAX_ROWS:
                raise InputError(f"more than {MAX_ROWS} rows; must be at most that")
            if len(rows) > 1:
                _check_order(rows[-2].time, rows[-1].time)
    except (csv.Error, InputError) as error:
        raise InputError(f"line {reader.line_num}: {error}") from None
    return rows


def _check_header(names: list[str]) -> tuple[str, ...]:
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        raise InputError("columns are separated by ';' or tab; must be separated by commas")
    for name in names:
        if name not in COLUMNS:
            hint = suggestion(name, COLUMNS)
            raise InputError(
                f"column {excerpt(name)} is unknown; valid: {', '.join(COLUMNS)}{hint}"
            )
        if names.count(name) > 1:
            raise InputError(f"column {name} occurs {names.count(name)} times; must occur once")
    optional = () if set(QUATERNION_COLUMNS) & set(names) else QUATERNION_COLUMNS
    missing = [name for name in COLUMNS if name not in names and name not in optional]
    if missing:
        raise InputError(f"columns {', '.join(missing)} are missing; valid: {', '.join(COLUMNS)}")
    return tuple(names)


def _pair(header: tuple[str, ...], cells: list[str]) -> list[tuple[str, str]]:
    if len(cells) != len(header):
        raise InputError(f"{len(cells)} values; must be {len(header)} ({','.join(header)})")
    return list(zip(header, cells, strict=True))


def _parse_row(cells: dict[str, str]) -> TableRow:
    parts = [cells.get(name, "") for name in QUATERNION_COLUMNS]
    if any(parts) and not all(parts):
        blank = QUATERNION_COLUMNS[parts.index("")]
        raise InputError(f"column {blank} is blank; qw to qz must be all blank or all given")
    orientation = (
        [_number(name, cells[name]) for name in QUATERNION_COLUMNS] if any(parts) else None
    )
    return TableRow(
        time=_number("time", cells["time"]),
        frame=cells["frame"],
        position=(_number("x", cells["x"]), _number("y", cells["y"]), _number("z", cells["z"])),
        grip=_number("grip", cells["grip"]),
        orientation=orientation,  # type: ignore[arg-type]  # checked and made a tuple there
    )


def _number(column: str, text: str) -> float:
    """Read a number as CSV means it: Python's own float() would take 1_000, too."""
    if _NUMBER.fullmatch(text):
        return float(text)
    hint = " with a decimal point" if "," in text else " such as 0.25"
    raise InputError(f"column {column}: value {excerpt(text)}; must be a number{hint}")
