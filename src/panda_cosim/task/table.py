"""The trajectory table: the path of the hand, one row per waypoint; and inputs over time.

A CSV file with the header `time,frame,x,y,z,qw,qx,qy,qz,grip,grip_force,blend,name,until`. The
four q columns may be missing, or blank in a row, for the hand's home orientation; so may
`grip_force` and `blend`, for 0, and `name` and `until`, for none. The columns `q1` to `q7` may be
missing, all of them. Columns `FMU.INPUT` are an `InputTable`, which may also stand alone.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

from pydantic import PlainValidator

from ..assets.franka import GRIP_FORCE_MAX, GRIP_STIFFNESS, OPENING_MAX, Q_MAX, Q_MIN
from ..fmus.errors import InputError, did_you_mean, excerpt
from ..fmus.reading import finite_number
from .fields import Choice, Line, Quantity, Vector, checked
from .files import read_text

FRAMES = ("world", "home", "target")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
OPTIONAL_COLUMNS = ("grip_force", "blend")  # 0 where they are missing or blank
NAME_COLUMN = "name"  # of the waypoint, for pictures
POSTURE_COLUMNS = tuple(f"q{joint}" for joint in range(1, 8))  # of all rows or of none
UNTIL_COLUMN = "until"  # what ends the row early
COLUMNS = ("time", "frame", "x", "y", "z", *QUATERNION_COLUMNS, "grip")

POSITION = Quantity(-10.0, 10.0, "m")  # the arm reaches 0.855 m
_QUATERNION_PART = Quantity(-1e6, 1e6)  # its length is scaled to 1, so any sane scale will do
_BOUNDS = {
    "time": Quantity(0.0, 86_400.0, "s"),  # a day
    **dict.fromkeys("xyz", POSITION),
    **dict.fromkeys(QUATERNION_COLUMNS, _QUATERNION_PART),
    "grip": Quantity(0.0, OPENING_MAX, "m"),
    "grip_force": Quantity(0.0, GRIP_FORCE_MAX, "N"),
    "blend": Quantity(0.0, 1.0, "m"),
    **{
        name: Quantity(low, high, "rad")
        for name, low, high in zip(POSTURE_COLUMNS, Q_MIN, Q_MAX, strict=True)
    },
}
MIN_GAP = 1e-6  # s between rows; a smaller gap is a mistake, and gives absurd velocities
MIN_QUATERNION_LENGTH = 1e-6
UNIT_TOLERANCE = 1e-15  # of a length that is 1 but for rounding
MAX_ROWS = 100_000
_MAX_BYTES = 64 * 1024 * 1024  # 100 000 rows of 10 long numbers take 25 MB

_UNTIL = re.compile(r"(contact|external_force(?:\[([1-6])\])?)\s*>\s*(\d+\.?\d*|\.\d+)", re.A)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I | re.A)


def _unit_quaternion(value: object) -> tuple[float, ...]:
    """Scale a quaternion to length 1."""
    quaternion = Vector(4, _QUATERNION_PART)(value)
    length = math.hypot(*quaternion)
    if length < MIN_QUATERNION_LENGTH:
        raise ValueError(
            f"quaternion {excerpt(quaternion)} of length {length:g}; must be longer than 0, or "
            "blank for the home orientation"
        )
    if abs(length - 1.0) < UNIT_TOLERANCE:  # keeps the bits of a quaternion that we wrote
        return quaternion
    return tuple(part / length for part in quaternion)


UnitQuaternion = Annotated[
    tuple[float, float, float, float], PlainValidator(_unit_quaternion)
]  # (w, x, y, z)


def _posture(value: object) -> tuple[float, ...]:
    """Check joint positions against their ranges."""
    joints = zip(POSTURE_COLUMNS, Vector(7)(value), strict=True)
    return tuple(_BOUNDS[name].check(name, position) for name, position in joints)


Posture = Annotated[
    tuple[float, float, float, float, float, float, float], PlainValidator(_posture)
]


def split_until(text: str) -> tuple[int, float]:
    """Return what ends a row early: 0 contact, 1 to 6 an element, 7 the force; and its bound."""
    match = _UNTIL.fullmatch(text.strip())
    if match is None:
        raise ValueError(
            f"{excerpt(text)}; must be blank, or as contact > 3 (N, along the path), "
            "external_force > 5 (N, its length) or external_force[3] > 5 (N or N.m, its magnitude)"
        )
    return 0 if match[1] == "contact" else int(match[2] or 7), float(match[3])


def _until(value: object) -> str:
    text = Line()(value)
    if text:
        split_until(text)
    return text


@checked
class TableRow:
    """One waypoint of the hand.

    Attributes:
        time: Time at which the hand is to be there [s].
        frame: Origin of the position: `world`, the hand's `home` position, or the block's
            `target` site at the start.
        position: Offset (x, y, z) of the hand's origin from there, in world axes [m].
        grip: Opening between the fingertips [m], from this row's time on.
        orientation: Hand to world, (w, x, y, z), scaled to length 1; None for that of `home`.
        grip_force: Force of each finger [N], from this row's time on: `grip` is then the width of
            what is held. 0: the fingers go to `grip`.
        blend: How far before and after the row time-optimal timing may round the corner [m];
            0: the hand stops there.
        name: What pictures call it; "": its number.
        posture: Joint positions (7,) [rad] that the arm takes as far as the hand's pose leaves them
            open; of all rows of a table or of none.
        until: What ends the row early: `contact > 3`, the force [N] along the way that the servos
            exert more than at the row's start; `external_force > 5` [N], its length, or
            `external_force[3] > 5`, the magnitude of an element. Later rows then move forward.

    Raises:
        InputError: A value is out of range.
    """

    time: Annotated[float, _BOUNDS["time"]]
    frame: Annotated[str, Choice(FRAMES)]
    position: Annotated[tuple[float, float, float], Vector(3, POSITION)]
    grip: Annotated[float, _BOUNDS["grip"]]
    orientation: UnitQuaternion | None = None
    grip_force: Annotated[float, _BOUNDS["grip_force"]] = 0.0
    blend: Annotated[float, _BOUNDS["blend"]] = 0.0
    name: Annotated[str, Line()] = ""
    posture: Posture | None = None
    until: Annotated[str, PlainValidator(_until)] = ""

    def __post_init__(self) -> None:
        most = 0.5 * GRIP_STIFFNESS * self.grip
        if self.grip_force > most:
            raise ValueError(
                f"grip_force: value {self.grip_force!r}; must be at most {most:.4g} N on what is "
                f"{self.grip:g} m wide, with which the gripper's servo is closed"
            )

    @property
    def opening(self) -> float:
        """Opening that is commanded [m]: `grip`, or so much less that the force results."""
        return self.grip - 2.0 * self.grip_force / GRIP_STIFFNESS


@checked
class TrajectoryTable:
    """The rows of a trajectory, in the order of time.

    Raises:
        InputError: There are too few or too many rows, times do not increase, or only some rows
            have a posture.
    """

    rows: tuple[TableRow, ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.rows) <= MAX_ROWS:
            raise InputError(f"{len(self.rows)} rows; must be 2 to {MAX_ROWS}")
        for number, (before, after) in enumerate(zip(self.rows, self.rows[1:], strict=False), 2):
            try:
                _check_order(before.time, after.time)
            except InputError as error:
                raise InputError(f"row {number}, {error}") from None
            if (after.posture is None) is self.has_posture:
                raise InputError(f"row {number}: q1 to q7; must be set in all rows or in none")

    @property
    def has_posture(self) -> bool:
        """Whether its rows have a posture."""
        return self.rows[0].posture is not None

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a table from a CSV file (UTF-8, byte-order mark and CRLF accepted).

        Raises:
            InputError: The file cannot be used; the message names line, column and value.
        """
        text = read_text(Path(path), _MAX_BYTES)
        try:
            return cls(tuple(_parse(text)))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _check_order(before: float, after: float) -> None:
    if after - before < MIN_GAP:
        slip = "repeats" if after == before else "goes back" if after < before else "is too close"
        raise InputError(
            f"column time: value {after!r} {slip}; must be at least {MIN_GAP:g} s after {before!r}"
        )


