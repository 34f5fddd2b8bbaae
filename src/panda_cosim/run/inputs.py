"""The external inputs of a run, row by row."""

from __future__ import annotations

from copy import copy

import numpy as np

from ..assets import STEP_SIZE
from ..fmus.errors import InputError, valid_names
from ..fmus.interface.plant import FORCES
from ..fmus.interface.tables import INTERFACES
from ..fmus.interface.types import in_row
from ..fmus.master.wiring import Array
from ..task.scenario import Scenario
from ..task.table import TrajectoryTable
from .guarded import GuardedCommands
from .start import StartValues, resolve
from .system.assembly import Assembly

CHUNK = 16_384  # ticks of inputs computed at a time; a whole hour would take 0.4 GB


class Inputs:
    """External inputs of a run, row by row: commands and pushes, and values held instead.

    They are computed chunk by chunk, so that memory stays flat. Inputs that the scenario does not
    give keep their start values.
    """

    def __init__(self, scenario: Scenario, values: StartValues, assembly: Assembly) -> None:
        self._values, self._assembly = values, assembly
        self._names = [".".join(name) for name in assembly.external]
        self._columns: dict[str, list[int]] = {}  # of inputs, and of their elements
        for column, name in enumerate(self._names):
            for each in {name, name.partition("[")[0]}:
                self._columns.setdefault(each, []).append(column)
        self._start = assembly.inputs_at_start(values)
        self._of_plant = [i for i, (fmu, _) in enumerate(assembly.external) if fmu == "plant"]
        self._held: dict[int, float] = {}
        self.guarded = GuardedCommands()
        self.shape = (scenario.ticks + 1, len(self._names))  # instants, inputs
        self.use(scenario)

    # The scenario's values.

    def use(self, scenario: Scenario) -> None:
        """Take commands and pushes from a scenario."""
        self._scenario = scenario
        if scenario.is_commanded:
            self.guarded = GuardedCommands(resolve(scenario, self._values), self.guarded)
            self._check_felt()
        variables = [("plant", FORCES[body]) for body in scenario.pushed]
        variables += [("controller", command) for command in scenario.commands]
        names = [f"{i}.{n}" for i, v in variables for n in INTERFACES[i].variable(v).names()]
        self._from = [i for i, name in enumerate(names) if name in self]
        self._to = [self._columns[names[i]][0] for i in self._from]
        self._chunk = (-1, 0)  # first tick, and early ends of rows
        self._part = np.empty((0, len(self._names)))

    def _check_felt(self) -> None:
        """Refuse rows that end early by what no FMU gives."""
        outputs = self._assembly.outputs.items()
        given = {f"{i}.{name.partition('[')[0]}" for i, names in outputs for name in names}
        for signal in self.guarded.signals - given:
            raise InputError(f"column until: needs {signal}, which is no output of an FMU")

    @property
    def table(self) -> TrajectoryTable | None:
        """The trajectory table, if there is one."""
        return self._scenario.table

    def copied(self) -> Inputs:
        """Return a copy, which later actions and ends of rows do not change."""
        other = copy(self)
        other._held = dict(self._held)
        other.guarded = GuardedCommands(self.guarded.trajectory, self.guarded)
        return other

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
        places = self.guarded.places(ticks) if self._scenario.inputs_move else ticks
        times = self._assembly.start_time + self._scenario.step * places.astype(np.float64)
        for name, driven in self._assembly.driven.items():
            rows[:, self._columns[".".join(name)][0]] = driven.sample(times)
        scenario = [self._forces(STEP_SIZE * ticks.astype(np.float64))]
        if self.guarded.trajectory is not None:
            scenario.append(self.guarded.commands(first, count))
        rows[:, self._to] = np.hstack(scenario)[:, self._from]
        if self._scenario.input_scale != 1.0:
            rows[:, self._of_plant] *= self._scenario.input_scale
        return rows

    def _forces(self, times: Array) -> Array:
        pushed = self._scenario.pushed
        forces = np.zeros((len(times), len(pushed), 3))
        for push in self._scenario.push:
            ends = np.array([push.start, push.start + push.duration]) - STEP_SIZE / 2
            first, last = np.searchsorted(times, ends)
            forces[first:last, pushed.index(push.on)] += push.force
        return forces.reshape(len(times), -1)

    # Values held instead.

    @property
    def held(self) -> list[str]:
        """Held scalars."""
        return [self._names[column] for column in sorted(self._held)]

    def hold(self, name: str, value: object) -> None:
        """Hold `controller.pos_cmd` or one of its scalars: one value for all, or one each."""
        columns = self.columns(name)
        values = value if isinstance(value, list) else [value] * len(columns)
        if len(values) != len(columns):
            must = f"must be {len(columns)} numbers"
            raise InputError(f"{name}: value of {len(values)} items; {must}")
        scalars = [self._assembly.scalars[self._assembly.external[each]] for each in columns]
        held = [in_row(s, s.checked(name, v)) for s, v in zip(scalars, values, strict=True)]
        for column, content in zip(columns, held, strict=True):
            self._held[column] = content + 0.0 if content == 0.0 else content  # no -0.0

    def release(self, name: str) -> None:
        """Give an input the scenario's values again."""
        held = [column for column in self.columns(name) if column in self._held]
        if not held:
            raise InputError(f"{name}: is not held; `set` holds an input")
        for column in held:
            del self._held[column]

    def columns(self, name: str) -> list[int]:
        """Columns of an input, or of one of its elements."""
        if name not in self:
            valid = list(dict.fromkeys(n.partition("[")[0] for n in self._names))
            raise InputError(f"{name}: is not an external input; {valid_names(name, valid)}")
        return self._columns[name]

    def __contains__(self, name: str) -> bool:
        """Return whether there is such an input."""
        return name in self._columns
