"""Checks of what a user wrote; each message names the place, the value and what is valid.

A message starts with the place inside the file (`column grip`, `[success] max_tilt`); who reads
the file puts its name before it.
"""

import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from ..fmus.errors import InputError
from ..fmus.messages import did_you_mean as suggestion
from ..fmus.messages import excerpt, one_line

__all__ = [
    "check_choice",
    "check_number",
    "check_numbers",
    "excerpt",
    "one_line",
    "read_text",
    "suggestion",
]


def check_choice(place: str, value: object, valid: Collection[str]) -> str:
    """Return the value if it is one of the valid names.

    Raises:
        InputError: It is not; the message lists the valid names and the nearest.
    """
    if isinstance(value, str) and value in valid:
        return value
    hint = suggestion(value, valid) if isinstance(value, str) else ""
    raise InputError(f"{place}: value {excerpt(value)}; must be one of {', '.join(valid)}{hint}")


def check_number(
    place: str, value: object, low: float = -math.inf, high: float = math.inf, unit: str = ""
) -> float:
    """Return the value as a float if it is a finite number within [low, high].

    Raises:
        InputError: It is not.
    """
    # numpy's numbers are of no common type; having __float__ tells them from text and lists.
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        bound = _bound(low, high, unit)
        raise InputError(f"{place}: value {excerpt(value)} is no number; must be {bound}")
    try:
        number = float(value)
    except (OverflowError, TypeError):  # TypeError: an array of several numbers
        number = math.nan
    if not (math.isfinite(number) and low <= number <= high):
        bound = _bound(low, high, unit)
        raise InputError(f"{place}: value {excerpt(value)}; must be {bound}")
    return number


def _bound(low: float, high: float, unit: str) -> str:
    finite = math.isfinite(low) and math.isfinite(high)
    bound = f"a number from {low:g} to {high:g}" if finite else "a finite number"
    return f"{bound} {unit}".rstrip()


def check_numbers(
    places: Sequence[str], value: object, low: float, high: float, unit: str = ""
) -> tuple[float, ...]:
    """Return the value as a tuple of floats within [low, high], one for each place.

    Raises:
        InputError: It is not a sequence of so many such numbers.
    """
    if isinstance(value, str | bytes) or not isinstance(value, Sequence | np.ndarray):
        found = excerpt(value)
    elif len(value) != len(places):
        found = f"of {len(value)} items"
    else:
        pairs = zip(places, value, strict=True)
        return tuple(check_number(place, number, low, high, unit) for place, number in pairs)
    raise InputError(f"{places[0]} ...: value {found}; must be {len(places)} numbers")


def read_text(path: Path, max_bytes: int) -> str:
    """Read a UTF-8 text file, with or without a byte-order mark.

    Raises:
        InputError: It is missing, no plain file, unreadable, empty, too large or not UTF-8.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
        if not path.is_file():  # a pipe or device could block or never end
            raise InputError(f"{path}: is no plain file")
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{str(path)!a}: cannot be read: {reason}") from error
    if len(content) > max_bytes:
        raise InputError(f"{path}: is too large; must be at most {max_bytes} bytes")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: is UTF-16; must be UTF-8 text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        byte = content[error.start]
        raise InputError(f"{path}: line {line}: byte 0x{byte:02x}; must be UTF-8 text") from error
    if not text.strip():
        raise InputError(f"{path}: is empty")
    return text
