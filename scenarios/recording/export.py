"""CSV files for other tools."""

import csv
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import ArrayLike

from ...fmus.atomic import check_replaceable, replacing
from ...fmus.errors import InputError
from ..definition.trajectory import COMMANDS
from . import Recording


def write_recording_csv(recording: Recording, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a recording as CSV (RFC 4180), a block at a time.

    Raises:
        InputError: The file exists or cannot be written, or its name does not end in .csv.
    """
    if Path(path).suffix.lower() != ".csv":
        raise InputError(f"{path}: the file is written as CSV; its name must end in .csv")
    blocks = (block.tolist() for block in recording.blocks())
    _write_csv(Path(path), recording.columns, blocks, "\r\n", overwrite)


def write_input_csv(
    path: str | Path, times: ArrayLike, commands: ArrayLike, *, overwrite: bool = False
) -> None:
    """Write commands as an input file for `fmpy simulate` with the controller.

    Args:
        path: The CSV file.
        times: Shape (n,) [s].
        commands: Commands of `Trajectory.sample`, shape (n, 14).
        overwrite: Replace an existing file.

    Raises:
        InputError: The file exists or cannot be written.
    """
    rows = np.column_stack([np.asarray(times), np.asarray(commands)]).tolist()
    _write_csv(Path(path), ("time", *COMMANDS), [rows], "\n", overwrite)


def _write_csv(
    path: Path,
    names: Iterable[str],
    blocks: Iterable[list[list[float]]],
    line_end: str,
    overwrite: bool,
) -> None:
    with _replacing(path, overwrite) as file:
        writer = csv.writer(file, lineterminator=line_end)  # writes floats exactly, as repr()
        writer.writerow(names)
        for block in blocks:
            writer.writerows(block)


@contextmanager
def _replacing(path: Path, overwrite: bool) -> Iterator[TextIO]:
    """Open a file that gets its name only once it is complete; a failure leaves the old one."""
    check_replaceable(path, overwrite=overwrite)
    with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        yield file
