"""Archives from elsewhere: .fmu and .ssp files are unpacked only if they are harmless."""

from __future__ import annotations

import hashlib
import lzma
import os
import stat
import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final

from ..errors import InputError
from ..packaging.scratch import scratch_folder

MAX_SIZE: Final = 1 << 30  # [byte] unpacked; the largest real FMUs are well below
MAX_RATIO: Final = 200  # [1] unpacked to packed; deflated code and XML stay below 50
MAX_MEMBERS: Final = 20_000
MAX_NAME: Final = 255  # [byte] of a file or folder, as file systems have it
# What zipfile raises on damaged archives; RuntimeError: one that asks for a password.
_DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error,
    EOFError, NotImplementedError, OverflowError, RuntimeError, ValueError,
)  # fmt: skip


def digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
        if not path.is_file():  # a pipe or device could block or never end
            raise InputError(f"{path}: is no plain file; must be an .fmu or .ssp file")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{str(path)!a}: cannot be read: {reason}") from error


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
    try:
        if destination.is_dir():
            return destination
        with scratch_folder(destination.parent, ".unpack-") as folder:
            content = folder / "content"
            _extract(path, content)
            try:
                content.rename(destination)
            except OSError:
                if not destination.is_dir():  # else another process was faster
                    raise
    except OSError as error:
        raise InputError(
            f"{destination.parent}: cannot unpack {path.name} there: {error.strerror or error}; "
            f"set PANDA_COSIM_CACHE to a folder that can be written, with room"
        ) from error
    return destination


def _extract(path: Path, folder: Path) -> None:
    """Extract a checked archive into a new folder."""
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            folder.mkdir()
            for member in archive.infolist():
                archive.extract(member, folder)
    except (*_DAMAGE, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # the place is at fault, not the archive
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a valid zip archive: {words[:300]}") from error


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that would do harm when unpacked."""
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise InputError(f"{path}: {len(members)} members; at most {MAX_MEMBERS} are unpacked")
    size = sum(member.file_size for member in members)
    packed = path.stat().st_size  # not the sum of the members', which may overlap
    if size > MAX_SIZE or size > MAX_RATIO * max(packed, 1 << 16):
        raise InputError(
            f"{path}: would unpack to {size} bytes from {packed}; at most {MAX_SIZE} bytes and "
            f"{MAX_RATIO} times the packed size are unpacked"
        )
    seen: set[str] = set()
    for member in members:
        _check_member(path, member)
        name = str(PurePosixPath(member.filename))
        if name in seen:
            raise InputError(f"{path}: member {_shown(member.filename)} occurs twice")
        seen.add(name)
    folders = {str(parent) for name in seen for parent in PurePosixPath(name).parents}
    for member in members:
        if not member.is_dir() and str(PurePosixPath(member.filename)) in folders:
            raise InputError(f"{path}: member {_shown(member.filename)} is a file and a folder")


def _check_member(path: Path, member: zipfile.ZipInfo) -> None:
    shown = _shown(member.filename)
    name = PurePosixPath(member.filename.replace("\\", "/"))
    windows_drive = len(name.parts) > 0 and ":" in name.parts[0]
    if name.is_absolute() or ".." in name.parts or windows_drive:
        raise InputError(f"{path}: member {shown} would leave the folder")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise InputError(f"{path}: member {shown} is a symbolic link")
    if member.flag_bits & 1:
        raise InputError(f"{path}: member {shown} is encrypted; must be plain")
    if not name.parts or any(len(os.fsencode(part)) > MAX_NAME for part in name.parts):
        raise InputError(f"{path}: member {shown}: each part must have 1 to {MAX_NAME} bytes")


def _shown(name: str) -> str:
    return ascii(name[:80])
