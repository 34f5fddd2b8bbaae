"""An .ssd file of an SSP: the files and the units that it names, and errors in it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path, PurePosixPath
from typing import Final, NoReturn
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from ..build.ssp import PREFIXES
from ..errors import InputError
from ..interface.units import BASES, Unit, Units
from ..messages import did_you_mean
from ..reading import finite_number, read_xml

_OTHERS: Final = ("ConnectionGeometry", "ConnectorGeometry", "Dimension", "Annotations", "Clock")


class Document:
    """An .ssd file."""

    def __init__(self, file: Path, label: str) -> None:
        self.folder, self.label = file.parent, label
        self.root = read_xml(file, label)
        self.units = self.units_of(self.root.iterfind("ssd:Units/ssc:Unit", PREFIXES))
        system = self.root.find("ssd:System", PREFIXES)
        if not self.root.tag.endswith("}SystemStructureDescription") or system is None:
            valid = "ssd:SystemStructureDescription of a system"
            self.refuse(f"root element {self.root.tag!r}", valid)
        self.system: ET.Element = system

    def refuse(self, what: str, valid: str) -> NoReturn:
        """Raise an error."""
        raise InputError(f"{self.label}: {what}; must be {valid}")

    def check_name(self, place: str, name: str, valid: Collection[str], what: str) -> None:
        """Refuse a name that is not among the valid ones."""
        if name not in valid:
            self.refuse(place, f"{what}{did_you_mean(name, valid)}")

    def number(self, element: ET.Element, attribute: str, default: float) -> float:
        """Read an attribute."""
        text = element.get(attribute, str(default))
        number = finite_number(text)
        if number is None:
            self.refuse(f"{local(element)}: {attribute} = {text!r}", "a finite number")
        return number

    def linear(self, element: ET.Element) -> tuple[float, float]:
        """Factor and offset of a unit or a transformation."""
        return self.number(element, "factor", 1.0), self.number(element, "offset", 0.0)

    def units_of(self, elements: Iterable[ET.Element]) -> Units:
        """Read definitions of units."""
        units = {}
        for name, base in ((e.get("name", ""), e.find("ssc:BaseUnit", PREFIXES)) for e in elements):
            if base is not None:
                exponents = tuple(int(self.number(base, key, 0.0)) for key in BASES)
                units[name] = Unit(exponents, *self.linear(base))
                if not units[name].factor:
                    self.refuse(f"unit {name!r}: factor = 0", "another factor")
        return units

    def member(self, source: str) -> Path:
        """Path of a file that is named here; it must be inside the archive."""
        member = PurePosixPath(unquote(source))
        if ":" in source or member.is_absolute() or ".." in member.parts:
            self.refuse(f"source {source!r}", "a path inside the .ssp file")
        if not (self.folder / member).is_file():
            self.refuse(f"source {source!r} is missing", "a file inside the .ssp file")
        return self.folder / member


def local(element: ET.Element) -> str:
    """Name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def choice(element: ET.Element) -> ET.Element | None:
    """Return the child that says a type or a transformation, if there is one."""
    return next((child for child in element if local(child) not in _OTHERS), None)


def converts_units(element: ET.Element) -> bool:
    """Whether a connection or a mapping converts units."""
    return element.get("suppressUnitConversion") not in ("true", "1")
