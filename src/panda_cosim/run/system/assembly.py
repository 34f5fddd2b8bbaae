"""Connects the FMUs of a scenario: by name and shape, and as [connect] says."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final, cast

import numpy as np

from ...fmus.errors import InputError, located
from ...fmus.interface.parameters import ParameterValue, expand
from ...fmus.interface.plant import FORCES
from ...fmus.interface.sensors import INERTIA, MEASURED, SEEN
from ...fmus.interface.tables import INTERFACES, Connection
from ...fmus.interface.types import OBJECTS, column_type, in_row, type_of
from ...fmus.interface.variables import Interface, Scalar, Value
from ...fmus.master.fmu_file import described_interface, read_fmu
from ...fmus.master.order import late, shown, stepping_order
from ...fmus.master.step import ITERATIONS
from ...fmus.master.wiring import Array, Name, System
from ...fmus.sources.targets import Kind
from ...result.recording import Column
from ...task.fields import check_keys
from ...task.scenario import SCENARIO_FILE, Coupling, Scenario
from ...task.values import Values
from .connector import RARE, Connector, check_unfed
from .driven import DrivenInput, driven_inputs
from .parts import Part, end_of, measures_a_panda, read_parts

# Beginnings of messages about keys of the scenario's file.
_OF_FILE: Final = ("[", "order: ", "not_finite: ", "left_out: ")


@dataclass(frozen=True)
class Assembly:
    """A coupled system, as a scenario describes it: which FMUs, connected how, recorded how.

    `assemble` makes it from a scenario, without building FMUs or running code of theirs; only
    `system` builds them. It has no start values of the scenario and no commands: `prepare` adds
    these. To open an .ssp file without a scenario, `system_from_ssp` is enough.
    """

    interfaces: Mapping[str, Interface]  # of each FMU, in the order of stepping
    parts: Sequence[Part]  # where the FMUs come from
    connections: Sequence[Connection]
    external: Sequence[Name]  # inputs that are given at each tick
    driven: Mapping[Name, DrivenInput]  # among the external ones
    notes: Sequence[str]  # unconnected inputs, or what has no effect in an .ssp file
    asked: frozenset[str]  # signals of criteria, recorded in any case
    steps: Mapping[str, int]  # of FMUs, in the system's
    not_finite: Sequence[Name] = ()  # outputs that may be NaN or infinite
    left_out: Sequence[Name] = ()  # outputs that are not read
    # Of an .ssp file: the system in it, its start values and start time [s].
    ssp: System | None = None
    start: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    start_time: float = 0.0

    @cached_property
    def system(self) -> System:
        """The system with its FMU files; what has to be built is built."""
        return System(
            {part.name: part.make() for part in self.parts},
            self.connections,
            self.external,
            self.outputs,
            steps=self.steps,
            not_finite=self.not_finite,
            labels=self.ssp.labels if self.ssp else {},
        )

    @cached_property
    def outputs(self) -> Mapping[str, Sequence[str]]:
        """Recorded outputs, the plant's first; those of an .ssp file, connected ones first."""
        known = self.ssp.outputs if self.ssp else self._own_outputs
        return {i: [n for n in names if (i, n) not in self.left_out] for i, names in known.items()}

    @property
    def _own_outputs(self) -> dict[str, list[str]]:
        fed = {connection.source for connection in self.connections}
        return {
            name: [
                scalar
                for variable in self.interfaces[name].of("output")
                if not variable.on_request
                or f"{name}.{variable.name}" in self.asked
                or (name, variable.names()[0]) in fed
                for scalar in variable.names()
            ]
            for name in sorted(self.interfaces, key=lambda name: name != "plant")
        }

    def late(self, coupling: str) -> list[str]:
        """Connections whose target gets values of the step before."""
        return late([*self.interfaces], self.connections, coupling)

    def course(self, coupling: str) -> str:
        """Say in which order FMUs are stepped, and what is late."""
        return shown([*self.interfaces], self.late(coupling))

    def recorded(self, coupling: str = "") -> list[Column]:
        """Columns of a recording, whose names must differ."""
        iterations = Column(".".join(ITERATIONS), "1", "Iterations of the step before")
        return [*self._columns, *([iterations] if coupling == "iterated" else [])]

    @cached_property
    def _columns(self) -> list[Column]:
        columns = [Column("time", "s", "Time since the start")]
        sources: dict[str, Name] = {}
        names = [*self.external, *((i, n) for i, names in self.outputs.items() for n in names)]
        for name in names:
            scalar, column = self.scalars[name], ".".join(name)
            other = sources.setdefault(column, name)
            if other != name:
                raise InputError(
                    f"FMUs {other[0]!r} and {name[0]!r}: {other[1]!r} and {name[1]!r} would both "
                    f"be column {column} of the recording; rename one of the FMUs"
                )
            kind, nominal = column_type(scalar.variable), scalar.variable.nominal
            columns.append(Column(column, scalar.unit, scalar.description, kind, nominal))
        return columns

    @cached_property
    def scalars(self) -> dict[Name, Scalar]:
        """All scalar variables by FMU and name."""
        return {(n, s.name): s for n, i in self.interfaces.items() for s in i.scalars()}

    def inputs_at_start(self, values: Mapping[str, Mapping[str, Value]]) -> Array:
        """Start value of each external input, as rows hold it."""
        scalars = [self.scalars[name] for name in self.external]
        is_number = all(type_of(scalar.variable) not in OBJECTS for scalar in scalars)
        content = [in_row(s, values.get(i, {}).get(n))
                   for s, (i, n) in zip(scalars, self.external, strict=True)]  # fmt: skip
        return np.array(content, np.float64 if is_number else object)

    def is_ours(self, name: str) -> bool:
        """Whether plant or controller is the project's own, by its model and parameters."""
        own, given = INTERFACES[name], self.interfaces[name]
        names = ({v.name for v in interface.of("parameter")} for interface in (own, given))
        return given.model == own.model and next(names) <= next(names)

    def changed(
        self,
        values: Mapping[str, Mapping[str, Value]],
        stated: Mapping[str, Mapping[str, ParameterValue]],
    ) -> dict[str, dict[str, Value]]:
        """Return the start values that FMUs are given; of others' what is stated, or not theirs."""
        ours = {part.name for part in self.parts if part.file is None}
        return {
            i: dict(named) if i in ours else self._changed(i, named, stated.get(i, {}))
            for i, named in values.items()
        }

    def _changed(
        self, name: str, values: Mapping[str, Value], stated: Mapping[str, ParameterValue]
    ) -> dict[str, Value]:
        interface = self.interfaces[name]
        own = {scalar.name: scalar.start for scalar in interface.scalars()}
        given = {*expand(name, interface, stated), *self.start.get(name, {})}
        return {n: v for n, v in values.items() if n in given or own.get(n) != v}

    def start_values(
        self, layers: Sequence[Mapping[str, Mapping[str, ParameterValue]]]
    ) -> dict[str, dict[str, Value]]:
        """Parameters of all FMUs: their own values, then those of each layer."""
        stated = [name for layer in layers for name in layer if layer[name]]
        check_keys("", stated, self.interfaces, "FMU")
        values: dict[str, dict[str, Value]] = {}
        for name, interface in self.interfaces.items():
            parameters = [s for s in interface.scalars() if s.variable.causality == "parameter"]
            values[name] = {s.name: s.start for s in parameters if s.start is not None}
            values[name] |= self.start.get(name, {})
            for layer in layers:
                values[name] |= expand(name, interface, layer.get(name, {}))
        return values


