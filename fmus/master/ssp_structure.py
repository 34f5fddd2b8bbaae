"""The structure of an SSP: its FMUs and connections, without the systems around them.

An FMU `c` in the nested system `b` is the component `b.c`. Connections by way of connectors of a
system become one from FMU to FMU.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from ..atomic import cache_folder
from ..build.ssp import PREFIXES, STRUCTURE_FILE
from ..errors import InputError
from ..interface.tables import Connection
from ..interface.units import Units, conversion
from ..interface.variables import Variable
from ..reading import file_digest, unpack
from .fmu_file import Fmu, read_fmu
from .ssp_document import Document, choice, converts_units, local

FMU, SSD, SSP = "x-fmu-sharedlibrary", "x-ssp-definition", "x-ssp-package"  # types of components
# Kinds of connectors that give values: those of an element, and those of the system around it.
GIVING: Final = ("output", "calculatedParameter", "constant", "local")
HANDED_DOWN: Final = ("input", "parameter", "structuralParameter")
DEEPEST: Final = 100  # level of nested systems; a file may contain itself
End = tuple[str, str]  # an element, "" for the whole system; a scalar of a connector


@dataclass(frozen=True)
class _Connector:
    kind: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class _Link:
    """What feeds an end."""

    source: End
    linear: tuple[float, float]  # factor and offset, after units are converted
    converts_units: bool
    document: Document


class Structure:
    """Reads a system and all those within it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fmus: dict[str, Fmu] = {}  # by component
        self.connectors: dict[str, dict[str, _Connector]] = {}  # by element
        self.items: dict[str, dict[str, list[str]]] = {}  # scalars of variables, or of connectors
        self.units: dict[End, tuple[str, Units]] = {}  # with those that define them
        # Elements <ParameterBinding>, and what they are for; later ones take precedence.
        self.bindings: list[tuple[ET.Element, str, Document]] = []
        self._links: dict[End, _Link] = {}  # by the end that is fed
        self.document = _unpacked(path, str(path), STRUCTURE_FILE)
        self._read_system(self.document.system, "", self.document)
        if not self.fmus:
            self.document.refuse("no components", "at least one")

    # Elements.

    def _read_system(self, system: ET.Element, path: str, document: Document) -> None:
        self.connectors[path], self.items[path] = {}, {}
        for connector in system.iterfind("ssd:Connectors/ssd:Connector", PREFIXES):
            name, shape = connector.get("name", ""), _shape(connector)
            if shape is None:
                document.refuse(f"connector {shown((path, name))}: a Dimension", "one with a size")
            self.items[path][name] = _items(name, shape)
            self._add(connector, path, shape, document)
        for element in system.iterfind("ssd:Elements/*", PREFIXES):
            name = element.get("name", "")
            full = f"{path}.{name}" if path else name
            if not name or full in self.connectors:
                document.refuse(f"component name {full!r}", "given, and unique")
            if full.count(".") > DEEPEST:
                document.refuse(f"component {full!r}", f"within at most {DEEPEST} systems")
            self._read_element(element, full, document)
        for connection in system.iterfind("ssd:Connections/ssd:Connection", PREFIXES):
            self._connect(connection, path, document)
        self._bind(system, path, document)

    def _read_element(self, element: ET.Element, path: str, document: Document) -> None:
        if local(element) == "System":
            self._read_system(element, path, document)
            return
        if local(element) != "Component":
            document.refuse(f"element {path!r} is a {local(element)}", "a Component or a System")
        kind, source = element.get("type") or f"application/{FMU}", element.get("source")
        mode = element.get("implementation", "any")
        is_known = kind.removeprefix("application/") in (FMU, SSD, SSP)
        if not (source and is_known) or mode not in ("any", "CoSimulation"):
            what = f"component {path!r} of type {kind!r}, implementation {mode!r}"
            document.refuse(what, "an FMU for co-simulation, an .ssd or .ssp, with a source")
        file, _, variant = source.partition("#")
        member, label = document.member(file), f"{document.label}: {file}"
        if kind.endswith(FMU):
            self._read_fmu(element, path, member, document)
        elif kind.endswith(SSD):
            nested = Document(member, label)
            self._read_system(nested.system, path, nested)
        else:
            nested = _unpacked(member, label, variant or STRUCTURE_FILE)
            self._read_system(nested.system, path, nested)
        self._bind(element, path, document)

    def _read_fmu(self, element: ET.Element, name: str, file: Path, document: Document) -> None:
        source = element.get("source", "")
        try:
            fmu = read_fmu(file, f"{self.path}: component {name!r} ({source})")
        except InputError as error:  # that names the folder which it is unpacked in
            raise InputError(str(error).replace(str(file), f"{self.path}: {source}")) from error
        self.fmus[name], self.connectors[name], items = fmu, {}, self.items.setdefault(name, {})
        for scalar in fmu.variables.values():
            items.setdefault(scalar.variable.name, []).append(scalar.name)
            items.setdefault(scalar.name, [scalar.name])
            self.units[name, scalar.name] = scalar.unit, fmu.units
        for connector in element.iterfind("ssd:Connectors/ssd:Connector", PREFIXES):
            variable, kind = connector.get("name", ""), connector.get("kind", "")
            place = f"connector {name}.{variable}"
            document.check_name(place, variable, items, "a variable of its FMU")
            row = fmu.variable(items[variable][0]).variable
            if kind in ("input", "output") and row.causality != kind:
                document.refuse(f"{place} of kind {kind!r}", f"{row.causality!r}, as its variable")
            shape = row.shape if variable == row.name else ()
            if _shape(connector) not in (None, (), shape):
                document.refuse(f"{place}: dimensions {_shape(connector)}", f"{shape}")
            self._add(connector, name, shape, document)
        self.units |= {
            (name, s.name): (s.unit, fmu.units) for s in fmu.variables.values() if s.unit
        }

    def _add(
        self, connector: ET.Element, path: str, shape: tuple[int, ...], document: Document
    ) -> None:
        name, typed = connector.get("name", ""), choice(connector)
        self.connectors[path][name] = _Connector(connector.get("kind", ""), shape)
        unit = "" if typed is None else typed.get("unit", "")
        for end in ((path, item) for item in self.items[path][name]):
            if not self.units.get(end, ("",))[0]:
                self.units[end] = unit, document.units

    def _bind(self, element: ET.Element, owner: str, document: Document) -> None:
        bindings = element.iterfind("ssd:ParameterBindings/ssd:ParameterBinding", PREFIXES)
        self.bindings += [(binding, owner, document) for binding in bindings]

    # Connections.

    def _connect(self, connection: ET.Element, path: str, document: Document) -> None:
        ends = [self._end(connection, side, path, document) for side in ("start", "end")]
        (gives, shape, sources), (also_gives, other, targets) = ends
        place = f"connection from {shown(sources[0])} to {shown(targets[0])}"
        if gives == also_gives:
            document.refuse(place, "from an output to an input")
        if shape != other:
            document.refuse(f"{place}: dimensions {shape} and {other}", "the same")
        if also_gives:
            sources, targets = targets, sources
        linear, change = (1.0, 0.0), choice(connection)
        if change is not None:
            if local(change) != "LinearTransformation":
                document.refuse(f"{place}: {local(change)}", "a LinearTransformation, or none")
            linear = document.linear(change)
        for source, target in zip(sources, targets, strict=True):
            if target in self._links:
                document.refuse(f"{place}: {shown(target)} is fed twice", "fed once")
            self._links[target] = _Link(source, linear, converts_units(connection), document)

    def _end(
        self, connection: ET.Element, side: str, path: str, document: Document
    ) -> tuple[bool, tuple[int, ...], list[End]]:
        """One end of a connection: whether it gives values, its shape and its scalars."""
        element, name = connection.get(f"{side}Element"), connection.get(f"{side}Connector", "")
        owner = ".".join(filter(None, (path, element)))
        place = f"connection with {shown((owner, name))}"
        document.check_name(place, owner, self.connectors, "with one of the system's components")
        document.check_name(place, name, self.connectors[owner], "with a connector")
        connector, items = self.connectors[owner][name], self.items[owner][name]
        if connector.kind not in (*HANDED_DOWN, *GIVING):
            kind = f"{place}, a connector of kind {connector.kind!r}"
            document.refuse(kind, "an input, an output or a parameter")
        gives = connector.kind in (HANDED_DOWN if element is None else GIVING)
        indices = connection.get(f"{side}Indices", "").split()
        if not indices:
            return gives, connector.shape, [(owner, item) for item in items]
        names, item = _items("", connector.shape), f"[{','.join(indices)}]"
        document.check_name(f"{place}: indices {item}", item, names, f"in {connector.shape}")
        return gives, (), [(owner, items[names.index(item)])]

    # Without the systems.

    def chains(self) -> Iterator[list[End]]:
        """Yield the ends that a value passes on its way to each input or parameter of an FMU."""
        for end in self._links:
            chain = [end]
            while chain[0] in self._links and chain[0] not in chain[1:]:
                chain.insert(0, self._links[chain[0]].source)
            if chain[0] in chain[1:]:
                self._links[end].document.refuse(f"{shown(end)} feeds itself", "fed by an FMU")
            if end[0] in self.fmus:
                yield chain

    def connections(self) -> Iterator[Connection]:
        """Yield the connections from FMU to FMU."""
        for chain in self.chains():
            source, target = chain[0], chain[-1]
            if source[0] in self.fmus:
                is_same = self.units[source][0] == self.units[target][0]  # else converted already
                yield Connection(source, target, *self.linear(chain), converts_units=is_same)

    def linear(self, chain: Sequence[End]) -> tuple[float, float]:
        """Factor and offset between the ends of a chain."""
        factor, offset = 1.0, 0.0
        unit, units = self.units[chain[0]]
        for source, target in pairwise(chain):
            link, (other, others) = self._links[target], self.units[target]
            steps = [conversion(unit, units, other, others)] if link.converts_units else []
            for linear in (*steps, link.linear):
                if linear is None:
                    ends = f"connection from {shown(source)} to {shown(target)}"
                    what = f"{ends}: unit {unit!r} feeds unit {other!r}"
                    link.document.refuse(what, "the same, or of the same SI base units")
                factor, offset = linear[0] * factor, linear[0] * offset + linear[1]
            if other:
                unit, units = other, others
        return factor, offset


def _unpacked(path: Path, label: str, file: str) -> Document:
    folder = unpack(path, cache_folder() / "unpacked" / file_digest(path)[:24])
    return Document(folder / file, f"{label}: {file}")


def _shape(connector: ET.Element) -> tuple[int, ...] | None:
    """Dimensions of a connector; None if it does not say all of them."""
    sizes = [d.get("size", "") for d in connector.iterfind("ssc:Dimension", PREFIXES)]
    return tuple(map(int, sizes)) if all(size.isdecimal() for size in sizes) else None


def _items(name: str, shape: tuple[int, ...]) -> list[str]:
    return Variable(name, shape, "", "local", "fixed", "").names()


def shown(end: End) -> str:
    """Name of an end in messages."""
    return ".".join(filter(None, end))
