"""Writes archives; equal contents give equal bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from typing import Final

FIXED_DATE: Final = (2026, 1, 1, 0, 0, 0)  # of all members
_COMPRESSED: Final = (".fmu", ".png")  # compressed already


def archive(members: Mapping[str, bytes]) -> bytes:
    """Return a zip file with its members in alphabetical order."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as file:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, FIXED_DATE)
            info.create_system = 3  # Unix, on every platform
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            packed = zipfile.ZIP_STORED if name.endswith(_COMPRESSED) else zipfile.ZIP_DEFLATED
            file.writestr(info, members[name], packed, compresslevel=9)
    return made.getvalue()
