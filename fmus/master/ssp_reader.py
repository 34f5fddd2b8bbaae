"""Reads SSP files of any origin: a flat system of co-simulation FMUs, for our master."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, NoReturn
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from ..atomic import cache_folder
from ..errors import InputError
from ..interface.tables import Connection
from ..interface.variables import Value
from ..messages import did_you_mean
from ..packaging.ssp import PREFIXES, STRUCTURE_FILE
from ..reading import finite_number
from ..slaves.base import TICK
from .archive import file_digest, unpack
from .compatibility import RECORDED_TYPES, check_value
from .fmu_file import Fmu
from .ssp_elements import check_children
from .ssp_parameters import bound_parameters, parse_value
from .system import System
from .wiring import Name
from .xml_file import read_xml

VERSIONS: Final = ("1.0", "2.0")
FMU_TYPES: Final = ("application/x-fmu-sharedlibrary", "")
DEFAULT_STOP: Final = 1.0  # [s] after the start, if neither the system nor an FMU gives a stop time


@dataclass(frozen=True)
class CoupledSystem:
    """The content of an SSP file, ready for `fmus.master.system.open_system`.

    Attributes:
        name: Name of the system.
        system: FMUs, connections, and the outputs to read.
        start_values: Parameter values by component and variable.
        start_time: Of the default experiment [s].
        stop_time: Of the default experiment [s].
        step_size: Communication step [s].
        warnings: Parts of the file that have no effect.
    """

    name: str
    system: System
    start_values: Mapping[str, Mapping[str, Value]]
    start_time: float
    stop_time: float
    step_size: float
    warnings: tuple[str, ...] = ()


@dataclass
class _Component:
    """One component: its FMU, and its connectors' kinds."""

    fmu: Fmu
    kinds: dict[str, str]


def system_from_ssp(path: Path) -> CoupledSystem:
    """Read an .ssp file.

    Components are stepped in the order in which the file lists them.

    Args:
        path: The file.

    Returns:
        The system.

    Raises:
        InputError: The file is missing or damaged, or needs something that our master cannot do.
    """
    return _Reader(path).read()


