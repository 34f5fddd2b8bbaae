"""Files that are written completely or not at all, and only over those that were made here."""

from __future__ import annotations

import secrets
import sys
import time
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import IO, Final

from .errors import InputError

if sys.platform != "win32":
    import fcntl

MARK: Final = "Made by panda-cosim, which may replace this file"
_HEAD: Final = 2**20  # [byte] a video has its mark behind its table of frames
_RECORDINGS: Final = (b"PAR1", b"\xff\xff\xff\xff")  # first bytes of Parquet and Arrow streams
_TOOL: Final = b'generationTool="panda-cosim'
_DESCRIPTIONS: Final = {"modelDescription.xml", "SystemStructure.ssd"}

GRACE = 10.0  # [s] age from which a temporary file that is not locked counts as left behind


def check_replaceable(*paths: Path, overwrite: bool | None = None) -> None:
    """Refuse to replace a file that has no `MARK`, and a recording in any case.

    Args:
        paths: Files to be written, recordings not among them.
        overwrite: Whether other files may be replaced, too; None: there is no such option.

    Raises:
        InputError: One must stay.
    """
    for path in paths:
        head = _head(path)
        if head.startswith(_RECORDINGS):
            raise InputError(f"{path}: holds a recording; must be another file")
        if not (overwrite or not _exists(path) or _is_ours(path, head)):
            option = "" if overwrite is None else ", or use --overwrite"
            raise InputError(f"{path}: already exists; must be a new file{option}")


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # writing it then fails with a better message
        return False


def _head(path: Path) -> bytes:
    """Return the first bytes of a regular file; none of anything else."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(_HEAD)
    except (OSError, ValueError):
        return b""


def _is_ours(path: Path, head: bytes) -> bool:
    if not head.startswith(b"PK"):
        return MARK.encode() in head
    try:
        with zipfile.ZipFile(path) as archive:
            names = _DESCRIPTIONS.intersection(archive.namelist())
            return any(_TOOL in archive.open(name).read(4096) for name in names)
    except (OSError, zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, ValueError):
        return False


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
        with _made(path, temporary) as held:
            _lock(held)
            yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise  # the error is about another file
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError, ValueError):
            temporary.unlink(missing_ok=True)


def _made(path: Path, temporary: Path) -> IO[bytes]:
    """Make the temporary file of a path, and its folder."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; must be a file")
        if path.exists() and not path.is_file():  # a device or a pipe
            raise InputError(f"{path}: not a regular file")
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_behind(path)
        return temporary.open("xb")
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be written: {reason}") from error


def _remove_left_behind(path: Path) -> None:
    """Remove temporary files of `path` that no process has open."""
    pattern = f"{escape(f'.{path.stem[:100]}.')}{'[0-9a-f]' * 16}{escape(path.suffix)}"
    for old in path.parent.glob(pattern):
        with suppress(OSError), old.open("rb") as file:
            # A new file may not be locked yet; one from the future is of a clock since set back.
            if abs(time.time() - old.stat().st_mtime) > GRACE and _lock(file):
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
