"""The cache of built and unpacked FMUs. It holds code that is run, so it must be private."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from ..errors import InputError


def cache_folder() -> Path:
    """Folder for built and unpacked FMUs: PANDA_COSIM_CACHE, or the user's cache."""
    chosen = os.environ.get("PANDA_COSIM_CACHE")
    if chosen:
        return Path(chosen).absolute()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "panda-cosim"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "panda-cosim"


def private_folder(folder: Path) -> Path:
    """Make a folder of the cache, or check that no other user can have written to it.

    Args:
        folder: A folder in the cache.

    Returns:
        The folder.

    Raises:
        InputError: The folder or the cache belongs to another user, or is writable for all.
        OSError: It cannot be made.
    """
    folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_private(folder.parent)
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
    advice = "code from there would be run; set PANDA_COSIM_CACHE to a folder that is yours alone"
    if found.st_uid not in (0, os.geteuid()):
        raise InputError(f"{folder}: belongs to user {found.st_uid}, not to you; {advice}")
    if found.st_mode & 0o002:
        raise InputError(f"{folder}: everybody may write to it; {advice}")
