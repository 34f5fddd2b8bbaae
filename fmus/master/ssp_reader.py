"""SSP files from anywhere: a flat system of co-simulation FMUs, for our master."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, NoReturn
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from ..errors import InputError
from ..interface.tables import Connection
from ..interface.variables import Value
from ..messages import did_you_mean
from ..packaging.build import cache_folder
from ..packaging.ssp import PREFIXES, STRUCTURE_FILE
from ..slaves.base import TICK
from .algorithm import Name
from .archive import digest, unpack
from .fmu_file import Fmu, FmuVariable
from .system import System
from .xmlcheck import check_xml

VERSIONS: Final = ("1.0", "2.0")
FMU_TYPES: Final = ("application/x-fmu-sharedlibrary", "")
DEFAULT_STOP: Final = 1.0  # [s] where neither the system nor an FMU says


@dataclass(frozen=True)
class CoupledSystem:
    """What an SSP file holds, ready for `fmus.master.system.open_session`.

    Attributes:
        name: Name of the system.
        system: FMUs, connections, and the outputs to read.
        start_values: Parameter values by component and variable.
        stop_time: Of the default experiment [s].
        step_size: Communication step [s].
    """

    name: str
    system: System
    start_values: Mapping[str, Mapping[str, Value]]
    stop_time: float
    step_size: float


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
        InputError: The file is missing, damaged, or asks for what our master cannot do; the
            message says which.
    """
    return _Reader(path).read()


