"""Prepares a run once: its system, start values and inputs."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..fmus.errors import InputError, printable
from ..fmus.master.calls import without_traceback
from ..fmus.master.system import OpenSystem, open_system
from ..fmus.master.wiring import Array
from ..fmus.twins import IN_RUNS, notice
from ..plant.parameters import BLOCK_HALF_HEIGHT, PlantParameters
from ..task import rotations
from ..task.fields import check_choice
from ..task.scenario import Scenario
from .folder import model_in
from .inputs import Inputs
from .options import Options
from .start import (
    StartValues,
    check_criteria,
    doubts,
    start_pose,
    start_values,
)
from .system.assembly import Assembly, assemble

MOST_WARNINGS = 100  # of an FMU; some warn at every step
# Parameters of an FMU that listens for a program: where, and how long without one [s]; 0: for ever.
LISTENING = frozenset({"address", "port", "connection_timeout"})
ON_LINE = ("delay", "dropout")  # of [mismatch], which FrankaInterface has for its line
PATIENCE = 30.0  # [s] wall time for which FMUs wait for a program, unless they wait for ever


@dataclass(frozen=True, eq=False)
class Prepared:
    """All that a run needs before its FMUs are opened; nothing has been written.

    `prepare` makes it, and refuses bad input on the way, so that `check` and `run` agree. It never
    changes: one can be run again and again. What changes during a run is in `Adjustments`.
    """

    scenario: Scenario  # as it is run
    options: Options
    assembly: Assembly
    values: StartValues  # all parameters by instance and scalar variable
    address: str = ""  # where FMUs listen; "": where their parameters say

    @property
    def listening(self) -> dict[str, tuple[str, int]]:
        """Address and port of the FMUs that listen for a program, by instance."""
        return {
            name: (self.address or str(values["address"]), int(values["port"]))
            for name, values in self.values.items()
            if values.keys() >= LISTENING
        }

    @property
    def waiting(self) -> list[str]:
        """Say which FMUs wait for a program that somebody is to start, and where."""
        text = "{0} waits for a program at {1}, port {2}; Ctrl-C ends the run"
        places = {} if self.scenario.client else self.listening
        return [text.format(name, *place) for name, place in places.items()]

    @property
    def notes(self) -> list[str]:
        """What the user should know, such as unconnected inputs, unsuitable gains, late pushes."""
        parts = self.assembly.parts if self.options.kind == "auto" else ()
        asked = {self.options.master, *(part.own for part in parts)}
        python = notice(twin for twin in IN_RUNS if twin in asked)
        return [*self.assembly.notes, *doubts(self.scenario, self.values), *filter(None, [python])]

    def inputs(self, scenario: Scenario | None = None) -> Inputs:
        """Return the external inputs, of a changed scenario if one is given."""
        return Inputs(scenario or self.scenario, self.values, self.assembly)

    def start_values(self) -> StartValues:
        """Return the start values that the FMUs are given, with those of driven inputs."""
        assembly = self.assembly
        values = assembly.changed(self.values, self.scenario.sections)
        for (instance, name), driven in assembly.driven.items():
            values[instance][name] = driven.at_start(assembly.start_time)
        waits = self.options.waits and not self.scenario.client
        patience = (self.options.time_limit or 0.0) if waits else PATIENCE  # 0: for ever
        for instance, (address, _) in self.listening.items():
            values[instance]["address"] = address
            if "connection_timeout" not in self.scenario.sections.get(instance, {}):
                values[instance]["connection_timeout"] = patience
        return values

    def open(
        self, warnings: list[str], *, longer: float = 0.0
    ) -> AbstractContextManager[OpenSystem]:
        """Build, open and initialize the FMUs; what they warn of is appended to `warnings`.

        `longer`: time for which they can be stepped beyond the scenario's end [s].
        """
        start = self.assembly.start_time
        is_planned = not self.scenario.route or self.scenario.table is not None
        return open_system(
            self.assembly.system,
            self.start_values(),
            start=start,
            stop=start + self.scenario.duration + longer,
            step_size=self.scenario.step,
            coupling=self.scenario.coupling,
            external=self.inputs().at_start() if is_planned else None,
            tolerance=self.scenario.tolerance,
            on_message=_Listener(self.options.log, warnings).hear,
            isolate=self.options.isolate,
            step_timeout=self.options.step_timeout,
            stepper=self.options.master,
        )


class _Listener:
    """Hears what FMUs say: shows what is asked for, and keeps warnings, each once."""

    def __init__(self, shown: Sequence[str], warnings: list[str]) -> None:
        self._shown, self._warnings = shown, warnings
        self._heard: dict[str, set[str]] = defaultdict(set)  # warnings by instance

    def hear(self, instance: str, status: str, text: str) -> None:
        """Hear a message of an FMU."""
        if instance in self._shown:
            print(printable(f"{instance}: [{status}] {text}"), file=sys.stderr, flush=True)
        if status not in ("OK", "Discard") and len(self._heard[instance]) <= MOST_WARNINGS:
            self._keep(instance, "" if status == "Warning" else f" {status.lower()}", text)

    def _keep(self, instance: str, kind: str, text: str) -> None:
        line, before = f"{instance}{kind}: {without_traceback(text)}", self._heard[instance]
        if len(before) == MOST_WARNINGS:
            line = f"{instance}: further messages are left out"
        if line not in before:
            before.add(line)
            self._warnings.append(line)


def prepare(
    scenario: Scenario,
    options: Options | None = None,
    *,
    interactive: bool = False,
    run_code: bool = True,
) -> Prepared:
    """Check a scenario and prepare its run; `check` and all runs begin with this.

    `interactive`: all inputs that nothing feeds can be set from outside. `run_code`: slaves may be
    run to find their variables, and other versions of MuJoCo be downloaded; else a slave raises
    `UnreadSlaveError`, and the installed version stands for one that is not there.
    """
    options = options or Options()
    connected = partial(_connected, options, run_code=run_code, from_outside=interactive)
    if scenario.client:
        scenario.client.words(scenario.folder or Path())  # refuses one that cannot be started
    prepared = connected(_on_line(scenario.changed(options.values)))
    if prepared.scenario.route:
        prepared = connected(_routed(prepared))
    prepared.inputs()  # refuses a table that cannot be resolved
    for name in options.log:
        check_choice("--log", name, prepared.assembly.interfaces)
    return prepared


def _connected(options: Options, scenario: Scenario, **how: bool) -> Prepared:
    assembly = assemble(scenario, options.kind, files=options.fmus, **how)
    check_criteria(scenario, assembly)
    assembly.recorded()  # refuses columns of the same name
    return Prepared(scenario, options, assembly, start_values(scenario, assembly))


def _on_line(scenario: Scenario) -> Scenario:
    """Let commands instead of measurements be late or lost, where they come over a line."""
    mismatch = scenario.mismatch
    line = {name: mismatch.values[name] for name in ON_LINE if name in mismatch.values}
    if not line or scenario.fmus.get("controller") != "franka":
        return scenario
    without = replace(mismatch, delay=0.0, dropout=0.0)
    controller = {"seed": float(mismatch.seed), **line, **scenario.controller}
    return replace(scenario, mismatch=without, controller=controller)


def _routed(prepared: Prepared) -> Scenario:
    """Return the scenario with its table, for the block where the camera sees it."""
    from ..plant.scene import load_scene  # noqa: PLC0415 - few scenarios need it
    from ..task.route.planner import route  # noqa: PLC0415 - see above
    from ..task.route.scene import RouteScene  # noqa: PLC0415 - see above

    scenario, plant = prepared.scenario, prepared.values["plant"]
    mass = float(plant.get("block_mass", 0.0))
    start = start_pose(prepared.values)
    centre = np.array(start.target_position) - np.array([0.0, 0.0, BLOCK_HALF_HEIGHT])
    block = np.concatenate((centre, rotations.about_z(start.block_yaw)))
    if "plant" in scenario.fmus:
        model, qpos = _own_scene(prepared)
    else:  # no route depends on what the scenes differ in
        model = load_scene(PlantParameters(robot=scenario.robot))
        qpos = model.key("home").qpos
    return route(scenario, RouteScene(model, qpos, block, scenario.robot), mass)


def _own_scene(prepared: Prepared) -> tuple[Any, Array]:
    """Return the model in the plant's FMU, and its positions at the start (nq,)."""
    from ..fmus.sources.model_fmu import load_binary  # noqa: PLC0415 - few scenarios need it

    place = f"[fmus] plant: value {prepared.scenario.fmus['plant']!r}"
    content = model_in(prepared.assembly.system.fmus["plant"])
    if not content or "block_mass" not in prepared.values["plant"]:
        must = "must be a MuJoCo model that extends PandaPlant, for a route to be planned in it"
        raise InputError(f"{place}; {must}")
    names = prepared.assembly.interfaces["plant"].variable("qpos").names()
    with prepared.open([]) as system:
        qpos = np.array(system.slaves["plant"].read(names))
    return load_binary(content, place), qpos
