"""Reads XML files of unknown origin."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from ..errors import InputError

MAX_SIZE: Final = 64 << 20  # [byte]; the largest real descriptions are below 30 MB


def read_xml(path: Path, label: str) -> ET.Element:
    """Read an XML file.

    Args:
        path: The file.
        label: What to call it in messages.

    Returns:
        The root element.

    Raises:
        InputError: The file is missing, too large, or not well-formed.
    """
    try:
        if not path.is_file():
            raise InputError(f"{label}: there is no such file")
        size = path.stat().st_size
        if size > MAX_SIZE:
            raise InputError(f"{label}: {size} bytes; must be at most {MAX_SIZE}")
        # ElementTree reads no external entities, and expat limits how far internal ones expand.
        return ET.parse(path).getroot()  # noqa: S314
    except OSError as error:
        raise InputError(f"{label}: cannot be read: {error.strerror}") from error
    except ET.ParseError as error:  # also a prefix that no xmlns declares
        raise InputError(f"{label}: not well-formed XML: {error}") from None
    except (ValueError, LookupError) as error:
        raise InputError(f"{label}: cannot be decoded: {error}") from None