class _Reader:
    """Reads one file; all messages name it.

    Args:
        path: The .ssp file.
    """

    def __init__(self, path: Path) -> None:
        self._label = f"{path}: {STRUCTURE_FILE}"
        self._folder = unpack(path, cache_folder() / "unpacked" / digest(path)[:24])
        self._values: dict[str, dict[str, Value]] = {}

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
        components = {name: self._component(name, c) for name, c in self._elements(system)}
        connections = [self._connection(c, components) for c in self._connections(system)]
        self._check_targets(connections)
        self._parameters(system, components)
        fmus = {name: component.fmu.path for name, component in components.items()}
        coupled = System(fmus, connections, (), _outputs(components, connections))
        experiment = root.find("ssd:DefaultExperiment", PREFIXES)
        stop = self._number(experiment, "stopTime") if experiment is not None else None
        return CoupledSystem(
            system.get("name", "system"),
            coupled,
            self._values,
            stop or _default_stop(components) or DEFAULT_STOP,
            self._step_size(root, components),
        )

    def _refuse(self, what: str, valid: str) -> NoReturn:
        raise InputError(f"{self._label}: {what}; must be {valid}")

    def _parse(self, member: str) -> ET.Element:
        path = self._folder / member
        check_xml(path, self._label if member == STRUCTURE_FILE else f"{self._label}: {member}")
        return ET.parse(path).getroot()

    def _member(self, source: str) -> Path:
        """Path of a file that the system names; it must be inside."""
        member = PurePosixPath(unquote(source))
        if ":" in source or member.is_absolute() or ".." in member.parts:
            self._refuse(f"source {source!r}", "a path inside the .ssp file")
        path = self._folder / member
        if not path.is_file():
            self._refuse(f"source {source!r} is missing", "a file inside the .ssp file")
        return path

    def _elements(self, system: ET.Element) -> Iterator[tuple[str, ET.Element]]:
        seen: set[str] = set()
        for element in system.findall("ssd:Elements/*", PREFIXES):
            name = element.get("name") or ""
            if not element.tag.endswith("}Component"):
                tag = element.tag.rpartition("}")[2]
                self._refuse(f"element {name!r} is a {tag}", "a Component, in one flat system")
            if not name or name in seen:
                self._refuse(f"component name {name!r}", "there, and unique")
            seen.add(name)
            yield name, element
        if not seen:
            self._refuse("no components", "at least one")

    def _component(self, name: str, element: ET.Element) -> _Component:
        kind, source = element.get("type", ""), element.get("source")
        if kind not in FMU_TYPES or not source:
            self._refuse(f"component {name!r} of type {kind!r}", "an FMU with a source")
        fmu = Fmu(self._member(source))
        kinds: dict[str, str] = {}
        for connector in element.findall("ssd:Connectors/ssd:Connector", PREFIXES):
            variable = connector.get("name", "")
            if variable not in fmu.variables:
                hint = did_you_mean(variable, fmu.variables)
                self._refuse(f"connector {name}.{variable}", f"a variable of its FMU{hint}")
            kinds[variable] = connector.get("kind", "")
        return _Component(fmu, kinds)

    @staticmethod
    def _connections(system: ET.Element) -> list[ET.Element]:
        """Connections between components; the system's own outputs are of no use here."""
        connections = system.findall("ssd:Connections/ssd:Connection", PREFIXES)
        return [c for c in connections if c.get("endElement") is not None]

    def _connection(self, element: ET.Element, components: dict[str, _Component]) -> Connection:
        if len(element):
            self._refuse("a connection with a transformation", "a plain one")
        start = self._end(element, "start", "output", components)
        end = self._end(element, "end", "input", components)
        return Connection(start, end)

    def _end(
        self, element: ET.Element, side: str, kind: str, components: dict[str, _Component]
    ) -> Name:
        """One end of a connection."""
        name = element.get(f"{side}Element")
        variable = element.get(f"{side}Connector", "")
        if name is None:
            self._refuse(f"a connection with connector {variable!r} of the system itself",
                         "one between components")  # fmt: skip
        if name not in components:
            hint = did_you_mean(name, components)
            self._refuse(f"connection with component {name!r}", f"one of the system's{hint}")
        component = components[name]
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

    def _check_targets(self, connections: list[Connection]) -> None:
        fed: set[Name] = set()
        for connection in connections:
            if connection.target in fed:
                self._refuse(f"two connections to {'.'.join(connection.target)}", "one at most")
            fed.add(connection.target)

    def _parameters(self, system: ET.Element, components: dict[str, _Component]) -> None:
        """Collect parameter values: the system's own first, then each component's."""
        for name, value in self._bound(system):
            component, _, variable = name.partition(".")
            self._keep(components, component, variable, value)
        for component, element in self._elements(system):
            for name, value in self._bound(element):
                self._keep(components, component, name, value)

    def _bound(self, element: ET.Element) -> Iterator[tuple[str, ET.Element]]:
        """Yield name and typed value of each parameter bound to an element."""
        for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", PREFIXES):
            if binding.find("ssd:ParameterMapping", PREFIXES) is not None:
                self._refuse("a parameter mapping", "parameters under their own names")
            source, prefix = binding.get("source"), binding.get("prefix", "")
            if source:
                self._member(source)
                sets = [self._parse(source)]
            else:
                sets = binding.findall("ssd:ParameterValues/ssv:ParameterSet", PREFIXES)
            for parameter_set in sets:
                for parameter in parameter_set.findall("ssv:Parameters/ssv:Parameter", PREFIXES):
                    if len(parameter) != 1:
                        self._refuse(f"parameter {parameter.get('name')!r}", "of one value")
                    yield prefix + parameter.get("name", ""), parameter[0]

    def _keep(
        self, components: dict[str, _Component], component: str, name: str, typed: ET.Element
    ) -> None:
        if component not in components:
            self._refuse(f"parameter {component}.{name}", "that of a component")
        found = components[component].fmu.variables.get(name)
        if found is None:
            hint = did_you_mean(name, components[component].fmu.variables)
            self._refuse(f"parameter {component}.{name}", f"a variable of its FMU{hint}")
        value = self._value(f"{component}.{name}", found, typed)
        self._values.setdefault(component, {})[name] = value

    def _value(self, place: str, variable: FmuVariable, typed: ET.Element) -> Value:
        tag, text, kind = typed.tag.rpartition("}")[2], typed.get("value"), variable.type
        if text is not None and kind == "Enumeration" and tag in ("Enumeration", "String"):
            return text  # the item's name, which is checked like any start value
        if text is None or {"Enumeration": "Integer"}.get(kind, kind) != tag:
            self._refuse(f"parameter {place} of type {tag}", f"a value of type {kind}")
        if kind == "Boolean":
            if text not in ("true", "false", "0", "1"):
                self._refuse(f"parameter {place} = {text!r}", "true or false")
            return text in ("true", "1")
        if kind == "String":
            return text
        number = self._number(typed, "value")
        assert number is not None
        return number

    def _number(self, element: ET.Element, attribute: str) -> float | None:
        text = element.get(attribute)
        if text is None:
            return None
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self._refuse(f"{attribute} = {text!r}", "a finite number")
        return number

    def _step_size(self, root: ET.Element, components: dict[str, _Component]) -> float:
        """Step of the fixed-step master: the first that the file or an FMU names."""
        for tag, attribute in (("oms:FixedStepMaster", "stepSize"),
                               ("osp:FixedStepAlgorithm", "baseStepSize")):  # fmt: skip
            for element in root.iterfind(f".//{tag}", PREFIXES):
                step = self._number(element, attribute)
                if step is not None and step <= 0:
                    self._refuse(f"{attribute} = {step!r}", "above 0")
                if step is not None:
                    return step
        for component in components.values():
            experiment = component.fmu.description.defaultExperiment
            if experiment is not None and experiment.stepSize:
                return float(experiment.stepSize)
        return TICK


def _default_stop(components: dict[str, _Component]) -> float:
    """The longest stop time that an FMU names [s], or 0."""
    experiments = [c.fmu.description.defaultExperiment for c in components.values()]
    return max((float(e.stopTime) for e in experiments if e is not None and e.stopTime), default=0)


def _outputs(
    components: dict[str, _Component], connections: list[Connection]
) -> dict[str, list[str]]:
    """Real outputs of each component; connected ones first, in the order of what they feed."""
    outputs: dict[str, list[str]] = {}
    for name, component in components.items():
        connected = [c.source[1] for c in connections if c.source[0] == name]
        others = [
            n
            for n, kind in component.kinds.items()
            if kind == "output" and component.fmu.variables[n].type == "Real"
        ]
        outputs[name] = list(dict.fromkeys([*connected, *others]))
    return outputs
