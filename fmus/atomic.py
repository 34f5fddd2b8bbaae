"""Files that are written whole or not at all, and only over our own; the cache of FMUs."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import stat
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from .errors import InputError

TEMPORARY: Final = ".panda-cosim-"  # an unusual name, since it may stand beside a user's files
KEPT: Final = 7 * 24 * 3600.0  # [s] age at which what a killed process left is removed
MARK: Final = "Made by panda-cosim, which may replace this file"
_HEAD: Final = 2**20  # [byte] a video has its mark behind its table of frames
_RECORDINGS: Final = (b"PAR1", b"\xff\xff\xff\xff")  # first bytes of Parquet and Arrow streams
_TOOL: Final = b'generationTool="panda-cosim'
_NOTES: Final = {  # what a member of an archive of ours holds: of an .fmu, an .ssp, an .npz
    "modelDescription.xml": _TOOL,
    "SystemStructure.ssd": _TOOL,
    "note.npy": MARK.encode(),
}


def check_replaceable(*paths: Path | None, overwrite: bool | None = None) -> None:
    """Refuse to replace a file that has no `MARK`, and a recording in any case; None is no file."""
    for path in filter(None, paths):
        head = _head(path)
        if head.startswith(_RECORDINGS):
            raise InputError(f"{path}: holds a recording; must be another file")
        if not (overwrite or _is_ours(path, head) or not os.path.lexists(path)):
            option = "" if overwrite is None else ", or use --overwrite"
            raise InputError(f"{path}: already exists; must be a new file{option}")


def _head(path: Path) -> bytes:
    """Return the first bytes of a regular file; none of anything else."""
    with suppress(OSError, ValueError):
        if path.is_file():
            with path.open("rb") as file:
                return file.read(_HEAD)
    return b""


def _is_ours(path: Path, head: bytes) -> bool:
    if not head.startswith(b"PK"):
        return MARK.encode() in head
    with suppress(Exception), zipfile.ZipFile(path) as archive:  # ten types for damaged ones
        names = _NOTES.keys() & set(archive.namelist())
        return any(_NOTES[name] in archive.open(name).read(4096) for name in names)
    return False


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Make a temporary path beside `path`, which replaces it if the block succeeds."""
    path = Path(path)
    with ExitStack() as stack:
        try:
            if path.exists() and not path.is_file():  # a folder, device or pipe
                raise InputError(f"{path}: not a regular file")
            temporary = stack.enter_context(_temporary(path.parent, path.suffix))
            temporary.touch()  # or only the block would see that the folder cannot be written to
        except (OSError, ValueError) as error:
            raise _refused(path, error) from error
        try:
            yield temporary
            temporary.replace(path)
        except OSError as error:
            if error.filename not in (None, str(temporary)):
                raise  # the error is about another file
            raise _refused(path, error) from error


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file, whole or not at all; text in UTF-8."""
    with replacing(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Refuse a place that cannot be written to, with the reason of the operating system."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{place}: cannot be written to: {error.strerror or error}") from error


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Make a folder that is removed at the end, and held until then."""
    with ExitStack() as stack:
        with writing(parent):
            folder = stack.enter_context(_temporary(parent))
            folder.mkdir(mode=0o700)
            stack.enter_context(held(folder))
        yield folder


@contextmanager
def held(path: Path) -> Iterator[bool]:
    """Hold a file or folder while the block runs; False: another process holds it."""
    # systemd-tmpfiles also leaves what is held so.
    file = os.open(path, os.O_RDONLY)
    try:
        yield _lock(file)
    finally:
        os.close(file)


def _lock(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)  # others: a file system without locks
    return True


@contextmanager
def _temporary(parent: Path, suffix: str = "") -> Iterator[Path]:
    """Remove what is at a new path at the end, and what killed processes left before."""
    parent.mkdir(parents=True, exist_ok=True)
    for left in parent.glob(f"{TEMPORARY}*"):
        with suppress(OSError):
            if abs(time.time() - left.lstat().st_mtime) > KEPT:  # or of a clock since set back
                with held(left) as is_left:
                    _remove(left) if is_left else None
    path = parent / f"{TEMPORARY}{secrets.token_hex(8)}{suffix}"
    try:
        yield path
    finally:
        _remove(path)


def _remove(path: Path) -> None:
    with suppress(OSError):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def _refused(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}")


# The cache of built and unpacked FMUs.


def cache_folder() -> Path:
    """Folder for built and unpacked FMUs: PANDA_COSIM_CACHE, or the user's cache."""
    # It holds code that is run, so it is made for its user alone.
    folder = _cache_place()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.stat()
    except OSError as error:
        raise _cache_refused(folder, error) from error
    if status.st_uid != os.geteuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise InputError(
            f"{folder}: others may write to it, and code from there would be run; set "
            "PANDA_COSIM_CACHE to a folder that is yours alone (chmod 700)"
        )
    return folder


def cached(path: Path, make: Callable[[], bytes]) -> Path:
    """Return a file of the cache, made if it is missing."""
    if not path.is_file():
        content = make()
        with in_cache(path) as temporary:
            temporary.write_bytes(content)
            temporary.replace(path)
    return path


@contextmanager
def in_cache(path: Path) -> Iterator[Path]:
    """Make a temporary path for what is to stand at `path` in the cache."""
    try:
        with _temporary(path.parent, path.suffix) as temporary:
            yield temporary
    except OSError as error:
        raise _cache_refused(path.parent, error) from error


def _cache_refused(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: cannot write the FMU cache: {error.strerror or error}; set PANDA_COSIM_CACHE "
        "to a writable folder with enough free space"
    )


def _cache_place() -> Path:
    if chosen := os.environ.get("PANDA_COSIM_CACHE"):
        return Path(chosen).absolute()
    place = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not place.is_absolute():  # Ref: XDG Base Directory Specification: others are ignored
        try:
            place = Path.home().absolute() / ".cache"
        except RuntimeError as error:
            raise InputError("no home folder for the FMU cache; set PANDA_COSIM_CACHE") from error
    return place / "panda-cosim"
