"""Archives: .fmu and .ssp files, unpacked once and completely.

An FMU is code that the user has chosen to run, so this does not protect from its contents. It
turns accidents (a download that was cut short, a file that was changed) into clear messages.
"""

from __future__ import annotations

import errno
import hashlib
import lzma
import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final

from ..atomic import in_cache
from ..errors import InputError
from ..messages import excerpt, one_line
from ..reading import open_regular

MAX_SIZE: Final = 1 << 30  # [byte] unpacked; the largest real FMUs are well below
MAX_MEMBERS: Final = 100_000  # real FMUs have some hundreds, one with a Python environment 10^4
# Raised by zipfile for damaged archives; RuntimeError: for one with a password.
_DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error,
    EOFError, NotImplementedError, OverflowError, RuntimeError, ValueError,
)  # fmt: skip
# Errors of the operating system that are due to the names in an archive, not to the folder.
_BAD_NAMES: Final = (
    errno.EEXIST, errno.EINVAL, errno.EISDIR, errno.ENAMETOOLONG, errno.ENOTDIR, None,
)  # fmt: skip


def file_digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits.

    Raises:
        InputError: The file cannot be read.
    """
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unpack(path: Path, destination: Path) -> Path:
    """Unpack an archive, unless its folder is there; never leaves a partial one.

    Args:
        path: The .fmu or .ssp file.
        destination: Folder to make, in the cache; its name contains a hash of the file.

    Returns:
        The folder.

    Raises:
        InputError: The file is not an archive, is damaged or too large, or the folder cannot be
            written to.
    """
    if not destination.is_dir():
        with in_cache(destination) as folder:
            _extract(path, folder)
            try:
                folder.rename(destination)
            except OSError:
                if not destination.is_dir():  # else somebody was faster
                    raise
    return destination


def _extract(path: Path, folder: Path) -> None:
    """Extract an archive into a new folder."""
    folder.mkdir(mode=0o700)
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            archive.extractall(folder)
    except (*_DAMAGE, OSError) as error:
        if isinstance(error, OSError) and error.errno not in _BAD_NAMES:
            raise  # the folder is at fault, not the archive
        raise InputError(f"{path}: not a valid zip archive: {one_line(error)}") from error


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that is too large, or with member names that point outside the folder."""
    count = len(archive.infolist())
    if count > MAX_MEMBERS:  # each costs time, at each start
        raise InputError(f"{path}: has {count} members; must be at most {MAX_MEMBERS}")
    size = sum(member.file_size for member in archive.infolist())
    if size > MAX_SIZE:
        raise InputError(f"{path}: would unpack to {size} bytes; must be at most {MAX_SIZE}")
    for name in archive.namelist():
        member = PurePosixPath(name)
        if member.is_absolute() or ".." in member.parts or not member.parts:
            raise InputError(f"{path}: member {excerpt(name)}: must be a path inside the archive")
