"""A scenario for other tools: FMUs, one of which plays its inputs, connections and parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from ..fmus.build.native import NativeFmu
from ..fmus.build.ssp import Component, WrittenSystem
from ..fmus.errors import InputError
from ..fmus.interface.tables import TABLE_FILE, TRAJECTORY, Connection
from ..fmus.interface.types import type_of
from ..fmus.interface.variables import Interface, Variable, output
from ..fmus.master.fmu_file import read_fmu
from ..fmus.master.wiring import Name
from ..fmus.sources.targets import Target, build_fmu, build_trajectory
from ..task.scenario import Scenario
from .options import Options
from .prepare import Prepared, prepare

LAW: Final = (
    "Plays a table, one row per step from t = 0 on. After the last row its values are kept."
)

Makers = dict[str, Callable[..., Path]]  # what builds each FMU


def written_system(scenario: Scenario, target: Target) -> WrittenSystem:
    """Build the FMUs of a scenario, and say how they are connected."""
    if scenario.system:
        raise InputError(
            f"scenario {scenario.name!r}: system = {scenario.system!r} is an .ssp file already; "
            "must be a scenario of FMUs"
        )
    prepared = prepare(scenario, Options(kind=target.kind))
    makers: Makers = {part.name: part.make for part in prepared.assembly.parts}
    connections = [*prepared.assembly.connections, *_add_player(prepared, makers)]
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


def _add_player(prepared: Prepared, makers: Makers) -> list[Connection]:
    """Add the FMU that plays inputs, if there are some, and return its connections."""
    # Values that never change are start values; the others are played.
    assembly = prepared.assembly
    constant = {name for name, driven in assembly.driven.items() if len(driven.values) == 1}
    played = [name for name in assembly.external if name not in constant]
    if not played:
        return []
    player = "trajectory"
    while player in makers:
        player += "_"
    counts = Counter(name for _, name in played)
    outputs = [name if counts[name] == 1 else f"{i}.{name}" for i, name in played]
    makers[player] = lambda target: _build_player(prepared, played, outputs, target)
    felt = [
        Connection((signal.partition(".")[0], name), (player, name))
        for signal, variable in _felt(prepared).items()
        for name in variable.names()
    ]
    ends = zip(outputs, played, strict=True)
    return [*(Connection((player, name), end) for name, end in ends), *felt]


def _build_player(
    prepared: Prepared, played: Sequence[Name], outputs: Sequence[str], target: Target
) -> Path:
    """Build the FMU that plays external inputs, one row for each step."""
    assembly, scenario = prepared.assembly, prepared.scenario
    columns = [assembly.external.index(name) for name in played]
    felt = _felt(prepared)
    if felt:  # rows after the end are played once others have ended early
        ticks = max(scenario.ticks, math.ceil(scenario.rows[-1].time / scenario.step))
        scenario = replace(scenario, duration=round(ticks * scenario.step, 9))
    rows = prepared.inputs(scenario)[: scenario.ticks + 1][:, columns]
    if not felt and outputs == [name for v in TRAJECTORY.of("output") for name in v.names()]:
        return build_trajectory(rows, target=target)
    scalars = [assembly.scalars[name] for name in played]
    for scalar in scalars:
        if type_of(scalar.variable) != "Float64":
            raise InputError(
                f"[inputs] {scalar.name}: is of type {type_of(scalar.variable)}; must be a Real, "
                "or a value that does not change over time"
            )
    variables = tuple(
        output(name, (), scalar.unit, scalar.variable.description)
        for name, scalar in zip(outputs, scalars, strict=True)
    )
    interface = Interface(
        TRAJECTORY.model, "Plays a scenario's inputs", (*felt.values(), *variables)
    )
    stay = () if scenario.inputs_move else assembly.driven  # the last ones; pushes are the first
    moving = [o for o, name in zip(outputs, played, strict=True) if name not in stay]
    guards = prepared.inputs().guarded.packed(len(rows)) if felt else {}
    files, content = {"table": TABLE_FILE}, {"table": rows, **guards}
    files |= {name: f"{name}.bin" for name in guards}
    resources = {files[key]: content[key].astype("<f8").tobytes() for key in files}
    options = (*files.items(), *([("moving", moving[-1])] if felt else []))
    player = NativeFmu(interface, "player", LAW, resources, options, step_size=scenario.step)
    return build_fmu(player, target=target)


def _felt(prepared: Prepared) -> dict[str, Variable]:
    """Inputs of the player by which rows of the table end early, by FMU and output."""
    return {
        signal: replace(
            prepared.assembly.interfaces[signal.partition(".")[0]].variable(signal.partition(".")[2]),
            causality="input", variability="continuous", start=0.0, on_request=False, source="",
        )
        for signal in sorted(prepared.inputs().guarded.signals)
    }  # fmt: skip
