"""Files of the cache: used if they are intact, else made again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ..errors import InputError
from .cache import private_folder
from .scratch import BUILD, scratch_folder

CHECK_SUFFIX: Final = ".sha256"  # of the file beside each, with its hash


def cached(path: Path, make: Callable[[], bytes]) -> Path:
    """Return a file of the cache, made if it is missing or damaged.

    Args:
        path: Its path, which contains a hash of everything that the content depends on.
        make: Function that makes the content.

    Raises:
        InputError: The cache cannot be written to, or other users can write to it.
    """
    try:
        private_folder(path.parent)
        if not is_whole(path):
            content = make()
            with scratch_folder(path.parent, BUILD) as folder:
                # Renames are atomic: another process may be making the same file.
                _put(folder, path, content)
                check = hashlib.sha256(content).hexdigest().encode()
                _put(folder, path.with_name(path.name + CHECK_SUFFIX), check)
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot write the FMU cache: {error.strerror or error}; "
            f"set PANDA_COSIM_CACHE to a writable folder"
        ) from error
    return path


def is_whole(path: Path) -> bool:
    """Whether a file of the cache is intact; a full disk may have cut it short."""
    check = path.with_name(path.name + CHECK_SUFFIX)
    if not (path.is_file() and check.is_file()):
        return False
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() == check.read_text().strip()


def _put(folder: Path, path: Path, content: bytes) -> None:
    part = folder / path.name
    part.write_bytes(content)
    part.replace(path)
