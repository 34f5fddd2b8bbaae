"""Reads Python source without running it."""

from __future__ import annotations

import ast
from pathlib import Path
from threading import Lock
from typing import Final

from ..errors import InputError
from ..messages import one_line

_MAX_BYTES: Final = 1_000_000
# CPython 3.11 counts the depth of a syntax tree for all threads together: two that parse at once
# can end with a SystemError ("recursion depth mismatch").
_ONE_PARSER: Final = Lock()


def parse(source: str | bytes, name: str = "<unknown>") -> ast.Module:
    """Parse source; safe in several threads.

    Raises:
        SyntaxError: It is not Python; see `ast.parse` for the others.
    """
    with _ONE_PARSER:
        return ast.parse(source, name)


def parse_file(path: Path) -> ast.Module:
    """Parse a file of the user's.

    Raises:
        InputError: It cannot be read, is too large, or is not Python.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path}: is too large; must be at most {_MAX_BYTES} bytes")
        return parse(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{path}: not valid Python: {one_line(error)}") from error


__all__ = ["parse", "parse_file"]
