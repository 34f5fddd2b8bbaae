"""A table of inputs over time: a CSV file with the columns `time` and `FMU.INPUT`."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from ...fmus.reading import finite_number
from ..files import read_text

_MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class InputTable:
    """The text of the file; "": there is none. Values are typed by the inputs they are for."""

    text: str = ""
    place: str = ""  # of the file, for messages

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and check a file."""
        table = cls(read_text(path, _MAX_BYTES), str(path))
        assert len(table.times)  # which are checked
        return table

    @classmethod
    def of_trajectory(cls, path: Path) -> tuple[Self, bool]:
        """Read the columns FMU.INPUT of a trajectory's table, and whether it has others, too."""
        try:
            lines = list(csv.reader(io.StringIO(read_text(path, _MAX_BYTES))))
        except csv.Error:  # which the trajectory's reader explains
            return cls(), True
        names = [name.strip() for name in lines[0]] if lines else []
        places = [i for i, name in enumerate(names) if name == "time" or "." in name]
        if len(places) < 2:  # the time and an input
            return cls(), True
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(
            [cell for i, cell in enumerate(line) if i in places] for line in lines
        )
        return cls(text.getvalue(), str(path)), len(places) < len(names)

    @cached_property
    def _cells(self) -> dict[str, tuple[str, ...]]:
        """Columns by name."""
        try:
            lines = [line for line in csv.reader(io.StringIO(self.text), strict=True) if any(line)]
        except csv.Error as error:
            raise InputError(f"{self.place}: {error}; must be CSV") from None
        names = [name.strip() for name in lines[0]] if lines else []
        if "time" not in names or len(set(names)) < len(names) or len(lines) < 2:
            raise InputError(
                f"{self.place}: line 1: columns {excerpt(','.join(names))}; must be time and "
                "inputs as FMU.INPUT, each once, with a row"
            )
        for row, line in enumerate(lines[1:], 1):
            if len(line) != len(names):
                raise InputError(
                    f"{self.place}: row {row}: {len(line)} values; must be {len(names)}"
                )
        return dict(zip(names, zip(*lines[1:], strict=True), strict=True))

    @property
    def columns(self) -> dict[str, tuple[str, ...]]:
        """Texts of each column but the time."""
        return {n: cells for n, cells in self._cells.items() if n != "time"} if self.text else {}

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """Time of each row (n,) [s]; two rows of one time are a jump."""
        times = [finite_number(text) for text in self._cells["time"]]
        for row, (before, time) in enumerate(zip([None, *times], times, strict=False), 1):
            if time is None or (before is not None and time < before):
                text = self._cells["time"][row - 1]
                raise InputError(
                    f"{self.place}: row {row}: time {excerpt(text)}; must be a number of at least "
                    f"{0 if before is None else before:g} s"
                )
        return np.array(times, np.float64)
