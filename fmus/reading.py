"""Reads files that users name: numbers in them, archives (.fmu and .ssp), and the XML in these.

An FMU is code that the user has chosen to run, so this does not protect from its contents.
"""

from __future__ import annotations

import errno
import hashlib
import math
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Final
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from .atomic import cache_folder, in_cache
from .errors import InputError, one_line

# Of an archive, unpacked: so many bytes in any case, or so many times its own size.
ANY_SIZE: Final = 100_000_000
MOST_TIMES: Final = 100
MOST_BYTES: Final = 8_000_000_000
_BLOCK: Final = 4096  # [byte] that the smallest file takes on a disk
_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def finite_number(text: str) -> float | None:
    """Read a decimal number of an XML file; None if it is none, or not finite."""
    # Python itself would also take `1_000`, `infinity` and the digits of all scripts.
    text = text.strip()
    number = float(text) if _DECIMAL.fullmatch(text) else math.nan
    return number if math.isfinite(number) else None


@contextmanager
def open_regular(path: Path) -> Iterator[BufferedReader]:
    """Open a regular file to read bytes."""
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_file():  # a pipe or device could block or never end
            raise InputError(f"{path}: not a regular file")
        with path.open("rb") as file:
            yield file
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{str(path)!a}: cannot be read: {reason}") from error


def unpack(path: Path, label: str = "") -> tuple[Path, str]:
    """Unpack an archive into the cache, unless it is there; returns its folder and its SHA-256.

    Messages about what is in it call it by its label, else by its path.
    """
    # Its bytes are read once: the folder's name is the hash of what is in it, whoever writes the
    # file meanwhile.
    with open_regular(path) as file:
        content = file.read()
    sha256 = hashlib.sha256(content).hexdigest()
    destination = cache_folder() / "unpacked" / sha256[:24]
    if not destination.is_dir():
        with in_cache(destination) as folder:
            folder.mkdir(mode=0o700)
            try:
                with zipfile.ZipFile(BytesIO(content)) as archive:
                    _check_size(label or str(path), archive, len(content))
                    for member in archive.infolist():  # some are named as on Windows
                        member.filename = member.filename.replace("\\", "/")
                        archive.extract(member, folder)  # also ../evil or /evil, taken as evil
            except Exception as error:  # zipfile raises ten types for damaged archives
                # Of the cache, unless it has no number (bz2) or is EINVAL (a wild offset).
                disk = getattr(error, "errno", None) not in (None, errno.EINVAL)
                if disk or isinstance(error, InputError):
                    raise
                reason = one_line(error)
                raise InputError(f"{label or path}: not a valid zip archive: {reason}") from error
            try:
                folder.rename(destination)
            except OSError:
                if not destination.is_dir():  # else somebody was faster
                    raise
    return destination, sha256


def _check_size(label: str, archive: zipfile.ZipFile, packed: int) -> None:
    """Refuse an archive that would fill the disk; zipfile writes no more than a member declares."""
    unpacked = sum(max(member.file_size, _BLOCK) for member in archive.infolist())
    most = min(max(MOST_TIMES * packed, ANY_SIZE), MOST_BYTES)
    if unpacked > most:
        raise InputError(
            f"{label}: its {packed / 1e6:.3g} MB would be {unpacked / 1e6:.0f} MB unpacked; "
            f"must be at most {most / 1e6:.0f} MB"
        )


def file_inside(folder: Path, source: str, root: Path, label: str) -> Path:
    """Path of a file that an archive's own file names by a URI, relative to a folder in it."""
    path = (folder / unquote(source)).resolve()
    if not (path.is_file() and path.is_relative_to(root.resolve())):
        raise InputError(f"{label}: source {source!r}; must be a file inside its archive")
    return path


def read_xml(path: Path, label: str) -> ET.Element:
    """Read an XML file and return its root element."""
    try:
        # ElementTree reads no external entities, and expat limits how far internal ones expand.
        return ET.parse(path).getroot()  # noqa: S314
    except FileNotFoundError:
        raise InputError(f"{label}: no such file") from None
    except (OSError, ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{label}: not well-formed XML: {one_line(error)}") from None
