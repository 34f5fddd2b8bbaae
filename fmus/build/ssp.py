"""Writes a coupled system as one SSP file, with connections and parameters.

FMUs of FMI 2.0 make an SSP 1.0. With one of FMI 3.0 it is an SSP 2.0, whose connectors are arrays.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from ...assets import STEP_SIZE
from ..interface.tables import Connection
from ..interface.units import PLAIN, Units
from ..interface.variables import Scalar, Value, Variable, by_array
from .description import ABOUT, literal, render
from .native import archive

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
PREFIXES: Final[dict[str, str]] = _TABLES["prefixes"]
STEP_SIZES: Final[Mapping[str, str]] = _TABLES["step_sizes"]
SYSTEM_OUTPUTS: Final[Mapping[str, Sequence[str]]] = _TABLES["system_outputs"]
STRUCTURE_FILE: Final = "SystemStructure.ssd"
# The same system with outputs of its own. It is a second file, which SSP allows, because libcosim
# and Ecos fail on connections to the system itself. FMU containers look for these connections
# anywhere in the first file, so it holds them in an annotation, which the others pass over.
CONNECTORS_FILE: Final = "SystemConnectors.ssd"
Name = tuple[str, str]  # component and scalar variable
Linked = tuple[dict[str, str | None], tuple[float, float] | None]  # attributes, transformation


@dataclass(frozen=True)
class Component:
    """An FMU of a system that is written."""

    file: Path
    file_name: str  # in the archive
    fmi: int  # major version of FMI
    variables: Mapping[str, Scalar]  # of its description, by the names in connections
    units: Units
    start_values: Mapping[str, Value] = field(default_factory=dict)  # that are not its own
    steps: int = 1  # of the system in one of its own


@dataclass(frozen=True)
class WrittenSystem:
    """A system that is written as one file: an SSP (`write_ssp`) or an FMU (`write_container`).

    `written_system` (`src/panda_cosim/run/written.py`) makes it from a scenario. To run a system,
    its FMUs are opened as they are (`master/system.py`).
    """

    components: Mapping[str, Component]  # in the order of stepping
    connections: Sequence[Connection]
    stop_time: float  # [s]
    step_size: float = STEP_SIZE  # [s]
    coupling: str = "gauss-seidel"

    def scalar(self, name: Name) -> Scalar:
        """Return a variable of a component."""
        return self.components[name[0]].variables[name[1]]

    def outputs(self) -> dict[str, tuple[str, Variable]]:
        """Outputs of the whole system by their names, with their components."""
        rows = [
            (component, scalar.name.partition("[")[0], scalar.variable)
            for component, each in self.components.items()
            for scalar in each.variables.values()
            if scalar.variable.causality == "output" and scalar.variable.kind == "Real"
        ]
        of_panda = {v.name: (c, v) for c, name, v in rows if name in SYSTEM_OUTPUTS.get(c, ())}
        return of_panda or {f"{c}.{v.name}": (c, v) for c, _, v in rows}


def write_ssp(path: Path, system: WrittenSystem) -> Path:
    """Write a system as an .ssp file."""
    members = {
        STRUCTURE_FILE: structure_description(system),
        CONNECTORS_FILE: structure_description(system, has_connectors=True),
    }
    for name, component in system.components.items():
        members[f"resources/{component.file_name}"] = component.file.read_bytes()
        if component.start_values:
            members[f"resources/{name}.ssv"] = parameter_set(name, component)
    path.write_bytes(archive(members))
    return path


def structure_description(system: WrittenSystem, *, has_connectors: bool = False) -> bytes:
    """Make an .ssd file, with connectors of the whole system if asked for."""
    return _render(
        "system.ssd.j2",
        system.components.values(),
        system=system,
        connectors={name: _connectors(system, name) for name in system.components},
        connections=list(_connections(system)),
        outputs=system.outputs(),
        has_connectors=has_connectors,
    )


def parameter_set(name: str, component: Component) -> bytes:
    """Make an .ssv file with the start values of an FMU."""
    parameters = _parameters(component)
    return _render("parameters.ssv.j2", [component], component=name, parameters=parameters)


def _render(template: str, components: Collection[Component], **context: Any) -> bytes:
    units = {name: unit for each in components for name, unit in each.units.items()}
    return render(
        template,
        prefixes=PREFIXES,
        about=ABOUT,
        version="2.0" if any(each.fmi == 3 for each in components) else "1.0",
        units=dict(sorted(units.items())),
        **context,
    )


def _connectors(system: WrittenSystem, name: str) -> list[Variable]:
    """Variables that are connected, outputs, and parameters that are given."""
    # Others get no connector, since FMPy feeds an unconnected one from the connector before it.
    component = system.components[name]
    used = {end for c in system.connections for end in (c.source, c.target)}
    rows: dict[str, Variable] = {}
    for key, scalar in component.variables.items():
        variable = scalar.variable
        is_given = variable.causality == "parameter" and key in component.start_values
        if variable.causality == "output" or is_given or (name, key) in used:
            rows[variable.name] = variable
    return [*rows.values()]


def _connections(system: WrittenSystem) -> Iterator[Linked]:
    """Yield attributes and transformation; an array whose elements are fed in order is one."""
    for (attributes, linear), group in groupby(system.connections, partial(_of_arrays, system)):
        pairs = [(system.scalar(c.source), system.scalar(c.target)) for c in group]
        one, other = (scalar.variable for scalar in pairs[0])
        in_order = [(i, i) for i in range(one.size)] == [(a.element, b.element) for a, b in pairs]
        if in_order and one.shape == other.shape:
            yield attributes, linear
            continue
        for a, b in pairs:
            yield attributes | {"startIndices": _indices(a), "endIndices": _indices(b)}, linear


def _of_arrays(system: WrittenSystem, connection: Connection) -> Linked:
    """Return a connection's attributes and transformation, without indices of elements."""
    source, target = connection.source, connection.target
    attributes = {
        "startElement": source[0], "startConnector": system.scalar(source).variable.name,
        "startIndices": None,
        "endElement": target[0], "endConnector": system.scalar(target).variable.name,
        "endIndices": None,
        "suppressUnitConversion": None if connection.converts_units else "true",
    }  # fmt: skip
    linear = (connection.factor, connection.offset)
    is_plain = linear == PLAIN and not connection.converts_types
    return attributes, None if is_plain else linear


def _indices(scalar: Scalar) -> str | None:
    """Indices of an element as SSP 2.0 writes them."""
    element = scalar.variable.names()[scalar.element].removeprefix(scalar.variable.name)
    return element.strip("[]").replace(",", " ") or None


def _parameters(component: Component) -> Iterator[tuple[Variable, str, str]]:
    """Yield variable, type and values; enumerations as numbers, which more importers support."""
    given = component.start_values
    for scalars in by_array(component.variables.values()).values():
        if not given.keys().isdisjoint(scalar.name for scalar in scalars):
            variable = scalars[0].variable
            values = [literal(s, given.get(s.name, s.start_value())) for s in scalars]
            kind = "Integer" if variable.kind == "Enumeration" else variable.fmi_type
            yield variable, kind, " ".join(values)
