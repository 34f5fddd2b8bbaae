"""Prepares a run once: its system, start values and inputs."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..assets import STEP_SIZE
from ..fmus.errors import InputError, did_you_mean
from ..fmus.interface.plant import FORCES
from ..fmus.interface.tables import INTERFACES
from ..fmus.interface.types import in_row
from ..fmus.master.system import OpenSystem, open_system
from ..fmus.twins import IN_RUNS, notice
from ..plant.parameters import BLOCK_HALF_HEIGHT, PlantParameters
from ..task import rotations
from ..task.scenario import Scenario
from .folder import model_in
from .guarded import GuardedCommands
from .options import Options
from .start import (
    StartValues,
    check_criteria,
    late_pushes,
    resolve,
    start_pose,
    start_values,
    unsuitable_gains,
)
from .system.assembly import Assembly, assemble

Array = NDArray[np.float64]
CHUNK = 16_384  # ticks of inputs computed at a time; a whole hour would take 0.4 GB


@dataclass(frozen=True, eq=False)
class Prepared:
    """All that a run needs before its FMUs are opened; nothing has been built or written."""

    scenario: Scenario  # as it is run
    options: Options
    assembly: Assembly
    values: StartValues  # all parameters by instance and scalar variable

    @property
    def notes(self) -> list[str]:
        """What the user should know, such as unconnected inputs, unsuitable gains, late pushes."""
        parts = self.assembly.parts if self.options.kind == "auto" else ()
        asked = {self.options.master, *(part.name for part in parts if part.file is None)}
        python = notice(twin for twin in IN_RUNS if twin in asked)
        gains = unsuitable_gains(self.scenario, self.values)
        late = late_pushes(self.scenario)
        return [*self.assembly.notes, *gains, *late, *filter(None, [python])]

    def inputs(self, scenario: Scenario | None = None) -> Inputs:
        """Return the external inputs, of a changed scenario if one is given."""
        return Inputs(scenario or self.scenario, self.values, self.assembly)

    def start_values(self) -> StartValues:
        """Return the start values that the FMUs are given, with those of driven inputs."""
        assembly = self.assembly
        values = assembly.changed(self.values, self.scenario.sections)
        for (instance, name), driven in assembly.driven.items():
            values[instance] = values.get(instance, {}) | {
                name: driven.at_start(assembly.start_time)
            }
        return values

    def open(
        self, warnings: list[str], *, longer: float = 0.0
    ) -> AbstractContextManager[OpenSystem]:
        """Build, open and initialize the FMUs; their messages are appended to `warnings`.

        `longer`: time for which they can be stepped beyond the scenario's end [s].
        """

        def hear(instance: str, status: str, text: str) -> None:
            kind = "" if status.lower() == "warning" else f" {status.lower()}"
            warnings.append(f"{instance}{kind}: {text}")

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
            on_message=hear,
            isolate=self.options.isolate,
            step_timeout=self.options.step_timeout,
            stepper=self.options.master,
        )


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
    scenario = scenario.changed(options.values)
    connect = partial(_connected, options=options, run_code=run_code, from_outside=interactive)
    if scenario.route:
        scenario = _routed(connect(scenario))
    prepared = connect(scenario)
    prepared.inputs()  # refuses a table that cannot be resolved
    return prepared


def _connected(
    scenario: Scenario, *, options: Options, run_code: bool, from_outside: bool
) -> Prepared:
    """Read and connect the FMUs, and give them start values."""
    assembly = assemble(
        scenario, options.kind, files=options.fmus, run_code=run_code, from_outside=from_outside
    )
    check_criteria(scenario, assembly)
    values = start_values(scenario, assembly)
    assembly.recorded()  # refuses columns of the same name
    return Prepared(scenario, options, assembly, values)


def _routed(prepared: Prepared) -> Scenario:
    """Return the scenario with its table, for the block where the camera sees it."""
    from ..fmus.sources.model_fmu import load_binary  # noqa: PLC0415 - few scenarios need it
    from ..plant.scene import load_scene  # noqa: PLC0415 - see above
    from ..task.route.planner import route  # noqa: PLC0415 - see above
    from ..task.route.scene import RouteScene  # noqa: PLC0415 - see above

    scenario, plant = prepared.scenario, prepared.values["plant"]
    mass = float(plant.get("block_mass", 0.0))
    start = start_pose(plant, prepared.values.get("sensors"))
    centre = np.array(start.target_position) - np.array([0.0, 0.0, BLOCK_HALF_HEIGHT])
    block = np.concatenate((centre, rotations.about_z(start.block_yaw)))
    if "plant" not in scenario.fmus:
        # No route depends on what the scenes differ in.
        model = load_scene(PlantParameters(robot=scenario.robot))
        qpos = model.key("home").qpos
        return route(scenario, RouteScene(model, qpos, block, scenario.robot), mass)
    outputs = prepared.assembly.interfaces["plant"]
    content = model_in(prepared.assembly.system.fmus["plant"])
    if not content or "block_mass" not in plant:
        raise InputError(
            f"[fmus] plant: value {scenario.fmus['plant']!r}; must be a MuJoCo model that extends "
            "PandaPlant, for a route to be planned in it"
        )
    names = outputs.variable("qpos").names()
    qpos = np.empty((1, len(names)))
    with prepared.open([]) as system:
        system.slaves["plant"].bind_get(names, qpos)(0)
    model = load_binary(content, f"[fmus] plant: value {scenario.fmus['plant']!r}")
    return route(scenario, RouteScene(model, qpos[0], block, scenario.robot), mass)


class Inputs:
    """External inputs of a run, row by row: commands and pushes, and values held instead.

    They are computed chunk by chunk, so that memory stays flat. Inputs that the scenario does not
    give keep their start values.
    """

    def __init__(self, scenario: Scenario, values: StartValues, assembly: Assembly) -> None:
        self._values = values
        self._scalars = {".".join(name): assembly.scalars[name] for name in assembly.external}
        self._columns = {name: column for column, name in enumerate(self._scalars)}
        self._assembly = assembly
        self._start = assembly.inputs_at_start(values)
        self._of_plant = [i for i, (fmu, _) in enumerate(assembly.external) if fmu == "plant"]
        self._scale = scenario.input_scale
        self._from_time, self._step = assembly.start_time, scenario.step
        self._held: dict[int, float] = {}
        self.guarded = GuardedCommands()
        self.shape = (scenario.ticks + 1, len(self._columns))  # instants, inputs
        self.use(scenario)

    # The scenario's values.

    def use(self, scenario: Scenario) -> None:
        """Take commands and pushes from a scenario."""
        if not scenario.is_system:
            self.guarded = GuardedCommands(resolve(scenario, self._values), self.guarded)
            outputs = {f"{i}.{n.partition('[')[0]}" for i, names in self._assembly.outputs.items()
                       for n in names}  # fmt: skip
            for signal in self.guarded.signals - outputs:
                raise InputError(f"column until: needs {signal}, which is no output of an FMU")
        self._pushes, self._pushed, self.table = scenario.push, scenario.pushed, scenario.table
        variables = [("plant", FORCES[body]) for body in scenario.pushed]
        variables += [("controller", command) for command in scenario.commands]
        names = [f"{i}.{n}" for i, v in variables for n in INTERFACES[i].variable(v).names()]
        self._from = [i for i, name in enumerate(names) if name in self._columns]
        self._to = [self._columns[names[i]] for i in self._from]
        self._inputs_move = scenario.inputs_move
        self._chunk = (-1, 0)  # first tick, and early ends of rows
        self._part = np.empty((0, len(self._columns)))

    def __getitem__(self, ticks: slice, /) -> Array:
        """Return the rows of a range of ticks, cut off at the last one."""
        start, stop, _ = ticks.indices(self.shape[0])
        rows = np.empty((max(stop - start, 0), self.shape[1]), self._start.dtype)
        for first in range(start - start % CHUNK, stop, CHUNK):
            if (chunk := (first, len(self.guarded.ends))) != self._chunk:
                self._chunk, self._part = chunk, self._computed(first, CHUNK)
            low, high = max(start, first), min(stop, first + CHUNK)
            rows[low - start : high - start] = self._part[low - first : high - first]
        for column, value in self._held.items():
            rows[:, column] = value
        return rows

    def at_start(self) -> Array:
        """Return the row of the start (1, inputs)."""
        return self._computed(0, 1)

    def _computed(self, first: int, count: int) -> Array:
        count = min(count, self.shape[0] - first)
        rows, ticks = np.tile(self._start, (count, 1)), np.arange(first, first + count)
        places = self.guarded.places(ticks) if self._inputs_move else ticks
        for name, driven in self._assembly.driven.items():
            times = self._from_time + self._step * places.astype(np.float64)
            rows[:, self._columns[".".join(name)]] = driven.sample(times)
        if self.guarded.trajectory is not None:
            times = STEP_SIZE * ticks.astype(np.float64)
            commands = self.guarded.commands(first, count)
            scenario = np.hstack((self._forces(times), commands))
            rows[:, self._to] = scenario[:, self._from]
        if self._scale != 1.0:
            rows[:, self._of_plant] *= self._scale
        return rows

    def _forces(self, times: Array) -> Array:
        forces = np.zeros((len(times), len(self._pushed), 3))
        for push in self._pushes:
            active = (times >= push.start - STEP_SIZE / 2) & (
                times < push.start + push.duration - STEP_SIZE / 2
            )
            forces[active, self._pushed.index(push.on)] += push.force
        return forces.reshape(len(times), -1)

    # Values held instead.

    @property
    def held(self) -> list[str]:
        """Held scalars."""
        return [scalar for scalar, column in self._columns.items() if column in self._held]

    def hold(self, name: str, value: object) -> None:
        """Hold `controller.pos_cmd` or one of its scalars: one value for all, or one each."""
        names = self._named(name)
        plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        values = plain if isinstance(plain, list | tuple) else [plain] * len(names)
        if len(values) != len(names):
            raise InputError(f"{name}: value of {len(values)} items; must be {len(names)} numbers")
        held = [self._scalars[n].checked(name, v) for n, v in zip(names, values, strict=True)]
        for each, checked in zip(names, held, strict=True):
            content = in_row(self._scalars[each], checked)
            # -0.0 becomes 0.0
            self._held[self._columns[each]] = content + 0.0 if content == 0.0 else content

    def release(self, name: str) -> None:
        """Give an input the scenario's values again."""
        held = [column for column in self.columns(name) if column in self._held]
        if not held:
            raise InputError(f"{name}: is not held; `set` holds an input")
        for column in held:
            del self._held[column]

    def columns(self, name: str) -> list[int]:
        """Columns of an input."""
        return [self._columns[scalar] for scalar in self._named(name)]

    def _named(self, name: str) -> list[str]:
        """Return the scalars of an input, or the one of that name."""
        names = [n for n in self._columns if name in (n, n.partition("[")[0])]
        if not names:
            valid = list(dict.fromkeys(n.partition("[")[0] for n in self._columns))
            raise InputError(
                f"{name}: is not an external input; valid: {', '.join(valid)}"
                f"{did_you_mean(name, valid)}"
            )
        return names

    def __contains__(self, name: str) -> bool:
        """Return whether there is such an input."""
        return any(name in (n, n.partition("[")[0]) for n in self._columns)