def _parse(text: str) -> list[TableRow]:
    """Parse the file's text; errors name the line."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    stripped = ([cell.strip() for cell in cells] for cells in reader)
    lines = (cells for cells in stripped if any(cells))
    rows: list[TableRow] = []
    try:
        header = next(lines, [])
        _check_header(header)
        for cells in lines:
            if len(cells) != len(header):
                raise InputError(f"{len(cells)} values; must be {len(header)} ({','.join(header)})")
            rows.append(_parse_row(dict(zip(header, cells, strict=True))))
            if len(rows) > 1:
                _check_order(rows[-2].time, rows[-1].time)
    except (csv.Error, InputError) as error:
        raise InputError(f"line {reader.line_num}: {error}") from None
    return rows


def _check_header(names: list[str]) -> None:
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        raise InputError("columns are separated by ';' or tab; must be separated by commas")
    valid = (*COLUMNS, *OPTIONAL_COLUMNS, *POSTURE_COLUMNS, NAME_COLUMN, UNTIL_COLUMN)
    for name in names:
        if name not in valid and "." not in name:
            hint = did_you_mean(name, valid)
            raise InputError(f"column {excerpt(name)} is unknown; valid: {', '.join(valid)}{hint}")
        if names.count(name) > 1:
            raise InputError(f"column {name} occurs {names.count(name)} times; must occur once")
    optional = () if set(QUATERNION_COLUMNS) & set(names) else QUATERNION_COLUMNS
    postures = POSTURE_COLUMNS if set(POSTURE_COLUMNS) & set(names) else ()
    required = [name for name in (*COLUMNS, *postures) if name not in optional]
    missing = [name for name in required if name not in names]
    if missing:
        needed = ", ".join(required)
        raise InputError(f"{', '.join(missing)}: missing; must have the columns {needed}")


def _parse_row(cells: dict[str, str]) -> TableRow:
    may_be_blank = (*QUATERNION_COLUMNS, *OPTIONAL_COLUMNS)
    blank = [name for name in may_be_blank if not cells.get(name)]
    parts = [name for name in QUATERNION_COLUMNS if name not in blank]
    if 0 < len(parts) < len(QUATERNION_COLUMNS):
        raise InputError(f"column {blank[0]} is blank; qw to qz must be all blank or all set")
    numbers = {
        name: _number(name, text)
        for name, text in cells.items()
        if name in _BOUNDS and name not in blank
    }
    return TableRow(
        time=numbers["time"],
        frame=cells["frame"],
        position=(numbers["x"], numbers["y"], numbers["z"]),
        grip=numbers["grip"],
        orientation=tuple(numbers[name] for name in parts) or None,  # type: ignore[arg-type]  # of 4
        name=cells.get(NAME_COLUMN, ""),
        posture=[numbers[n] for n in POSTURE_COLUMNS if n in numbers] or None,  # type: ignore[arg-type]
        until=cells.get(UNTIL_COLUMN, ""),
        **{name: numbers[name] for name in OPTIONAL_COLUMNS if name in numbers},
    )


def _number(column: str, text: str) -> float:
    """Read a number; Python's own float() would also accept 1_000."""
    if not _NUMBER.fullmatch(text):
        hint = " with a decimal point" if "," in text else " such as 0.25"
        raise InputError(f"column {column}: value {excerpt(text)}; must be a number{hint}")
    return float(_BOUNDS[column].check(f"column {column}", float(text)))


MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class InputTable:
    """Inputs over time as texts; what they are for gives them their types."""

    times: tuple[float, ...] = ()  # of each row [s]; two rows of one time are a jump
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # by FMU.INPUT
    place: str = field(default="", compare=False)  # of the file, for messages

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file."""
        return cls.of_text(read_text(path, MAX_BYTES), str(path))

    @classmethod
    def of_text(cls, text: str, place: str) -> Self:
        """Read the text of a file."""
        columns = _columns(place, text)
        return cls(_times(place, columns.pop("time")), columns, place)

    @classmethod
    def of_trajectory(cls, path: Path) -> tuple[Self, bool]:
        """Read the inputs in a trajectory's table, and whether it has other columns, too."""
        text = read_text(path, MAX_BYTES)
        header = next((line for line in text.splitlines() if line.strip(" \t,")), "")
        if "." not in header:
            return cls(), True
        columns = _columns(str(path), text)
        inputs = {name: cells for name, cells in columns.items() if "." in name}
        has_others = len(inputs) + 1 < len(columns)
        return cls(_times(str(path), columns["time"]), inputs, str(path)), has_others

    @property
    def text(self) -> str:
        """Content of a file."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["time", *self.columns])
        writer.writerows(zip(self.times, *self.columns.values(), strict=True))
        return text.getvalue()


def _columns(path: str, text: str) -> dict[str, tuple[str, ...]]:
    """Cells by the names of columns."""
    try:
        lines = csv.reader(io.StringIO(text), strict=True)
        names, *rows = [line for line in lines if any(cell.strip() for cell in line)]
    except (csv.Error, ValueError) as error:
        raise InputError(f"{path}: {error}; must be CSV") from None
    names = [name.strip() for name in names]
    if "time" not in names or len(set(names)) < len(names) or not rows:
        raise InputError(
            f"{path}: line 1: columns {excerpt(','.join(names))}; must be time and inputs as "
            "FMU.INPUT, each once, with a row"
        )
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise InputError(f"{path}: row {number}: {len(row)} values; must be {len(names)}")
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def _times(path: str, texts: tuple[str, ...]) -> tuple[float, ...]:
    times = [finite_number(text) for text in texts]
    for row, (before, time) in enumerate(pairwise([-1e308, *times]), 1):
        if time is None or (before is not None and time < before):
            raise InputError(
                f"{path}: row {row}: time {excerpt(texts[row - 1])}; must be a number, and not "
                "before the row above"
            )
    return tuple(time for time in times if time is not None)