def assemble(
    scenario: Scenario,
    kind: Kind = "auto",
    *,
    files: Mapping[str, Path] | None = None,
    run_code: bool = True,
    from_outside: bool = False,
) -> Assembly:
    """Read and connect the parts of a scenario; only PythonFMU slaves are built."""
    # `files` are used instead of our own FMUs. `run_code`: slaves may be run to find their
    # variables. `from_outside`: all inputs that nothing feeds become external, as in a session.
    if scenario.system:
        return _of_ssp(scenario, from_outside=from_outside)
    try:
        parts = read_parts(scenario, kind, files or {}, run_code=run_code)
        return _connected(scenario, parts, from_outside=from_outside)
    except InputError as error:
        is_given = any(map(os.path.isabs, scenario.fmus.values()))  # as an option
        if is_given or not (scenario.folder and str(error).startswith(_OF_FILE)):
            raise
        raise type(error)(f"{scenario.folder}/{SCENARIO_FILE}: {error}") from None


def with_parameter_set(
    scenario: Scenario, ssv: Path | str | None, values: Values, kind: Kind = "auto", *,
    run_code: bool = True,
) -> Scenario:  # fmt: skip
    """Return a scenario with values by key, which go before those of an .ssv file, if any."""
    changed = scenario.changed(values)
    if ssv is None:
        return changed
    from ...fmus.master.ssp_parameters import read_parameters  # noqa: PLC0415 - rarely needed

    found = read_parameters(Path(ssv), assemble(changed, kind, run_code=run_code).interfaces)
    return changed.changed(found).changed(values)


