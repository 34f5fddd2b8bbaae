"""Files and folders that are written completely or not at all."""

from __future__ import annotations

import secrets
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import IO

from ..fmus.errors import InputError
from ..fmus.reading import open_regular

if sys.platform != "win32":
    import fcntl

GRACE = 10.0  # [s] age from which a temporary file that is not locked counts as left behind
MAX_DIGITS = 40  # of an integer; Python would read any number of them
MAX_NAME = 120  # [byte] of a name that becomes part of a file's name, which may have 255


def safe_name(name: str) -> str:
    """Turn a name into the name of one file or folder.

    Letters, digits and "_.-" stay; all else, path separators included, becomes "_". Leading dots
    are dropped, so that it is neither hidden nor "..".
    """
    safe = "".join(c if c.isalnum() or c in "_.-" else "_" for c in name).lstrip(".")
    return safe.encode()[:MAX_NAME].decode(errors="ignore") or "unnamed"


def read_integer(text: str) -> int | float:
    """Read an integer of a JSON file; one that no signal or count can be becomes a float."""
    return int(text) if len(text) <= MAX_DIGITS else float(text)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Make a temporary path beside `path`, which replaces `path` if the block succeeds.

    If the block fails, by Ctrl-C for instance, `path` is unchanged and the temporary file is
    removed. Temporary files of killed processes are removed by the next call.

    Args:
        path: The file to write; its folder is made if missing.

    Yields:
        The path to write to, with the same suffix.

    Raises:
        InputError: The folder cannot be written to.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem[:100]}.{secrets.token_hex(8)}{path.suffix}")
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; must be a file")
        if path.exists() and not path.is_file():  # a device or a pipe
            raise InputError(f"{path}: not a regular file")
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_behind(path)
        held = temporary.open("xb")
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be written: {reason}") from error
    try:
        with held:
            _lock(held)
            yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise  # the error is about another file
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _remove_left_behind(path: Path) -> None:
    """Remove temporary files of `path` that no process has open."""
    pattern = f"{escape(f'.{path.stem[:100]}.')}{'[0-9a-f]' * 16}{escape(path.suffix)}"
    for old in path.parent.glob(pattern):
        with suppress(OSError), old.open("rb") as file:
            # A new file may not be locked yet.
            if time.time() - old.stat().st_mtime > GRACE and _lock(file):
                old.unlink()


def _lock(file: IO[bytes]) -> bool:
    """Lock a file until it is closed or its process ends; return whether that worked."""
    if sys.platform == "win32":  # has no such locks, so old temporary files stay
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked by another process, or the file system has no locks
        return False
    return True


def write_all(contents: Mapping[Path, str]) -> None:
    """Write several new files to a folder: all of them or, if one fails, none.

    Raises:
        InputError: A file cannot be written.
    """
    made = {path.parent for path in contents if not path.parent.exists()}
    written: list[Path] = []
    try:
        for path, text in contents.items():
            with replacing(path) as partial:
                partial.write_text(text, encoding="utf-8")
            written.append(path)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def read_text(path: Path, max_bytes: int) -> str:
    """Read a UTF-8 text file, with or without a byte-order mark.

    Raises:
        InputError: The file is missing, not a regular one, unreadable, empty, too large or not
            UTF-8.
    """
    with open_regular(path) as file:
        content = file.read(max_bytes + 1)
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
