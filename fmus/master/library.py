"""Checks of a shared library before it is loaded.

Loading a truncated one can kill the process (SIGBUS): the loader maps segments beyond the end of
the file, and touches them.
"""

from __future__ import annotations

import os
import platform
import struct
import sys
from pathlib import Path
from typing import Final

from ..errors import InputError

# Ref: Tool Interface Standard, ELF specification; fields of the 64-bit little-endian file header
# from e_type on: type, machine, version, entry, phoff, shoff, flags, ehsize, phentsize, phnum.
HEADER: Final = struct.Struct("<HHIQQQIHHH")
SEGMENT: Final = struct.Struct("<IIQQQQQQ")  # type, flags, offset, vaddr, paddr, filesz, ...
IDENTITY: Final = b"\x7fELF\x02\x01"  # 64 bits, little-endian
SHARED_OBJECT: Final = 3
LOAD: Final = 1
MACHINES: Final = {"x86_64": 62, "aarch64": 183}


def is_noexec(folder: Path) -> bool:
    """Whether no library can be loaded from a folder, since its file system is mounted noexec."""
    return sys.platform == "linux" and bool(os.statvfs(folder).f_flag & os.ST_NOEXEC)


def check_library(path: Path, label: str) -> None:
    """Check that a file is a complete shared library for this machine; on Linux only.

    Args:
        path: The library.
        label: What to call it in messages.

    Raises:
        InputError: It is not, or its place does not allow to load it.
    """
    if sys.platform != "linux":
        return
    if is_noexec(path.parent):
        raise InputError(
            f"{path.parent}: on a file system mounted noexec, from which no library is loaded; set "
            "PANDA_COSIM_CACHE to a folder on another"
        )
    content = path.read_bytes()
    if content[: len(IDENTITY)] != IDENTITY or len(content) < 16 + HEADER.size:
        raise InputError(f"{label}: not a 64-bit shared library; must be an ELF file")
    kind, machine, _, _, first, _, _, _, size, count = HEADER.unpack_from(content, 16)
    wanted = MACHINES.get(platform.machine(), machine)
    if kind != SHARED_OBJECT or machine != wanted:
        raise InputError(
            f"{label}: a library of type {kind} for machine {machine}; must be of type "
            f"{SHARED_OBJECT} for machine {wanted} ({platform.machine()})"
        )
    end = first + count * size
    if size != SEGMENT.size or end > len(content):
        raise InputError(f"{label}: damaged; its segment table ends at byte {end}")
    for index in range(count):
        segment, _, offset, _, _, length, *_ = SEGMENT.unpack_from(content, first + index * size)
        if segment == LOAD and offset + length > len(content):
            raise InputError(
                f"{label}: damaged; must have {offset + length} bytes, has {len(content)}"
            )