def _connected(scenario: Scenario, parts: Sequence[Part], *, from_outside: bool) -> Assembly:
    """Connect parts: as the scenario says, from outside, then by name."""
    connector = Connector(parts)
    for target, source in scenario.connect.items():
        connector.connect(target, source)
    if scenario.is_torque_driven:
        connector.connect_torques()
    if scenario.mismatch.values and not measures_a_panda(connector.parts["plant"].interface):
        raise InputError("mismatch: only valid with the project's plant, or one that extends it")
    external = [] if scenario.is_system else _external(scenario, connector, from_outside)
    interfaces = {part.name: part.interface for part in parts}
    driven = driven_inputs(scenario, interfaces)
    connector.drive(driven)
    if scenario.mismatch.has_sensors:
        connector.connect_sensors(_measurements(scenario))
    connector.connect_rest_by_name()
    if not scenario.is_system:
        connector.require_ctrl()
    connections = [_scaled(each, scenario.input_scale) for each in connector.connections]
    order = scenario.order or stepping_order(interfaces, connections)
    notes = [] if from_outside else connector.notes
    made = Assembly(interfaces, parts, connections, external, driven, notes, scenario.asked,
                    scenario.steps)  # fmt: skip
    return _ordered(scenario, made, order, from_outside=from_outside)


def _measurements(scenario: Scenario) -> list[str]:
    """The controller's inputs that sensors measure."""
    is_modelled = scenario.mismatch.values.get("hand_pose_source") == "model"
    return [*MEASURED, *SEEN, *([INERTIA] if is_modelled else [])]


def _scaled(each: Connection, scale: float) -> Connection:
    if each.target[0] != "plant":
        return each
    return replace(each, factor=scale * each.factor, offset=scale * each.offset)


def _ordered(
    scenario: Scenario, made: Assembly, order: Sequence[str], *, from_outside: bool
) -> Assembly:
    """Return the FMUs in the order of stepping, which no order of lines changes."""
    check_keys("[parameters] ", scenario.parameters, made.interfaces, "FMU")
    check_keys("[steps] ", scenario.steps, made.interfaces, "FMU")
    if sorted(order) != sorted(made.interfaces):
        valid = ", ".join(sorted(made.interfaces))
        raise InputError(f"order: value {[*order]!r}; must name each FMU once: {valid}")
    interfaces = {name: made.interfaces[name] for name in order}
    names = ((name, s.name) for name, each in interfaces.items() for s in each.scalars())
    places = {name: place for place, name in enumerate(names)}
    external = [*made.external, *sorted(made.driven, key=places.__getitem__)]
    parts = {part.name: part for part in made.parts}
    left_out = _outputs("left_out: ", scenario.left_out, parts)
    for each in made.connections:
        if each.source in left_out:
            raise InputError(f"left_out: {'.'.join(each.source)}: feeds {'.'.join(each.target)}; "
                             "must be an output that feeds nothing")  # fmt: skip
    unfed = _unfed(interfaces, made.connections, external) if from_outside else []
    return replace(
        made,
        interfaces=interfaces,
        parts=[parts[name] for name in order],
        connections=sorted(made.connections, key=lambda each: places[each.target]),
        external=[*unfed, *external],
        not_finite=_outputs("not_finite: ", scenario.not_finite, parts),
        left_out=left_out,
    )


