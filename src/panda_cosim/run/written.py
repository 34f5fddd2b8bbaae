"""A scenario for other tools: FMUs, one of which plays its inputs, connections and parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from ..fmus.build.native import NativeFmu
from ..fmus.build.ssp import Component, WrittenSystem
from ..fmus.errors import InputError
from ..fmus.interface.tables import TRAJECTORY, Connection
from ..fmus.interface.types import type_of
from ..fmus.interface.variables import Interface, Variable
from ..fmus.master.fmu_file import read_fmu
from ..fmus.master.wiring import Array, Name
from ..fmus.sources.targets import Target, build_fmu, build_trajectory
from ..task.scenario import Scenario
from .options import Options
from .prepare import Prepared, prepare
from .system.parts import split

LAW: Final = (
    "Plays a table, one row per step from t = 0 on. After the last row its values are kept."
)


def written_system(scenario: Scenario, target: Target) -> WrittenSystem:
    """Build the FMUs of a scenario, and say how they are connected."""
    if scenario.system:
        what = f"system = {scenario.system!r} is an .ssp file already"
        raise InputError(f"scenario {scenario.name!r}: {what}; must be a scenario of FMUs")
    prepared = prepare(scenario, Options(kind=target.kind))
    makers = {part.name: part.make for part in prepared.assembly.parts}
    connections, player = [*prepared.assembly.connections], Player(prepared)
    if player.played:
        name = "trajectory"
        while name in makers:
            name += "_"
        makers[name] = player.make
        connections += player.connections(name)
    files = {name: make(target) for name, make in makers.items()}
    counts = Counter(file.name for file in {*files.values()})  # two files may have one name
    components: dict[str, Component] = {}
    for name, file in files.items():
        here = makers[name](replace(target, platforms=()))  # for this machine
        file_name = file.name if counts[file.name] == 1 else f"{name}.fmu"
        components[name] = _component(prepared, name, file, file_name, here)
    return WrittenSystem(
        components, connections, scenario.duration, scenario.step, scenario.coupling
    )


def _component(prepared: Prepared, name: str, file: Path, file_name: str, here: Path) -> Component:
    """Describe a part of the system; `here` is its FMU for this machine."""
    assembly, values = prepared.assembly, prepared.start_values().get(name, {})
    fmu = read_fmu(here).restructured(values)
    given = {
        scalar: value
        for scalar, value in values.items()
        # Few importers set what is not Real.
        if isinstance(value, float) or value != assembly.scalars[name, scalar].start
    }
    steps = assembly.steps.get(name, 1)
    return Component(file, file_name, fmu.fmi, fmu.variables, fmu.units, given, steps)


class Player:
    """The FMU that plays a scenario's external inputs, one row for each step.

    Values that never change are start values; the others are `played`, and end early with rows of
    the table by what is `felt`.
    """

    def __init__(self, prepared: Prepared) -> None:
        self._prepared, assembly = prepared, prepared.assembly
        constant = {name for name, driven in assembly.driven.items() if len(driven.values) == 1}
        ends = [end for end in assembly.external if end not in constant]
        counts = Counter(name for _, name in ends)
        self.played = {name if counts[name] == 1 else f"{i}.{name}": (i, name) for i, name in ends}
        self._guarded = prepared.inputs().guarded
        self._felt: dict[Name, Variable] = {}
        for signal in sorted(self._guarded.signals):
            instance, name = split("", signal, assembly.interfaces)
            self._felt[instance, name] = replace(
                assembly.interfaces[instance].variable(name), causality="input",
                variability="continuous", start=0.0, on_request=False, source="",
            )  # fmt: skip

    def connections(self, player: str) -> list[Connection]:
        """Connections from and to the FMU of this name."""
        felt = [
            Connection((instance, scalar), (player, scalar))
            for (instance, _), variable in self._felt.items()
            for scalar in variable.names()
        ]
        return [*(Connection((player, name), end) for name, end in self.played.items()), *felt]

    def make(self, target: Target | None = None) -> Path:
        """Build it."""
        rows = self._rows()
        ours = [name for v in TRAJECTORY.of("output") for name in v.names()]
        if [*self.played] == ours and not self._felt:
            return build_trajectory(rows, target=target)
        variables = (*self._felt.values(), *self._variables())
        interface = Interface(TRAJECTORY.model, "Plays a scenario's inputs", variables)
        content = {"table": rows} | (self._guarded.packed(len(rows)) if self._felt else {})
        options = [(name, f"{name}.bin") for name in content]
        options += [("moving", self._moving)] if self._felt else []
        resources = {f"{name}.bin": each.astype("<f8").tobytes() for name, each in content.items()}
        step = self._prepared.scenario.step
        player = NativeFmu(interface, "player", LAW, resources, tuple(options), step_size=step)
        return build_fmu(player, target=target)

    def _rows(self) -> Array:
        scenario, external = self._prepared.scenario, self._prepared.assembly.external
        if self._felt:  # rows after the end are played once others have ended early
            ticks = max(scenario.ticks, math.ceil(scenario.rows[-1].time / scenario.step))
            scenario = replace(scenario, duration=round(ticks * scenario.step, 9))
        columns = [external.index(end) for end in self.played.values()]
        return self._prepared.inputs(scenario)[: scenario.ticks + 1][:, columns]

    @property
    def _moving(self) -> str:
        """The last output that moves with the table; pushes, which do not, are the first."""
        stay = () if self._prepared.scenario.inputs_move else self._prepared.assembly.driven
        return [name for name, end in self.played.items() if end not in stay][-1]

    def _variables(self) -> Iterator[Variable]:
        for name, end in self.played.items():
            scalar = self._prepared.assembly.scalars[end]
            if (kind := type_of(scalar.variable)) != "Float64":
                must = "must be a Real, or a value that does not change over time"
                raise InputError(f"[inputs] {scalar.name}: is of type {kind}; {must}")
            yield Variable(
                name, (), scalar.unit, "output", "continuous", scalar.variable.description
            )
