"""Writes the coupled system as one SSP 1.0 file, with its FMUs and connections."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from ..atomic import replacing
from ..errors import InputError
from ..interface.sensors import SEEN, SENSORS, measurement_of
from ..interface.tables import COMMANDS, CONNECTIONS, INTERFACES, Connection
from ..interface.trajectory import TRAJECTORY
from ..interface.variables import Interface, Scalar, Value
from ..inside.base import TICK
from .description import AUTHOR, BASE_UNITS, COPYRIGHT, LICENSE, STOP_TIME, literal
from .native import archive

SSD: Final = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC: Final = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV: Final = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
# Some importers read the master's step size from annotations of these names.
OMS: Final = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
OSP: Final = "http://opensimulationplatform.com/SSP/OSPAnnotations"
PREFIXES: Final = {"ssd": SSD, "ssc": SSC, "ssv": SSV, "oms": OMS, "osp": OSP}
STRUCTURE_FILE: Final = "SystemStructure.ssd"
# The same system with outputs of its own, for tools that use it as one block. It is a second
# file, which SSP allows, because some importers reject connections to the system itself.
CONNECTORS_FILE: Final = "SystemConnectors.ssd"
# In the order of stepping: the controller leads, see `fmus.master.step`.
TABLES: Final = {**{k: INTERFACES[k] for k in ("controller", "plant")}, "trajectory": TRAJECTORY}

# Outputs of the whole system: pose of the hand, centre of the block's top, servo targets.
SYSTEM_OUTPUTS: Final = {
    "plant": ("hand_xpos", "hand_xquat", "target_xpos", "target_xmat"),
    "controller": ("ctrl",),
}


@dataclass(frozen=True)
class Structure:
    """Content of a system structure description."""

    name: str = "Panda"  # of the system
    # Interface of each component, in the order of stepping.
    tables: Mapping[str, Interface] = field(default_factory=lambda: TABLES)
    connections: Sequence[Connection] = ()  # which output feeds which input
    # Values of parameters, by component and scalar variable.
    parameters: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    stop_time: float = STOP_TIME  # of the default experiment [s]
    step_size: float = TICK  # communication step [s]


def panda_connections(*, sensors: bool = False) -> tuple[Connection, ...]:
    """Connections of the whole Panda; with sensors, these are between plant and controller."""
    commands = [n for name in COMMANDS for n in TRAJECTORY.variable(name).names()]
    return (
        *(sensor_connections() if sensors else CONNECTIONS),
        *(Connection(("trajectory", name), ("controller", name)) for name in commands),
    )


def sensor_connections() -> Iterator[Connection]:
    """Connections of plant and controller by way of PandaSensors, which also sees the block."""
    for connection in CONNECTIONS:
        if connection.target[0] == "controller":
            signal, bracket, index = connection.target[1].partition("[")
            yield Connection(connection.source, ("sensors", connection.target[1]))
            measured = f"{measurement_of(signal)}{bracket}{index}"
            yield Connection(("sensors", measured), connection.target)
        else:
            yield connection
    for name in (n for signal in SEEN for n in SENSORS.variable(signal).names()):
        yield Connection(("plant", name), ("sensors", name))


def write_panda_ssp(
    path: Path,
    fmus: Mapping[str, Path],
    parameters: Mapping[str, Mapping[str, Value]] | None = None,
    stop_time: float = STOP_TIME,
) -> Path:
    """Write the file `Panda.ssp`."""
    sensors = "sensors" in fmus
    structure = Structure(
        tables={"sensors": SENSORS, **TABLES} if sensors else TABLES,
        connections=panda_connections(sensors=sensors),
        parameters=parameters or {},
        stop_time=stop_time,
    )
    members = {
        STRUCTURE_FILE: structure_description(structure),
        CONNECTORS_FILE: structure_description(structure, connectors=True),
    }
    for name, table in structure.tables.items():
        try:
            members[f"resources/{table.model}.fmu"] = fmus[name].read_bytes()
        except OSError as error:
            raise InputError(f"{fmus[name]}: cannot be read: {error.strerror}") from error
    content = archive(members)
    with replacing(path) as partial:  # whoever is killed meanwhile leaves the old file
        partial.write_bytes(content)
    return path


def structure_description(structure: Structure, *, connectors: bool = False) -> bytes:
    """Make an .ssd file; with connectors, the system has outputs of its own."""
    root = ET.Element(
        "ssd:SystemStructureDescription",
        {f"xmlns:{prefix}": uri for prefix, uri in PREFIXES.items()},
        version="1.0",
        name=structure.name,
        author=AUTHOR,
        copyright=COPYRIGHT,
        license=LICENSE,
        generationTool="panda-cosim",
    )
    system = ET.SubElement(root, "ssd:System", name=structure.name)
    shown = [(i, s) for i, t in structure.tables.items() for s in t.scalars() if _shown(i, s)]
    if connectors:
        listed = ET.SubElement(system, "ssd:Connectors")
        for _, scalar in shown:
            _connector(listed, scalar)
    elements = ET.SubElement(system, "ssd:Elements")
    fed = {connection.target for connection in structure.connections}
    for name, table in structure.tables.items():
        inputs = {variable for instance, variable in fed if instance == name}
        _component(elements, name, table, inputs, structure.parameters.get(name, {}))
    connections = ET.SubElement(system, "ssd:Connections")
    for connection in structure.connections:
        (start, output), (end, input_) = connection.source, connection.target
        ET.SubElement(
            connections,
            "ssd:Connection",
            startElement=start,
            startConnector=output,
            endElement=end,
            endConnector=input_,
        )
    for component, scalar in shown if connectors else ():  # without endElement: the system itself
        ET.SubElement(
            connections,
            "ssd:Connection",
            startElement=component,
            startConnector=scalar.name,
            endConnector=scalar.name,
        )
    step = repr(structure.step_size)
    master = _annotation(system, "org.openmodelica", "oms:Annotations", "oms:SimulationInformation")
    ET.SubElement(
        master,
        "oms:FixedStepMaster",
        description="oms-ma",
        stepSize=step,
        absoluteTolerance="1e-4",
        relativeTolerance="1e-4",
    )
    _units(root, structure.tables.values())
    experiment = ET.SubElement(
        root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(structure.stop_time)
    )
    algorithm = _annotation(experiment, "com.opensimulationplatform", "osp:Algorithm")
    ET.SubElement(algorithm, "osp:FixedStepAlgorithm", baseStepSize=step)
    ET.indent(root)
    xml: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return xml + b"\n"


def _shown(component: str, scalar: Scalar) -> bool:
    """Whether an output is also one of the whole system, for tools that use it as one block."""
    return scalar.variable.causality == "output" and scalar.variable.name in SYSTEM_OUTPUTS.get(
        component, ()
    )


def _component(
    elements: ET.Element,
    name: str,
    table: Interface,
    inputs: Collection[str],
    parameters: Mapping[str, Value],
) -> None:
    """Add a component, with connectors for its outputs and its connected or given inputs.

    Other inputs get none, since FMPy feeds an unconnected input from the connector before it.
    """
    component = ET.SubElement(
        elements,
        "ssd:Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{table.model}.fmu",
    )
    connectors = ET.SubElement(component, "ssd:Connectors")
    scalars = {s.name: s for s in table.scalars()}
    for scalar in scalars.values():
        if scalar.variable.kind != "Real":
            continue  # some importers accept no other type of connector
        if scalar.variable.causality == "output" or scalar.name in {*inputs, *parameters}:
            _connector(connectors, scalar)
    if parameters:
        bindings = ET.SubElement(component, "ssd:ParameterBindings")
        binding = ET.SubElement(bindings, "ssd:ParameterBinding")
        values = ET.SubElement(binding, "ssd:ParameterValues")
        parameter_set = ET.SubElement(values, "ssv:ParameterSet", version="1.0", name=name)
        listed = ET.SubElement(parameter_set, "ssv:Parameters")
        for parameter, value in parameters.items():
            _parameter(ET.SubElement(listed, "ssv:Parameter", name=parameter),
                       scalars[parameter], value)  # fmt: skip


def _parameter(parent: ET.Element, scalar: Scalar, value: Value) -> None:
    """Add a typed value; an enumeration's as a number, which more importers support than names."""
    kind, attributes = str(scalar.variable.kind), {"value": literal(value)}
    if kind == "Enumeration":
        kind = "Integer"
        attributes = {"value": str(scalar.variable.choices.index(str(value)) + 1)}
    if scalar.unit:
        attributes["unit"] = scalar.unit
    ET.SubElement(parent, f"ssv:{kind}", attributes)


def _connector(connectors: ET.Element, scalar: Scalar) -> None:
    connector = ET.SubElement(
        connectors,
        "ssd:Connector",
        name=scalar.name,
        kind=scalar.variable.causality,
        description=scalar.variable.description,
    )
    ET.SubElement(connector, "ssc:Real", unit=scalar.unit)


def _annotation(parent: ET.Element, kind: str, *path: str) -> ET.Element:
    """Add an annotation with nested elements; return the innermost."""
    element = ET.SubElement(parent, "ssd:Annotations")
    element = ET.SubElement(element, "ssc:Annotation", type=kind)
    for tag in path:
        element = ET.SubElement(element, tag)
    return element


def _units(root: ET.Element, tables: Iterable[Interface]) -> None:
    units = ET.SubElement(root, "ssd:Units")
    used = {s.unit for table in tables for s in table.scalars() if s.unit}
    for name in sorted(used):
        ET.SubElement(ET.SubElement(units, "ssc:Unit", name=name), "ssc:BaseUnit", BASE_UNITS[name])
