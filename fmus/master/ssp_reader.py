"""Reads SSP files of any origin: a flat system of co-simulation FMUs, for our master."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, NoReturn
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from ..atomic import cache_folder
from ..build.ssp import PREFIXES, STRUCTURE_FILE
from ..errors import InputError
from ..inside.base import TICK
from ..interface.tables import Connection
from ..interface.variables import Value
from ..messages import did_you_mean
from ..reading import file_digest, finite_number, read_xml, unpack
from .fmu_file import Fmu, read_fmu, read_value
from .system import RECORDED_KINDS, System
from .wiring import Name

PARAMETER: Final = "ssv:Parameters/ssv:Parameter"
FMU_TYPES: Final = ("application/x-fmu-sharedlibrary", "")
DEFAULT_STOP: Final = 1.0  # [s] after the start, if neither the system nor an FMU gives a stop time
# Where a file may say the master's step size.
STEP_SIZES: Final = {
    "oms:FixedStepMaster": "stepSize", "osp:FixedStepAlgorithm": "baseStepSize"
}  # fmt: skip


@dataclass(frozen=True)
class CoupledSystem:
    """The content of an SSP file, ready for `open_system`."""

    name: str
    system: System  # FMUs, connections, and the outputs to read
    start_values: Mapping[str, Mapping[str, Value]]  # by component and variable
    start_time: float  # [s]
    stop_time: float  # [s]
    step_size: float  # [s]
    warnings: tuple[str, ...] = ()  # parts of the file that have no effect


def system_from_ssp(path: Path) -> CoupledSystem:
    """Read an .ssp file; components are stepped in the order in which it lists them."""
    return _Reader(path).read()


class _Reader:
    """Reads one file; all messages name it."""

    def __init__(self, path: Path) -> None:
        self._path, self._label = path, f"{path}: {STRUCTURE_FILE}"
        self._folder = unpack(path, cache_folder() / "unpacked" / file_digest(path)[:24])
        self._fmus: dict[str, Fmu] = {}  # by component
        self._kinds: dict[str, dict[str, str]] = {}  # of connectors, by component and variable
        self._values: dict[str, dict[str, Value]] = {}
        self._warnings: list[str] = []

    def read(self) -> CoupledSystem:
        """Read all of it."""
        root = read_xml(self._folder / STRUCTURE_FILE, self._label)
        system = root.find("ssd:System", PREFIXES)
        if not root.tag.endswith("}SystemStructureDescription") or system is None:
            self._refuse(f"root element {root.tag!r}", "ssd:SystemStructureDescription of a system")
        elements = system.findall("ssd:Elements/*", PREFIXES)
        for element in elements:
            self._read_component(element)
        if not elements:
            self._refuse("no components", "at least one")
        self._read_parameters(system)  # the system's own first, then each component's
        for element in elements:
            self._read_parameters(element, f"{element.get('name')}.")
        connections = [
            Connection(self._end(element, "start", "output"), self._end(element, "end", "input"))
            for element in system.findall("ssd:Connections/ssd:Connection", PREFIXES)
            if element.get("endElement") is not None  # else to an output of the system itself
        ]
        outputs = {name: self._outputs(name, connections) for name in self._fmus}
        start, stop, step = self._experiment(root)
        return CoupledSystem(
            system.get("name", "system"),
            System(
                {name: fmu.path for name, fmu in self._fmus.items()},
                connections,
                outputs=outputs,
                labels={name: fmu.label for name, fmu in self._fmus.items()},
            ),
            self._values,
            start,
            stop,
            step,
            tuple(self._warnings),
        )

    def _refuse(self, what: str, valid: str) -> NoReturn:
        raise InputError(f"{self._label}: {what}; must be {valid}")

    def _check_name(self, place: str, name: str, valid: Collection[str], what: str) -> None:
        if name not in valid:
            self._refuse(place, f"{what}{did_you_mean(name, valid)}")

    def _member(self, source: str) -> Path:
        """Path of a file that the system names; it must be inside the archive."""
        member = PurePosixPath(unquote(source))
        if ":" in source or member.is_absolute() or ".." in member.parts:
            self._refuse(f"source {source!r}", "a path inside the .ssp file")
        if not (self._folder / member).is_file():
            self._refuse(f"source {source!r} is missing", "a file inside the .ssp file")
        return self._folder / member

    # Components.

    def _read_component(self, element: ET.Element) -> None:
        name, tag = element.get("name") or "", element.tag.rpartition("}")[2]
        kind, source = element.get("type", ""), element.get("source")
        if tag != "Component":
            self._refuse(f"element {name!r} is a {tag}", "a Component, in one flat system")
        if not name or name in self._fmus:
            self._refuse(f"component name {name!r}", "given, and unique")
        if kind not in FMU_TYPES or not source:
            self._refuse(f"component {name!r} of type {kind!r}", "an FMU with a source")
        path = self._member(source)
        try:
            self._fmus[name] = read_fmu(path, f"{self._path}: component {name!r} ({source})")
        except InputError as error:  # that names the folder which it is unpacked in
            raise InputError(str(error).replace(str(path), f"{self._path}: {source}")) from error
        self._kinds[name] = {
            connector.get("name", ""): connector.get("kind", "")
            for connector in element.findall("ssd:Connectors/ssd:Connector", PREFIXES)
        }
        for variable in self._kinds[name]:
            place = f"connector {name}.{variable}"
            self._check_name(place, variable, self._fmus[name].variables, "a variable of its FMU")

    def _end(self, element: ET.Element, side: str, kind: str) -> Name:
        """One end of a connection."""
        name, variable = element.get(f"{side}Element"), element.get(f"{side}Connector", "")
        if len(element):
            self._refuse("a connection with a transformation", "a plain one")
        if name is None:
            self._refuse(f"a connection with connector {variable!r} of the system itself",
                         "one between components")  # fmt: skip
        place = f"connection with {name}.{variable}"
        self._check_name(place, name, self._fmus, "with one of the system's components")
        self._check_name(place, variable, self._kinds[name], "with a connector")
        if self._kinds[name][variable] != kind:
            self._refuse(f"{place}, a connector of kind {self._kinds[name][variable]!r}",
                         f"with an {kind}")  # fmt: skip
        return name, variable

    def _outputs(self, component: str, connections: list[Connection]) -> list[str]:
        """Outputs of a component; connected ones first, in the order of their targets."""
        connected = [c.source[1] for c in connections if c.source[0] == component]
        others = [name for name, kind in self._kinds[component].items() if kind == "output"]
        variables = self._fmus[component].variables
        kinds = {n: variables[n].variable.kind for n in dict.fromkeys([*connected, *others])}
        self._warnings += [
            f"{component}.{name} is not recorded: it is a {kind}"
            for name, kind in kinds.items()
            if kind not in RECORDED_KINDS
        ]
        return [name for name, kind in kinds.items() if kind in RECORDED_KINDS]

    # Parameters and experiment.

    def _read_parameters(self, element: ET.Element, component: str = "") -> None:
        """Read the values that are bound to a component, or to the whole system."""
        for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", PREFIXES):
            if binding.find("ssd:ParameterMapping", PREFIXES) is not None:
                self._refuse("a parameter mapping", "parameters under their own names")
            sets = binding.findall("ssd:ParameterValues/ssv:ParameterSet", PREFIXES)
            if source := binding.get("source"):
                sets = [read_xml(self._member(source), f"{self._label}: {source}")]
            for parameter in (p for each in sets for p in each.findall(PARAMETER, PREFIXES)):
                name = component + binding.get("prefix", "") + parameter.get("name", "")
                self._read_parameter(name, parameter)

    def _read_parameter(self, name: str, parameter: ET.Element) -> None:
        place = f"parameter {name}"
        component, _, variable = name.partition(".")
        self._check_name(place, component, self._fmus, "that of a component")
        variables = self._fmus[component].variables
        self._check_name(place, variable, variables, "a variable of its FMU")
        scalar, place = variables[variable], f"{self._label}: {place}"
        kind = scalar.variable.kind
        tags = {"Enumeration": ("Integer", "Enumeration", "String")}.get(kind, (kind,))
        typed = parameter[0] if len(parameter) == 1 else parameter
        text = typed.get("value")
        if text is None or typed.tag.rpartition("}")[2] not in tags:
            raise InputError(f"{place}; must be one value of type {kind}")
        value = read_value(f"{place} =", scalar.variable, text)
        self._values.setdefault(component, {})[variable] = scalar.checked(place, value)

    def _experiment(self, root: ET.Element) -> tuple[float, float, float]:
        """Start, stop and step size [s]: what the file says, or else what the FMUs do."""
        element = root.find("ssd:DefaultExperiment", PREFIXES)
        times = {} if element is None else element.attrib
        steps = [
            each.get(attribute)
            for tag, attribute in STEP_SIZES.items()
            for each in root.iterfind(f".//{tag}", PREFIXES)
        ]
        starts = self._times("startTime", [times.get("startTime")])
        start = min(starts, default=0.0)
        stops = self._times("stopTime", [times.get("stopTime")])
        stop = max(stops, default=start + DEFAULT_STOP)
        step = (*self._times("stepSize", steps), TICK)[0]
        if step <= 0:
            self._refuse(f"stepSize = {step!r}", "above 0")
        return start, stop, step

    def _times(self, attribute: str, texts: list[str | None]) -> list[float]:
        """Times [s] that the file gives; if it gives none, those of the FMUs' experiments."""
        given = [(attribute, text) for text in texts if text is not None]
        for name, fmu in self._fmus.items() if not given else ():
            text = getattr(fmu.description.defaultExperiment, attribute, None)
            given += [(f"{name}: modelDescription.xml: {attribute}", text)] if text else []
        times = []
        for place, text in given:
            time = finite_number(text)
            if time is None:
                self._refuse(f"{place} = {text!r}", "a finite number")
            times.append(time)
        return times