class _Reader:
    """Reads one file; all messages name it.

    Args:
        path: The .ssp file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._label = path, f"{path}: {STRUCTURE_FILE}"
        self._folder = unpack(path, cache_folder() / "unpacked" / file_digest(path)[:24])
        self._components: dict[str, _Component] = {}
        self._warnings: list[str] = []

    def read(self) -> CoupledSystem:
        """Read all of it."""
        root = self._parse(STRUCTURE_FILE)
        if not root.tag.endswith("}SystemStructureDescription"):
            self._refuse(f"root element {root.tag!r}", "ssd:SystemStructureDescription")
        if root.get("version") not in VERSIONS:
            self._refuse(f"version {root.get('version')!r}", f"one of {', '.join(VERSIONS)}")
        system = root.find("ssd:System", PREFIXES)
        if system is None:
            self._refuse("no ssd:System", "one")
        check_children(system, self._refuse)
        for name, element in self._elements(system):
            check_children(element, self._refuse)
            self._components[name] = self._component(name, element)
        connections = self._connections(system)
        start, stop = self._experiment(root.find("ssd:DefaultExperiment", PREFIXES))
        return CoupledSystem(
            system.get("name", "system"),
            System(
                {name: component.fmu.path for name, component in self._components.items()},
                connections,
                (),
                self._outputs(connections),
                labels={name: component.fmu.label for name, component in self._components.items()},
            ),
            self._start_values(system),
            start,
            stop,
            self._step_size(root),
            tuple(self._warnings),
        )

    def _refuse(self, what: str, valid: str) -> NoReturn:
        raise InputError(f"{self._label}: {what}; must be {valid}")

    # Files in the archive.

    def _parse(self, member: str) -> ET.Element:
        label = self._label if member == STRUCTURE_FILE else f"{self._label}: {member}"
        return read_xml(self._folder / member, label)

    def _member(self, source: str) -> Path:
        """Path of a file that the system names; it must be inside the archive."""
        member = PurePosixPath(unquote(source))
        if ":" in source or member.is_absolute() or ".." in member.parts:
            self._refuse(f"source {source!r}", "a path inside the .ssp file")
        path = self._folder / member
        try:
            is_there = path.is_file()
        except OSError:  # not a valid name in this file system
            is_there = False
        if not is_there:
            self._refuse(f"source {source!r} is missing", "a file inside the .ssp file")
        return path

    # Components.

    def _elements(self, system: ET.Element) -> Iterator[tuple[str, ET.Element]]:
        seen: set[str] = set()
        for element in system.findall("ssd:Elements/*", PREFIXES):
            name = element.get("name") or ""
            if not element.tag.endswith("}Component"):
                tag = element.tag.rpartition("}")[2]
                self._refuse(f"element {name!r} is a {tag}", "a Component, in one flat system")
            if not name or name in seen:
                self._refuse(f"component name {name!r}", "given, and unique")
            seen.add(name)
            yield name, element
        if not seen:
            self._refuse("no components", "at least one")

    def _component(self, name: str, element: ET.Element) -> _Component:
        kind, source = element.get("type", ""), element.get("source")
        if kind not in FMU_TYPES or not source:
            self._refuse(f"component {name!r} of type {kind!r}", "an FMU with a source")
        fmu = self._fmu(name, source)
        kinds: dict[str, str] = {}
        for connector in element.findall("ssd:Connectors/ssd:Connector", PREFIXES):
            variable = connector.get("name", "")
            if variable not in fmu.variables:
                hint = did_you_mean(variable, fmu.variables)
                self._refuse(f"connector {name}.{variable}", f"a variable of its FMU{hint}")
            kinds[variable] = connector.get("kind", "")
        return _Component(fmu, kinds)

    def _fmu(self, component: str, source: str) -> Fmu:
        """Read an FMU; messages name the .ssp file rather than the folder it is unpacked in."""
        path = self._member(source)
        try:
            return Fmu(path, f"{self._path}: component {component!r} ({source})")
        except InputError as error:
            raise InputError(str(error).replace(str(path), f"{self._path}: {source}")) from error

    # Connections.

    def _connections(self, system: ET.Element) -> list[Connection]:
        connections: list[Connection] = []
        fed: set[Name] = set()
        for element in system.findall("ssd:Connections/ssd:Connection", PREFIXES):
            if element.get("endElement") is None:
                continue  # to an output of the system itself, which has no effect here
            if len(element):
                self._refuse("a connection with a transformation", "a plain one")
            source = self._end(element, "start", "output")
            target = self._end(element, "end", "input")
            if target in fed:
                self._refuse(f"two connections to {'.'.join(target)}", "one at most")
            fed.add(target)
            connections.append(Connection(source, target))
        return connections

    def _end(self, element: ET.Element, side: str, kind: str) -> Name:
        """One end of a connection."""
        name = element.get(f"{side}Element")
        variable = element.get(f"{side}Connector", "")
        if name is None:
            self._refuse(f"a connection with connector {variable!r} of the system itself",
                         "one between components")  # fmt: skip
        if name not in self._components:
            hint = did_you_mean(name, self._components)
            self._refuse(f"connection with component {name!r}", f"one of the system's{hint}")
        component = self._components[name]
        if variable not in component.kinds:
            hint = did_you_mean(variable, component.kinds)
            self._refuse(f"connection with {name}.{variable}", f"with a connector{hint}")
        if component.kinds[variable] != kind:
            self._refuse(f"connection with {name}.{variable}, a connector of kind "
                         f"{component.kinds[variable]!r}", f"with an {kind}")  # fmt: skip
        declared = component.fmu.variables[variable]
        if declared.type != "Real" or declared.causality != kind:
            self._refuse(f"connection with {name}.{variable}, of type {declared.type} and "
                         f"causality {declared.causality}", f"with a Real {kind}")  # fmt: skip
        return name, variable

    def _outputs(self, connections: list[Connection]) -> dict[str, list[str]]:
        """Outputs of each component; connected ones first, in the order of their targets."""
        outputs: dict[str, list[str]] = {}
        for name, component in self._components.items():
            connected = [c.source[1] for c in connections if c.source[0] == name]
            others = [n for n, kind in component.kinds.items() if kind == "output"]
            outputs[name] = []
            for variable in dict.fromkeys([*connected, *others]):
                kind = component.fmu.variables[variable].type
                if kind in RECORDED_TYPES:
                    outputs[name].append(variable)
                else:
                    self._warnings.append(f"{name}.{variable} is not recorded: it is a {kind}")
        return outputs

    # Parameters and experiment.

    def _start_values(self, system: ET.Element) -> dict[str, dict[str, Value]]:
        """Collect parameter values: the system's own first, then each component's."""
        values: dict[str, dict[str, Value]] = {}
        for name, typed in self._bound(system):
            component, _, variable = name.partition(".")
            self._keep(values, component, variable, typed)
        for component, element in self._elements(system):
            for name, typed in self._bound(element):
                self._keep(values, component, name, typed)
        return values

    def _bound(self, element: ET.Element) -> Iterator[tuple[str, ET.Element]]:
        def file(source: str) -> ET.Element:
            self._member(source)
            return self._parse(unquote(source))

        return bound_parameters(element, file, self._refuse)

    def _keep(
        self, values: dict[str, dict[str, Value]], component: str, name: str, typed: ET.Element
    ) -> None:
        if component not in self._components:
            self._refuse(f"parameter {component}.{name}", "that of a component")
        fmu = self._components[component].fmu
        if name not in fmu.variables:
            hint = did_you_mean(name, fmu.variables)
            self._refuse(f"parameter {component}.{name}", f"a variable of its FMU{hint}")
        variable, place = fmu.variables[name], f"parameter {component}.{name}"
        value = parse_value(place, variable.type, typed, self._refuse)
        check_value(f"{self._label}: {place}", variable, value)
        values.setdefault(component, {})[name] = value

    def _experiment(self, element: ET.Element | None) -> tuple[float, float]:
        """Start and stop time [s]: the system's, or the first and the last of the FMUs'."""
        start = None if element is None else self._number("startTime", element.get("startTime"))
        stop = None if element is None else self._number("stopTime", element.get("stopTime"))
        if start is None:
            start = min(self._named("startTime"), default=0.0)
        if stop is None:
            stop = max(self._named("stopTime"), default=start + DEFAULT_STOP)
        return start, stop

    def _step_size(self, root: ET.Element) -> float:
        """Communication step size [s]: the first that the file or an FMU gives."""
        steps = [
            self._number(attribute, element.get(attribute))
            for tag, attribute in (("oms:FixedStepMaster", "stepSize"),
                                   ("osp:FixedStepAlgorithm", "baseStepSize"))
            for element in root.iterfind(f".//{tag}", PREFIXES)
        ]  # fmt: skip
        step = next((s for s in (*steps, *self._named("stepSize")) if s is not None), TICK)
        if step <= 0:
            self._refuse(f"stepSize = {step!r}", "above 0")
        return step

    def _named(self, attribute: str) -> list[float]:
        """Values of an attribute of the FMUs' default experiments."""
        found = []
        for name, component in self._components.items():
            text = getattr(component.fmu.description.defaultExperiment, attribute, None)
            number = self._number(f"{name}: modelDescription.xml: {attribute}", text)
            found += [] if number is None else [number]
        return found

    def _number(self, place: str, text: str | None) -> float | None:
        if text is None:
            return None
        number = finite_number(text)
        if number is None:
            self._refuse(f"{place} = {text!r}", "a finite number")
        return number
