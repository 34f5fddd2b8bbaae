"""The structure of an SSP: its FMUs and connections, without the systems around them.

An FMU `c` in the nested system `b` is the component `b/c`. Connections by way of connectors of a
system become one from FMU to FMU.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn
from xml.etree import ElementTree as ET

from ..build.ssp import PREFIXES, STRUCTURE_FILE
from ..errors import InputError, did_you_mean
from ..interface.tables import Connection
from ..interface.units import PLAIN, Units, conversion
from ..interface.variables import Variable, check_elements
from ..reading import file_inside, finite_number, read_xml, unpack
from .fmu_file import Fmu, read_fmu, read_units

FMU: Final = "application/x-fmu-sharedlibrary"
# Kinds of connectors that give values: those of an element, and those of the system around it.
GIVING: Final = ("output", "calculatedParameter", "constant", "local")
HANDED_DOWN: Final = ("input", "parameter", "structuralParameter")
End = tuple[str, str]  # an element, "" for the whole system; a scalar of a connector
STEP_SIZE: Final = "ssd:Annotations/ssc:Annotation/osp:StepSizeHint"
_OTHERS: Final = ("ConnectionGeometry", "ConnectorGeometry", "Dimension", "Annotations", "Clock")


@dataclass(frozen=True)
class _Connector:
    kind: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Link:
    """What feeds an end."""

    source: End
    linear: tuple[float, float]  # factor and offset, after units are converted
    converts_units: bool
    converts_types: bool = False  # if there is a transformation, which asks for it


class Document:
    """An .ssd file."""

    def __init__(self, folder: Path, label: str) -> None:
        self.folder, self.label = folder, label
        self.root = read_xml(folder / STRUCTURE_FILE, label)
        self.units = read_units(label, self.root.iterfind("ssd:Units/ssc:Unit", PREFIXES))
        system = self.root.find("ssd:System", PREFIXES)
        if not self.root.tag.endswith("}SystemStructureDescription") or system is None:
            self.refuse(f"root element {self.root.tag!r}", "one that describes an ssd:System")
        self.system: ET.Element = system

    def refuse(self, what: str, valid: str) -> NoReturn:
        """Raise an error."""
        raise InputError(f"{self.label}: {what}; must be {valid}")

    def check_name(self, place: str, name: str, valid: Collection[str], what: str) -> None:
        """Refuse a name that is not among the valid ones."""
        if name not in valid:
            self.refuse(place, f"{what}{did_you_mean(name, valid)}")

    def number(self, place: str, text: str) -> float:
        """Read a number; `place` is for the message."""
        number = finite_number(text)
        if number is None:
            self.refuse(f"{place} = {text!r}", "a finite number")
        return number

    def linear(self, place: str, element: ET.Element) -> tuple[float, float]:
        """Factor and offset of the transformation that a connection or a mapping has."""
        change = choice(element)
        if change is None:
            return PLAIN
        if local(change) != "LinearTransformation":
            raise InputError(f"{place}: {local(change)}; must be a LinearTransformation, or none")
        factor, offset = (
            self.number(f"{local(change)}: {key}", change.get(key, default))
            for key, default in (("factor", "1"), ("offset", "0"))
        )
        return factor, offset

    def member(self, source: str) -> Path:
        """Path of a file that is named here; it must be inside the archive."""
        return file_inside(self.folder, source, self.folder, self.label)


class Structure:
    """Reads a system and all those within it, of an .ssp file.

    `system_from_ssp` makes it, and takes a flat system from it; nothing else has use for nesting.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fmus: dict[str, Fmu] = {}  # by component
        self.connectors: dict[str, dict[str, _Connector]] = {}  # by element
        self.items: dict[str, dict[str, list[str]]] = {}  # scalars of variables, or of connectors
        self.units: dict[End, tuple[str, Units]] = {}  # with those that define them
        self.step_sizes: dict[str, float] = {}  # of components that ask for one [s]
        # Elements <ParameterBinding>, and what they are for; later ones take precedence.
        self.bindings: list[tuple[ET.Element, str]] = []
        self.links: dict[End, Link] = {}  # by the end that is fed
        self._elements = 0  # of the systems' connectors
        folder, _ = unpack(path)
        self.document = Document(folder, f"{path}: {STRUCTURE_FILE}")
        self._read_system(self.document.system, "")
        if not self.fmus:
            self.document.refuse("no components", "at least one")

    # Elements.

    def _read_system(self, system: ET.Element, path: str) -> None:
        self.connectors[path], self.items[path] = {}, {}
        for connector in system.iterfind("ssd:Connectors/ssd:Connector", PREFIXES):
            name, shape = connector.get("name", ""), _shape(connector)
            if shape is None:
                self.document.refuse(f"connector {shown((path, name))}: a Dimension", "with a size")
            self._elements += math.prod(shape) if shape else 0
            check_elements(f"{self.path}: connector {shown((path, name))}", self._elements)
            self.items[path][name] = _items(name, shape)
            self._add(connector, path, shape)
        for element in system.iterfind("ssd:Elements/*", PREFIXES):
            name = _inside(path, element.get("name"))
            if name in self.connectors:
                self.document.refuse(f"component name {name!r}", "given, and unique")
            if local(element) == "System":
                self._read_system(element, name)
            else:
                self._read_component(element, name)
        for connection in system.iterfind("ssd:Connections/ssd:Connection", PREFIXES):
            self._connect(connection, path)
        self._bind(system, path)

    def _read_component(self, element: ET.Element, name: str) -> None:
        document, source = self.document, element.get("source", "")
        kind, mode = element.get("type") or FMU, element.get("implementation", "any")
        if local(element) != "Component" or kind != FMU or mode not in ("any", "CoSimulation"):
            what = f"{local(element)} {name!r} of type {kind!r}, implementation {mode!r}"
            document.refuse(what, "a System, or a Component that is an FMU for co-simulation")
        fmu = read_fmu(document.member(source), f"{self.path}: component {name!r} ({source})")
        self.fmus[name], self.connectors[name], items = fmu, {}, self.items.setdefault(name, {})
        for scalar in fmu.variables.values():
            items.setdefault(scalar.variable.name, []).append(scalar.name)
            items.setdefault(scalar.name, [scalar.name])
            self.units[name, scalar.name] = scalar.unit, fmu.units
        for connector in element.iterfind("ssd:Connectors/ssd:Connector", PREFIXES):
            variable = connector.get("name", "")
            if variable in fmu.clocked:
                continue
            place = f"connector {name}.{variable}"
            document.check_name(place, variable, items, "a variable of its FMU")
            row = fmu.variable(items[variable][0]).variable
            self._add(connector, name, row.shape if variable == row.name else ())
        for hint in element.iterfind(STEP_SIZE, PREFIXES):
            self.step_sizes[name] = document.number("StepSizeHint: value", hint.get("value", ""))
        self._bind(element, name)

    def _add(self, connector: ET.Element, path: str, shape: tuple[int, ...]) -> None:
        name, typed = connector.get("name", ""), choice(connector)
        self.connectors[path][name] = _Connector(connector.get("kind", ""), shape)
        unit = "" if typed is None else typed.get("unit", "")
        for end in ((path, item) for item in self.items[path][name]):
            if not self.units.get(end, ("",))[0]:
                self.units[end] = unit, self.document.units

    def _bind(self, element: ET.Element, owner: str) -> None:
        bindings = element.iterfind("ssd:ParameterBindings/ssd:ParameterBinding", PREFIXES)
        self.bindings += [(binding, owner) for binding in bindings]

    # Connections.

    def _connect(self, connection: ET.Element, path: str) -> None:
        ends = [self._end(connection, side, path) for side in ("start", "end")]
        (gives, shape, sources), (also_gives, other, targets) = ends
        place = f"connection from {shown(sources[0])} to {shown(targets[0])}"
        if gives == also_gives:
            self.document.refuse(place, "from an output to an input")
        if shape != other:
            self.document.refuse(f"{place}: dimensions {shape} and {other}", "the same")
        if also_gives:
            sources, targets = targets, sources
        linear = self.document.linear(f"{self.document.label}: {place}", connection)
        is_asked = choice(connection) is not None
        for source, target in zip(sources, targets, strict=True):
            if target in self.links:
                self.document.refuse(f"{place}: {shown(target)} is fed twice", "fed once")
            self.links[target] = Link(source, linear, converts_units(connection), is_asked)

    def _end(
        self, connection: ET.Element, side: str, path: str
    ) -> tuple[bool, tuple[int, ...], list[End]]:
        """One end of a connection: whether it gives values, its shape and its scalars."""
        element = connection.get(f"{side}Element") or None  # OMSimulator writes "" for the system
        name = connection.get(f"{side}Connector", "")
        owner = _inside(path, element)
        place, check_name = f"connection with {shown((owner, name))}", self.document.check_name
        check_name(place, owner, self.connectors, "with one of the system's components")
        check_name(place, name, self.connectors[owner], "with a connector")
        connector, items = self.connectors[owner][name], self.items[owner][name]
        check_name(f"{place}, of kind {connector.kind!r}", connector.kind, GIVING + HANDED_DOWN,
                   "an input, an output or a parameter")  # fmt: skip
        gives = connector.kind in (HANDED_DOWN if element is None else GIVING)
        indices = connection.get(f"{side}Indices", "").split()
        if not indices:
            return gives, connector.shape, [(owner, item) for item in items]
        names, item = _items("", connector.shape), f"[{','.join(indices)}]"
        check_name(f"{place}: indices {item}", item, names, f"in {connector.shape}")
        return gives, (), [(owner, items[names.index(item)])]

    # Without the systems.

    def chain(self, end: End) -> list[End]:
        """Return the ends that a value passes on its way to an end."""
        chain = [end]
        while chain[0] in self.links:
            chain.insert(0, self.links[chain[0]].source)
            if chain[0] in chain[1:]:
                self.document.refuse(f"{shown(end)} feeds itself", "fed by an FMU")
        return chain

    def connections(self) -> Iterator[Connection]:
        """Yield the connections from FMU to FMU."""
        for target in self.links:
            source, *ends = self.chain(target)
            if source[0] in self.fmus and target[0] in self.fmus:
                links = [(end, self.links[end]) for end in ends]
                place = f"{self.document.label}: connection from {shown(source)} to {shown(target)}"
                linear = self.linear(place, self.units[source], links)
                is_asked = any(link.converts_types for _, link in links)
                # What is converted here already is not once more.
                is_plain = conversion(*self.units[source], *self.units[target]) == PLAIN
                converts = is_plain and all(link.converts_units for _, link in links)
                yield Connection(source, target, *linear, converts, is_asked)

    def linear(
        self, place: str, unit: tuple[str, Units], links: Sequence[tuple[End, Link]]
    ) -> tuple[float, float]:
        """Factor and offset by way of some ends, from a value in a unit to the last end."""
        factor, offset = PLAIN
        ends = (end for target, link in links for end in (link.source, target))
        variables = ((self.fmus[e], name) for e, name in ends if e in self.fmus)
        is_difference = any(fmu.variable(n).variable.name in fmu.relative for fmu, n in variables)
        for end, link in links:
            other = self.units[end]
            scale = conversion(*unit, *other) if link.converts_units else PLAIN
            if scale is None:
                must = "must be the same, of the same SI base units, or have suppressUnitConversion"
                raise InputError(f"{place}: unit {unit[0]!r} feeds unit {other[0]!r}; {must}")
            for by, plus in ((scale[0], 0.0 if is_difference else scale[1]), link.linear):
                factor, offset = by * factor, by * offset + plus
            unit = other if other[0] else unit
        return factor, offset


def _shape(connector: ET.Element) -> tuple[int, ...] | None:
    """Dimensions of a connector; None if it does not say all of them."""
    sizes = [d.get("size", "") for d in connector.iterfind("ssc:Dimension", PREFIXES)]
    return tuple(map(int, sizes)) if all(size.isdecimal() for size in sizes) else None


def _inside(path: str, name: str | None) -> str:
    return "/".join(filter(None, (path, name)))


def _items(name: str, shape: tuple[int, ...]) -> list[str]:
    return Variable(name, shape, "", "local", "fixed", "").names()


def shown(end: End) -> str:
    """Name of an end in messages."""
    return ".".join(filter(None, end))


def local(element: ET.Element) -> str:
    """Name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def choice(element: ET.Element) -> ET.Element | None:
    """Return the child that says a type or a transformation, if there is one."""
    return next((child for child in element if local(child) not in _OTHERS), None)


def converts_units(element: ET.Element) -> bool:
    """Whether a connection or a mapping converts units."""
    return element.get("suppressUnitConversion") not in ("true", "1")
