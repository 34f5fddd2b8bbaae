"""Temporary folders that are removed even if their process is killed."""

from __future__ import annotations

import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl
    import os

# Unusual names, since the folders may stand beside a user's files.
UNPACK, BUILD, REGRESS, SWEEP = PREFIXES = tuple(
    f".panda-cosim-{work}-" for work in ("unpack", "build", "regress", "sweep")
)


@contextmanager
def scratch_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Make a folder that is removed at the end, and remove those left by killed processes.

    A folder in use is locked. The lock ends with its process, unlike a process id in the
    folder's name, which could be reused.

    Args:
        parent: Folder to make it in; made if missing.
        prefix: One of `PREFIXES`.

    Yields:
        The folder.

    Raises:
        OSError: The parent cannot be written to.
    """
    parent.mkdir(parents=True, exist_ok=True)
    folder = parent / f"{prefix}{secrets.token_hex(8)}"
    # Twice, and before it is made: Ctrl-C may come at any instant, also while it is removed.
    with _removed(folder), _removed(folder), ExitStack() as stack:
        with locked(parent, wait=True):  # so that nobody sees the folder before it is locked
            _remove_stale(parent, (prefix,))
            folder.mkdir(mode=0o700)
            stack.enter_context(locked(folder, wait=False))
        yield folder


@contextmanager
def _removed(folder: Path) -> Iterator[None]:
    """Remove a folder at the end."""
    try:
        yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_stale(root: Path) -> None:
    """Remove folders that killed processes left in a cache folder."""
    with suppress(OSError):
        for parent in [root, *(child for child in root.iterdir() if child.is_dir())]:
            if any(_scratch(parent, PREFIXES)):
                with locked(parent, wait=True):
                    _remove_stale(parent, PREFIXES)


def _scratch(parent: Path, prefixes: tuple[str, ...]) -> Iterator[Path]:
    for prefix in prefixes:
        yield from parent.glob(f"{prefix}*")


def _remove_stale(parent: Path, prefixes: tuple[str, ...]) -> None:
    for folder in _scratch(parent, prefixes):
        with suppress(OSError), locked(folder, wait=False) as mine:
            if mine:
                shutil.rmtree(folder, ignore_errors=True)


if sys.platform == "win32":  # has no locks on folders, so stale folders stay

    @contextmanager
    def locked(folder: Path, *, wait: bool) -> Iterator[Any]:
        """Do nothing."""
        yield False
else:

    @contextmanager
    def locked(folder: Path, *, wait: bool) -> Iterator[Any]:
        """Lock a folder against other processes; yield whether that worked."""
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except OSError:  # held by another process, or a file system without locks
                yield False
            else:
                yield True
        finally:
            os.close(descriptor)
