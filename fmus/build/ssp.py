"""Writes the coupled system as one SSP 1.0 file, with its FMUs and connections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from ..atomic import replacing
from ..inside.base import TICK
from ..interface.sensors import SEEN, SENSORS, measurement_of
from ..interface.tables import COMMANDS, CONNECTIONS, INTERFACES, Connection
from ..interface.trajectory import TRAJECTORY
from ..interface.variables import Interface, Scalar, Value
from .description import AUTHOR, BASE_UNITS, COPYRIGHT, LICENSE, STOP_TIME, literal, render
from .native import archive

_SSP: Final = "http://ssp-standard.org/SSP1/SystemStructure"
PREFIXES: Final = {
    "ssd": f"{_SSP}Description",
    "ssc": f"{_SSP}Common",
    "ssv": f"{_SSP}ParameterValues",
    "ssm": f"{_SSP}ParameterMapping",
    # Some importers read the master's step size from annotations of these names.
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
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
    tables = {"sensors": SENSORS, **TABLES} if sensors else TABLES
    wires = panda_connections(sensors=sensors)
    values = parameters or {}
    members = {
        STRUCTURE_FILE: structure_description(tables, wires, values, stop_time),
        CONNECTORS_FILE: structure_description(tables, wires, values, stop_time, SYSTEM_OUTPUTS),
    }
    for name, table in tables.items():
        members[f"resources/{table.model}.fmu"] = fmus[name].read_bytes()
    content = archive(members)
    with replacing(path) as partial:  # whoever is killed meanwhile leaves the old file
        partial.write_bytes(content)
    return path


def structure_description(
    tables: Mapping[str, Interface],
    connections: Sequence[Connection],
    parameters: Mapping[str, Mapping[str, Value]],
    stop_time: float,
    outputs: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> bytes:
    """Make an .ssd file; `outputs` are those of the whole system, by component."""
    scalars = [(name, scalar) for name, table in tables.items() for scalar in table.scalars()]
    # Connected or given; other inputs get no connector, since FMPy feeds an unconnected one from
    # the connector before it. Some importers accept no other type of connector than Real.
    used = {c.target for c in connections}
    used |= {(name, parameter) for name, values in parameters.items() for parameter in values}
    connectors: dict[str, list[Scalar]] = {name: [] for name in tables}
    for name, scalar in scalars:
        is_used = scalar.variable.causality == "output" or (name, scalar.name) in used
        if scalar.variable.kind == "Real" and is_used:
            connectors[name].append(scalar)
    start_values: dict[str, list[Any]] = {name: [] for name in tables}
    for name, values in parameters.items():
        by_name = {scalar.name: scalar for scalar in tables[name].scalars()}
        start_values[name] = [_parameter(by_name[each], value) for each, value in values.items()]
    return render(
        "system.ssd.j2",
        {},
        prefixes=PREFIXES,
        author=AUTHOR,
        copyright=COPYRIGHT,
        license=LICENSE,
        tables=tables,
        connectors=connectors,
        parameters=start_values,
        connections=connections,
        outputs=[(n, s) for n, s in scalars if s.variable.name in outputs.get(n, ())],
        step_size=TICK,
        units={unit: BASE_UNITS[unit] for unit in sorted({s.unit for _, s in scalars if s.unit})},
        stop_time=stop_time,
    )


def _parameter(scalar: Scalar, value: Value) -> tuple[str, str, dict[str, str | None]]:
    """Name, type and value; an enumeration's as a number, which more importers support."""
    kind, text = str(scalar.variable.kind), literal(value)
    if kind == "Enumeration":
        kind, text = "Integer", str(scalar.variable.number_of(str(value)))
    return scalar.name, kind, {"value": text, "unit": scalar.unit or None}
