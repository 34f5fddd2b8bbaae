"""XML from elsewhere: read only if it asks for nothing beyond itself."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NoReturn
from xml.parsers import expat

from ..errors import InputError

MAX_XML: Final = 64 << 20  # [byte]; the largest real descriptions are below 30 MB
MAX_DEPTH: Final = 200  # [1] elements within elements


def check_xml(path: Path, label: str, root: str | None = None) -> dict[str, str]:
    """Refuse an XML file that declares a document type, is too large, or is no XML.

    Entities, which could name other files or grow without bound, can only be declared in a
    document type; FMI and SSP have no use for one.

    Args:
        path: The file.
        label: What to call it in messages.
        root: Name that the root element must have; None: any.

    Returns:
        The root element's attributes.

    Raises:
        InputError: It is missing or refused.
    """
    try:
        if not path.is_file():
            raise InputError(f"{label}: there is no such file")
        size = path.stat().st_size
        if size > MAX_XML:
            raise InputError(f"{label}: {size} bytes; must be at most {MAX_XML}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{label}: cannot be read: {error.strerror}") from error
    found: list[tuple[str, dict[str, str]]] = []
    try:
        _parser(label, found).Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(f"{label}: not well-formed XML: {error}") from None
    except (ValueError, LookupError) as error:  # an encoding that is none
        raise InputError(f"{label}: cannot be decoded: {error}") from None
    name, attributes = found[0]
    if root not in (None, name):
        raise InputError(f"{label}: root element {name[:80]!a}; must be {root}")
    return attributes


def _parser(label: str, root: list[tuple[str, dict[str, str]]]) -> expat.XMLParserType:
    """Return a parser that appends the root element to a list."""
    parser = expat.ParserCreate()
    depth = 0

    def refuse(*_: object) -> NoReturn:
        raise InputError(
            f"{label}: line {parser.CurrentLineNumber}: declares a document type (<!DOCTYPE>); "
            f"must not, since that could read other files"
        )

    def enter(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if not root:
            root.append((name, attributes))
        if depth > MAX_DEPTH:
            raise InputError(
                f"{label}: line {parser.CurrentLineNumber}: elements nested deeper than {MAX_DEPTH}"
            )

    def leave(_name: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = enter
    parser.EndElementHandler = leave
    return parser
