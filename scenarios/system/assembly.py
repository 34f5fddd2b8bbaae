"""Connects the FMUs of a scenario: by name and shape, and as [connect] says."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final

from ...fmus.errors import InputError
from ...fmus.files.fmu_file import described_interface, read_fmu
from ...fmus.interface.parameters import ParameterValue, expand
from ...fmus.interface.plant import FORCES
from ...fmus.interface.sensors import MEASURED, SEEN, measurement_of
from ...fmus.interface.tables import COMMANDS, INTERFACES, Connection
from ...fmus.interface.variables import Interface, Scalar, Value, Variable
from ...fmus.master.system import System
from ...fmus.master.wiring import Name
from ...fmus.messages import did_you_mean
from ...fmus.sources.targets import Kind
from ..scenario.scenario import SCENARIO_FILE, Scenario
from .connector import Connector
from .parts import Part, read_parts

NUMBERS: Final = ("Real", "Boolean", "Enumeration")  # what a recording can hold


@dataclass(frozen=True)
class Assembly:
    """A coupled system, as a scenario describes it.

    Attributes:
        interfaces: Of each FMU, in the order of stepping.
        parts: Where they come from; empty for an .ssp file.
        connections: Which output feeds which input.
        external: Inputs that the scenario gives at each tick.
        notes: Unconnected inputs.
        start: Start values from an .ssp file.
        ssp: The system of an .ssp file.
        start_time: Start time [s].
        asked: Signals of criteria; recorded even if they otherwise are not.
    """

    interfaces: Mapping[str, Interface]
    connections: Sequence[Connection]
    parts: Sequence[Part] = ()
    external: Sequence[Name] = ()
    notes: Sequence[str] = ()
    start: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    ssp: System | None = None
    start_time: float = 0.0
    asked: frozenset[str] = frozenset()

    @cached_property
    def system(self) -> System:
        """The system with its FMU files; what has to be built is built."""
        if self.ssp is not None:
            return self.ssp
        return System(
            {part.name: part.make() for part in self.parts},
            self.connections,
            self.external,
            self.outputs,
            refuses_non_finite=all(part.file is None for part in self.parts),
        )

    @property
    def outputs(self) -> dict[str, list[str]]:
        """Recorded outputs, the plant's first."""
        if self.ssp is not None:
            return {name: list(names) for name, names in self.ssp.outputs.items()}
        order = sorted(self.interfaces, key=lambda name: name != "plant")
        return {
            name: [n for v in self.interfaces[name].of("output") if self._is_recorded(name, v)
                   for n in v.names()]
            for name in order
        }  # fmt: skip

    def _is_recorded(self, name: str, variable: Variable) -> bool:
        if variable.kind not in NUMBERS:
            return False
        if not variable.on_request or f"{name}.{variable.name}" in self.asked:
            return True
        return any(
            connection.source == (name, variable.names()[0]) for connection in self.connections
        )

    def recorded(self) -> dict[str, tuple[str, str]]:
        """Unit and description of each column of a recording, by its name."""
        scalars = self._scalars()
        found = {"time": ("s", "Time since the start")}
        sources: dict[str, Name] = {}
        names = [*self.external, *((i, n) for i, names in self.outputs.items() for n in names)]
        for name in names:
            scalar, column = scalars.get(name), ".".join(name)
            if scalar is None:
                raise InputError(f"{column}: is not an output of its FMU, and cannot be recorded")
            other = sources.setdefault(column, name)
            if other != name:
                raise InputError(
                    f"FMUs {other[0]!r} and {name[0]!r}: {other[1]!r} and {name[1]!r} would both "
                    f"be column {column} of the recording; rename one of the FMUs"
                )
            found[column] = (scalar.unit, scalar.variable.description)
        return found

    def _scalars(self) -> dict[Name, Scalar]:
        return {(n, s.name): s for n, i in self.interfaces.items() for s in i.scalars()}

    def inputs_at_start(self, given: Mapping[str, Mapping[str, Value]]) -> dict[Name, float]:
        """Start value of each external input."""
        scalars = self._scalars()
        return {
            (instance, name): float(
                given.get(instance, {}).get(name, scalars[instance, name].start or 0.0)
            )
            for instance, name in self.external
        }

    def changed(self, values: Mapping[str, Mapping[str, Value]]) -> dict[str, dict[str, Value]]:
        """Return the start values that FMUs are given; of others' only those not their own."""
        own = {name: scalar.start for name, scalar in self._scalars().items()}
        ours = {part.name for part in self.parts if part.file is None}
        return {
            instance: {
                n: v for n, v in named.items() if instance in ours or own.get((instance, n)) != v
            }
            for instance, named in values.items()
        }

    def start_values(
        self, layers: Sequence[Mapping[str, Mapping[str, ParameterValue]]]
    ) -> dict[str, dict[str, Value]]:
        """Parameters of all FMUs, including defaults."""
        for layer in layers:
            for name in layer:
                if layer[name] and name not in self.interfaces:
                    valid = ", ".join(self.interfaces)
                    raise InputError(f"{name}: no FMU of this name; valid: {valid}")
        values: dict[str, dict[str, Value]] = {}
        for name, interface in self.interfaces.items():
            values[name] = {
                s.name: s.start
                for s in interface.scalars()
                if s.variable.causality == "parameter" and s.start is not None
            }
            values[name] |= self.start.get(name, {})
            for layer in layers:
                values[name] |= expand(name, interface, layer.get(name, {}))
        return values


