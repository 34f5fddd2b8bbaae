"""The trajectory table: the path of the hand, one row per waypoint; and inputs over time.

A CSV file with the header `time,frame,x,y,z,qw,qx,qy,qz,grip,grip_force,blend,name,until`. The
four q columns may be missing, or blank in a row, for the hand's home orientation; so may
`grip_force` and `blend`, for 0, and `name` and `until`, for none. The columns `q1` to `q7` may be
missing, all of them. Columns `FMU.INPUT` are an `InputTable`, which may also stand alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PlainValidator

from ..assets.franka import GRIP_FORCE_MAX, GRIP_STIFFNESS, OPENING_MAX, Q_MAX, Q_MIN
from ..fmus.errors import InputError, excerpt, located, refuse
from ..fmus.reading import finite_number
from .fields import Choice, Line, Quantity, Vector, check_keys, checked
from .files import MAX_BYTES, csv_text, parse_csv, read_text
from .input_table import InputTable

FRAMES = ("world", "home", "target")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
POSTURE_COLUMNS = tuple(f"q{joint}" for joint in range(1, 8))  # of all rows or of none
COLUMNS = ("time", "frame", "x", "y", "z", *QUATERNION_COLUMNS, "grip")
OPTIONAL_COLUMNS = ("grip_force", "blend", "name", "until")  # may be missing or blank: 0 or none
# Fields of a row that have several columns; any other column is a field of its own.
_VECTORS = {"position": "xyz", "orientation": QUATERNION_COLUMNS, "posture": POSTURE_COLUMNS}

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

_UNTIL = re.compile(r"(contact|external_force(?:\[([1-6])\])?)\s*>\s*(\d+\.?\d*|\.\d+)", re.A)


def _unit_quaternion(value: object) -> tuple[float, ...]:
    """Scale a quaternion to length 1."""
    quaternion = Vector(4, _QUATERNION_PART)(value)
    length = math.hypot(*quaternion)
    if length < MIN_QUATERNION_LENGTH:
        must = "must be longer than 0, or blank for the home orientation"
        refuse("quaternion", quaternion, must, error=ValueError)
    if abs(length - 1.0) < UNIT_TOLERANCE:  # keeps the bits of a quaternion that we wrote
        return quaternion
    return tuple(part / length for part in quaternion)


# As MuJoCo orders its parts, w first.
UnitQuaternion = Annotated[tuple[float, float, float, float], PlainValidator(_unit_quaternion)]


def _posture(value: object) -> tuple[float, ...]:
    """Check joint positions against their ranges."""
    joints = zip(POSTURE_COLUMNS, Vector(7)(value), strict=True)
    return tuple(_BOUNDS[name].check(name, position) for name, position in joints)


Posture = Annotated[tuple[float, ...], PlainValidator(_posture)]


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
            on = f"on what is {self.grip:g} m wide, with which the gripper's servo is closed"
            refuse("grip_force", self.grip_force, f"must be at most {most:.4g} N {on}")

    @property
    def opening(self) -> float:
        """Opening that is commanded [m]: `grip`, or so much less that the force results."""
        return self.grip - 2.0 * self.grip_force / GRIP_STIFFNESS


@checked
class TrajectoryTable:
    """The rows of a trajectory, in the order of time: what the user wrote, relative to frames.

    `read_tables` makes it from trajectory.csv, a program from `TableRow`s, a planned route and
    optimal timing from poses in the world (`world_table`). It knows neither where the block stands
    nor how the hand goes from row to row: for poses at instants, resolve it into a `Trajectory`.

    Raises:
        InputError: There are too few or too many rows, times do not increase, or only some rows
            have a posture.
    """

    rows: tuple[TableRow, ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.rows) <= MAX_ROWS:
            raise InputError(f"{len(self.rows)} rows; must be 2 to {MAX_ROWS}")
        for number, (before, after) in enumerate(pairwise(self.rows), 2):
            if after.time - before.time < MIN_GAP:
                must = f"must be at least {MIN_GAP:g} s after {before.time!r}"
                refuse(f"row {number}: time", after.time, must)
            if (after.posture is None) is self.has_posture:
                raise InputError(f"row {number}: q1 to q7; must be set in all rows or in none")

    @property
    def has_posture(self) -> bool:
        """Whether its rows have a posture."""
        return self.rows[0].posture is not None

    @property
    def text(self) -> str:
        """Content of a file; columns that are blank or 0 in all rows are left out."""
        more = [n for n in OPTIONAL_COLUMNS if any(getattr(row, n) for row in self.rows)]
        names = (*COLUMNS, *more, *(POSTURE_COLUMNS if self.has_posture else ()))
        rows: list[Sequence[object]] = [names]
        for row in self.rows:
            last = (*(getattr(row, name) for name in more), *(row.posture or ()))
            orientation = row.orientation or [""] * 4  # that of `home`
            rows.append((row.time, row.frame, *row.position, *orientation, row.grip, *last))
        return csv_text(rows)


def world_table(
    times: ArrayLike, poses: ArrayLike, grips: ArrayLike, names: Mapping[int, str] | None = None
) -> TrajectoryTable:
    """Return a table in the world; poses (n, 7 or 14) may have postures, names are by row."""
    rows = enumerate(np.column_stack((times, grips, poses)).tolist())
    made = (
        TableRow(time, "world", pose[:3], grip, pose[3:7], name=(names or {}).get(row, ""),
                 posture=pose[7:] or None)
        for row, (time, grip, *pose) in rows
    )  # fmt: skip
    return TrajectoryTable(tuple(made))


def read_tables(path: Path) -> tuple[TrajectoryTable | None, InputTable]:
    """Read a scenario's CSV file (UTF-8): the rows of the hand, if any, and inputs beside them.

    Raises:
        InputError: The file cannot be used; the message names line, column and value.
    """
    text = read_text(path, MAX_BYTES)
    with located(path):
        table = parse_csv(text, _check_names)
        names = [name for name in table.names if "." in name]
        inputs = InputTable.of(table, names, str(path)) if names else InputTable()
        if not _has_rows(table.names):
            return None, inputs
        rows: list[TableRow] = []
        for line, cells in table.rows.items():
            with located(f"line {line}"):
                named = zip(table.names, map(str.strip, cells), strict=True)
                rows.append(_row({name: text for name, text in named if "." not in name}))
        return TrajectoryTable(tuple(rows)), inputs


def _has_rows(names: Sequence[str]) -> bool:
    """Tell whether a file with these columns has rows of the hand: not if it has inputs alone."""
    return len(names) == 1 or [name for name in names if "." not in name] != ["time"]


def _check_names(names: Sequence[str]) -> None:
    if not _has_rows(names):
        return
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        raise InputError("columns are separated by ';' or tab; must be separated by commas")
    valid = (*COLUMNS, *OPTIONAL_COLUMNS, *POSTURE_COLUMNS)
    check_keys("", [name for name in names if "." not in name], valid, "column")


def _row(cells: Mapping[str, str]) -> TableRow:
    given: dict[str, Any] = {
        name: _value(name, text)
        for name, text in cells.items()
        if text or name not in (*QUATERNION_COLUMNS, *OPTIONAL_COLUMNS)
    }
    for field, columns in _VECTORS.items():
        given[field] = [given.pop(name) for name in columns if name in given] or None
    return TableRow(**given)


def _value(column: str, text: str) -> str | float:
    """Read a cell."""
    if column not in _BOUNDS:
        return text
    number = finite_number(text)
    if number is None:
        refuse(f"column {column}", text, "must be a number such as 0.25")
    return float(_BOUNDS[column].check(f"column {column}", number))
