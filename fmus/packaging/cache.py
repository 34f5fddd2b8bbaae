"""The cache of built and unpacked FMUs. It holds code that is run, so it must be private."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import Final

from ..errors import InputError

ADVICE: Final = (
    "code from there would be run; set PANDA_COSIM_CACHE to a folder that is yours alone"
)


def cache_folder() -> Path:
    """Folder for built and unpacked FMUs: PANDA_COSIM_CACHE, or the user's cache.

    Raises:
        InputError: This user has no home folder.
    """
    chosen = os.environ.get("PANDA_COSIM_CACHE")
    if chosen:
        return Path(os.path.realpath(chosen))  # whose symlink might lead elsewhere later
    given = Path(
        os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    )
    if given.is_absolute():  # Ref: XDG Base Directory Specification: others are ignored
        return given / "panda-cosim"
    try:
        home = Path.home()
    except RuntimeError as error:
        raise InputError("no home folder for the FMU cache; set PANDA_COSIM_CACHE") from error
    return home.absolute() / ("" if sys.platform == "win32" else ".cache") / "panda-cosim"


def is_noexec(folder: Path) -> bool:
    """Whether no library can be loaded from a folder, since its file system is mounted noexec."""
    return sys.platform == "linux" and bool(os.statvfs(folder).f_flag & os.ST_NOEXEC)


def private_folder(folder: Path) -> Path:
    """Make a folder of the cache, or check that no other user can have written to it.

    Args:
        folder: A folder in the cache.

    Returns:
        The folder.

    Raises:
        InputError: The folder or the cache belongs to another user, or is writable for all, or
            others may put another in its place.
        OSError: It cannot be made.
    """
    folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_private(folder.parent)
    _check_above(folder.parent)
    folder.mkdir(mode=0o700, exist_ok=True)
    check_private(folder)
    return folder


def check_private(folder: Path) -> None:
    """Check that a folder belongs to this user or to root, and is not writable for all.

    Raises:
        InputError: It does not, or is.
        OSError: It cannot be examined.
    """
    if sys.platform == "win32":
        return
    found = folder.stat()
    if found.st_uid not in (0, os.geteuid()):
        raise InputError(f"{folder}: belongs to user {found.st_uid}, not to you; {ADVICE}")
    if found.st_mode & stat.S_IWOTH:
        raise InputError(f"{folder}: everybody may write to it; {ADVICE}")


def _check_above(folder: Path) -> None:
    """Check that others cannot rename a folder, and put their own in its place."""
    if sys.platform == "win32":
        return
    trusted = {0, os.geteuid(), Path("/").stat().st_uid}  # in a container / may be somebody's
    for parent in folder.resolve().parents:
        found = parent.stat()
        if found.st_uid not in trusted:
            raise InputError(f"{folder}: user {found.st_uid} may rename it, in {parent}; {ADVICE}")
        if found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
            raise InputError(f"{folder}: everybody may rename it, in {parent}; {ADVICE}")