def _outputs(place: str, texts: Sequence[str], parts: Mapping[str, Part]) -> list[Name]:
    """Outputs that a key of a scenario names, as FMU.NAME, one by one."""
    ends = [end_of(place, text, parts, "output") for text in texts]
    return [(instance, name) for instance, end in ends for name in end.names()]


def _unfed(
    interfaces: Mapping[str, Interface], connections: Sequence[Connection], external: Sequence[Name]
) -> list[Name]:
    """Inputs that nothing feeds, but for those of ours that act only in other scenarios."""
    without = {connection.target for connection in connections} | {*external}
    return [
        (instance, name)
        for instance, interface in interfaces.items()
        for variable in interface.of("input")
        if not (interface is INTERFACES.get(instance) and variable.name in RARE)
        for name in variable.names()
        if (instance, name) not in without
    ]


def _external(scenario: Scenario, connector: Connector, from_outside: bool) -> list[Name]:
    """The pushes, in a session those on all bodies, and the commands that the controller takes."""
    inputs = [("plant", FORCES[body]) for body in (FORCES if from_outside else scenario.pushed)]
    inputs += [("controller", command) for command in scenario.commands]
    external: list[Name] = []
    for instance, name in inputs:
        variable = connector.parts[instance].interface.end(name, "input")
        if variable is None and name in map(FORCES.get, scenario.pushed):
            raise InputError(f"[[push]]: {instance} has no input {name}")
        if variable is not None and not connector.is_fed(instance, name):
            ours = INTERFACES[instance].variable(name)
            connector.check(f"the scenario's {name}", ours, f"{instance}.{name}", variable)
            names = [(instance, n) for n in variable.names()]
            connector.drive(names)
            external += names
    return external


# A coupled system from an .ssp file.


def _of_ssp(scenario: Scenario, *, from_outside: bool) -> Assembly:
    from ...fmus.master.ssp_reader import system_from_ssp  # noqa: PLC0415 - few scenarios need it

    coupled = system_from_ssp((scenario.folder or Path()) / scenario.system)
    system, parts = coupled.system, []
    for name, file in system.fmus.items():
        fmu = read_fmu(file).restructured(coupled.start_values.get(name, {}))
        parts.append(Part(name, file, described_interface(fmu), built=file))
    interfaces = {part.name: part.interface for part in parts}
    driven = driven_inputs(scenario, interfaces)
    check_unfed(driven, {connection.target for connection in system.connections})
    made = Assembly(interfaces, parts, system.connections, [], driven, coupled.warnings,
                    scenario.asked, scenario.steps, ssp=system, start=coupled.start_values,
                    start_time=coupled.start_time)  # fmt: skip
    return _ordered(scenario, made, scenario.order or [*system.fmus], from_outside=from_outside)


def system_scenario(path: Path, duration: float | None = None) -> Scenario:
    """Return the scenario that runs an .ssp file's system as it says, without a verdict."""
    from ...fmus.master.ssp_reader import system_from_ssp  # noqa: PLC0415 - few scenarios need it

    coupled = system_from_ssp(path)
    if duration is None:
        duration = coupled.stop_time - coupled.start_time
    name = "".join(c if c.isprintable() else "_" for c in coupled.name) or "system"
    with located(path):
        return Scenario(
            name=name[:80],
            table=None,
            duration=duration,
            step=coupled.step_size,
            coupling=cast("Coupling", coupled.coupling),
            steps=coupled.system.steps,
            system=path.name,
            folder=path.parent.resolve(),
        )
