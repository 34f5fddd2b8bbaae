"""Archives from elsewhere: .fmu and .ssp files are unpacked only if they are harmless."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

from fmus.errors import InputError

MAX_SIZE: Final = 1 << 30  # [byte] unpacked; the largest real FMUs are well below
MAX_RATIO: Final = 200  # [1] unpacked to packed; deflated code and XML stay below 50
MAX_MEMBERS: Final = 20_000


def digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def unpack(path: Path, destination: Path) -> Path:
    """Unpack an archive, or find it unpacked: the folder appears whole or not at all.

    Args:
        path: The .fmu or .ssp file.
        destination: Folder to make; if it exists, it is taken as the unpacked archive.

    Returns:
        The folder.

    Raises:
        InputError: The file is no archive, is damaged, or would write outside the folder or
            fill the disk.
    """
    if destination.is_dir():
        os.utime(destination)
        return destination
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=".unpack-", dir=destination.parent))
    except OSError as error:
        raise InputError(
            f"{destination.parent}: cannot unpack {path.name} there: {error.strerror}; set "
            f"PANDA_COSIM_CACHE to a folder that can be written"
        ) from error
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            archive.extractall(folder)
        try:
            folder.rename(destination)
        except OSError:
            if not destination.is_dir():  # else another process was faster
                raise
    except (zipfile.BadZipFile, NotImplementedError, EOFError, RuntimeError) as error:
        raise InputError(f"{path}: not a valid zip archive: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be unpacked: {error.strerror or error}") from error
    except Exception as error:
        if type(error).__module__ == "zlib":
            raise InputError(f"{path}: damaged zip archive: {error}") from error
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return destination


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that would do harm when unpacked."""
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise InputError(f"{path}: {len(members)} members; at most {MAX_MEMBERS} are unpacked")
    size = sum(member.file_size for member in members)
    packed = sum(member.compress_size for member in members)
    if size > MAX_SIZE or size > MAX_RATIO * max(packed, 1 << 16):
        raise InputError(
            f"{path}: would unpack to {size} bytes from {packed}; at most {MAX_SIZE} bytes and "
            f"{MAX_RATIO} times the packed size are unpacked"
        )
    for member in members:
        name = PurePosixPath(member.filename.replace("\\", "/"))
        windows_drive = len(name.parts) > 0 and ":" in name.parts[0]
        if name.is_absolute() or ".." in name.parts or windows_drive:
            raise InputError(f"{path}: member {member.filename!r} would leave the folder")
        if stat.S_ISLNK(member.external_attr >> 16):
            raise InputError(f"{path}: member {member.filename!r} is a symbolic link")
