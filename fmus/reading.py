"""Reading files that users name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from .errors import InputError


@contextmanager
def open_regular(path: Path) -> Iterator[BufferedReader]:
    """Open a regular file to read bytes.

    Raises:
        InputError: The file is missing, not a regular one, or cannot be read.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
        if not path.is_file():  # a pipe or device could block or never end
            raise InputError(f"{path}: not a regular file")
        with path.open("rb") as file:
            yield file
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{str(path)!a}: cannot be read: {reason}") from error
