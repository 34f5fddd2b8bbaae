"""Folders for half-done work, that vanish with the process however it ends."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl
    import os

# Nobody else's folders are named so: they may stand beside files of the user's.
UNPACK, BUILD, REGRESS = PREFIXES = tuple(
    f".panda-cosim-{work}-" for work in ("unpack", "build", "regress")
)


@contextmanager
def scratch_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Give a new folder that is removed at the end, and remove those that killed processes left.

    A lock on the folder tells one in use from one left behind: it ends with its process, and
    no other process of the same number can be taken for it.

    Args:
        parent: Where to make it; made if missing.
        prefix: One of `PREFIXES`.

    Yields:
        The folder.

    Raises:
        OSError: The place cannot be written to.
    """
    parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        with _locked(parent, wait=True):  # so that nobody sees the folder before it is locked
            _remove_stale(parent, (prefix,))
            folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            stack.enter_context(_locked(folder, wait=False))
        yield folder


def remove_stale(root: Path) -> None:
    """Remove what killed processes left below a cache folder."""
    with suppress(OSError):
        for parent in [root, *(child for child in root.iterdir() if child.is_dir())]:
            if any(_scratch(parent, PREFIXES)):
                with _locked(parent, wait=True):
                    _remove_stale(parent, PREFIXES)


def _scratch(parent: Path, prefixes: tuple[str, ...]) -> Iterator[Path]:
    for prefix in prefixes:
        yield from parent.glob(f"{prefix}*")


def _remove_stale(parent: Path, prefixes: tuple[str, ...]) -> None:
    for folder in _scratch(parent, prefixes):
        with suppress(OSError), _locked(folder, wait=False) as mine:
            if mine:
                shutil.rmtree(folder, ignore_errors=True)


if sys.platform == "win32":  # no locks on folders: what is left behind stays

    @contextmanager
    def _locked(folder: Path, *, wait: bool) -> Iterator[Any]:
        yield False
else:

    @contextmanager
    def _locked(folder: Path, *, wait: bool) -> Iterator[Any]:
        """Lock a folder against other processes; tell whether that worked."""
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
