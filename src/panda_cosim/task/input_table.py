"""Inputs over time: a CSV file with the columns `time` and FMU.INPUT."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from ..fmus.errors import InputError, located, refuse
from ..fmus.reading import finite_number
from .files import MAX_BYTES, Csv, csv_text, parse_csv, read_text


@dataclass(frozen=True)
class InputTable:
    """Inputs over time as texts; what they are for gives them their types.

    `read` makes it from the file that `[inputs]` names, `of` from columns of trajectory.csv. Values
    are checked where the FMUs are known, when the system is connected; constants do not belong
    here, but in `Scenario.inputs`.
    """

    times: tuple[float, ...] = ()  # of each row [s]; two rows of one time are a jump
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # by FMU.INPUT
    place: str = field(default="", compare=False)  # of the file, for messages

    @classmethod
    def read(cls, path: Path, place: str = "") -> Self:
        """Read a file, which messages call by its path unless they have another `place` for it."""
        text = read_text(path, MAX_BYTES)
        with located(place or path):
            table = parse_csv(text, _check_names)
            return cls.of(table, [n for n in table.names if n != "time"], place or str(path))

    @classmethod
    def of(cls, table: Csv, inputs: Sequence[str], place: str) -> Self:
        """Take the inputs from a table, which may have other columns."""
        at, times = table.names.index("time"), [-math.inf]
        for line, cells in table.rows.items():
            time = finite_number(cells[at])
            if time is None or time < times[-1]:
                must = "must be a number, and not before the row above"
                refuse(f"line {line}: time", cells[at], must)
            times.append(time)
        if not table.rows:
            raise InputError("has no rows; must have at least one below the names")
        columns = dict(zip(table.names, zip(*table.rows.values(), strict=True), strict=True))
        return cls(tuple(times[1:]), {name: columns[name] for name in inputs}, place)

    @property
    def text(self) -> str:
        """Content of a file."""
        rows = zip(self.times, *self.columns.values(), strict=True)
        return csv_text([("time", *self.columns), *rows])


def _check_names(names: Sequence[str]) -> None:
    if "time" not in names:
        refuse("columns", ",".join(names), "must be time, and inputs as FMU.INPUT")
