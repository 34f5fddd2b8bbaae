"""A table of inputs over time: a CSV file with the columns `time` and `FMU.INPUT`."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Self

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from ...fmus.reading import finite_number
from ..files import read_text

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
        if "." not in text.partition("\n")[0]:
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
        names, *rows = [line for line in csv.reader(io.StringIO(text), strict=True) if any(line)]
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