def assemble(
    scenario: Scenario,
    kind: Kind = "native",
    *,
    files: Mapping[str, Path] | None = None,
    run_code: bool = True,
    from_outside: bool = False,
) -> Assembly:
    """Read and connect the parts of a scenario; only PythonFMU slaves are built.

    `files` are used instead of our own FMUs. `run_code`: slaves may be run to find their variables.
    `from_outside`: all inputs that nothing feeds become external, as in a session.
    """
    try:
        return _assembled(scenario, kind, files or {}, run_code, from_outside)
    except InputError as error:
        from_file = scenario.folder and not any(map(os.path.isabs, scenario.fmus.values()))
        if not (from_file and str(error).startswith("[")):
            raise
        raise type(error)(f"{scenario.folder}/{SCENARIO_FILE}: {error}") from None


def _assembled(
    scenario: Scenario, kind: Kind, files: Mapping[str, Path], run_code: bool, from_outside: bool
) -> Assembly:
    if scenario.system:
        return _of_ssp(scenario, from_outside=from_outside)
    parts = read_parts(scenario, kind, files, run_code=run_code)
    connector = Connector(parts)
    for target, source in scenario.connect.items():
        connector.connect(target, source)
    if scenario.is_torque_driven:
        connector.connect_torques()
    external = _external(scenario, parts, connector, interactive=from_outside)
    if scenario.mismatch.has_sensors:
        _feed_from_sensors(connector)
    for part in parts:
        for variable in part.interface.of("input"):
            connector.connect_by_name(part, variable)
    if not scenario.is_system and not connector.is_fed("plant", "ctrl"):
        raise InputError(connector.unfed_message("plant", "ctrl"))
    interfaces = {part.name: part.interface for part in parts}
    for name in scenario.parameters:
        if name not in interfaces:
            hint = f"valid: {', '.join(interfaces)}{did_you_mean(name, interfaces)}"
            raise InputError(f"[parameters.{name}]: no FMU of this name; {hint}")
    if from_outside:
        unused = [("plant", n) for n in INTERFACES["plant"].variable("torque").names()]
        without = unused if interfaces.get("plant") is INTERFACES["plant"] else ()
        unfed = _unfed(interfaces, connector.connections, external, without)
        return Assembly(interfaces, connector.connections, parts, unfed, asked=scenario.asked)
    return Assembly(
        interfaces, connector.connections, parts, external, connector.notes, asked=scenario.asked
    )


def _unfed(
    interfaces: Mapping[str, Interface],
    connections: Sequence[Connection],
    external: Sequence[Name],
    without: Collection[Name] = (),
) -> list[Name]:
    """External inputs of a session: those that nothing feeds, then the scenario's."""
    fed = {connection.target for connection in connections} | {*external, *without}
    inputs = [
        (instance, name)
        for instance, interface in interfaces.items()
        for variable in interface.of("input")
        if variable.kind == "Real" and variable.multiple_of is None
        for name in variable.names()
    ]
    return [name for name in inputs if name not in fed] + list(external)


def _of_ssp(scenario: Scenario, *, from_outside: bool = False) -> Assembly:
    path = (scenario.folder or Path()) / scenario.system
    from ...fmus.master.ssp_reader import system_from_ssp  # noqa: PLC0415 - few scenarios need it

    coupled = system_from_ssp(path)
    interfaces = {
        name: described_interface(read_fmu(file)) for name, file in coupled.system.fmus.items()
    }
    system = coupled.system
    if from_outside:
        system = replace(system, external=_unfed(interfaces, system.connections, ()))
    return Assembly(
        interfaces,
        system.connections,
        external=system.external,
        notes=coupled.warnings,
        start=coupled.start_values,
        ssp=system,
        start_time=coupled.start_time,
    )


def _external(
    scenario: Scenario, parts: Sequence[Part], connector: Connector, *, interactive: bool
) -> list[Name]:
    """The pushes, in a session those on all bodies, and the commands that the controller takes."""
    if scenario.is_system:
        return []
    bodies = FORCES if interactive else scenario.pushed
    names = [("plant", FORCES[body]) for body in bodies]
    names += [("controller", command) for command in COMMANDS]
    interfaces = {part.name: part.interface for part in parts}
    external: list[Name] = []
    for instance, name in names:
        taken = [v for v in interfaces[instance].of("input") if v.name == name]
        if not taken and name in map(FORCES.get, scenario.pushed):
            raise InputError(f"[[push]]: {instance} has no input {name}")
        for variable in taken:
            if connector.is_fed(instance, name):
                continue
            ours = INTERFACES[instance].variable(name)
            connector.check(f"the scenario's {name}", ours, f"{instance}.{name}", variable)
            external += [(instance, n) for n in variable.names()]
            connector.mark_fed(instance, variable)
    return external


def _feed_from_sensors(connector: Connector) -> None:
    """Feed the controller from the sensors, except where [connect] says otherwise."""
    taken = {v.name for v in connector.parts["controller"].interface.of("input")}
    for name in (*MEASURED, *SEEN):
        if name in taken and not connector.is_fed("controller", name):
            connector.connect(f"controller.{name}", f"sensors.{measurement_of(name)}")


def instances(scenario: Scenario) -> tuple[str, ...]:
    """Names of the FMUs of a scenario that it names."""
    if scenario.system:
        return tuple(_of_ssp(scenario).interfaces)
    return tuple(scenario.fmus)


def layers(
    scenario: Scenario, gains: Mapping[str, ParameterValue]
) -> list[Mapping[str, Mapping[str, ParameterValue]]]:
    """Start values that a scenario gives; scene and gains only where the FMU is our own."""
    own: dict[str, Mapping[str, ParameterValue]] = {}
    if not scenario.is_system:
        if "plant" not in scenario.fmus:
            own["plant"] = {"scene": scenario.scene}
        if "controller" not in scenario.fmus:
            own["controller"] = gains
    sections = {"plant": scenario.plant, "controller": scenario.controller}
    return [own, scenario.mismatch.start_values(), sections, scenario.parameters]
