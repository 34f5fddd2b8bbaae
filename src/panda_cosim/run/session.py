"""A run stepped by the caller, who can change parameters, pushes and waypoints on the way.

    with Session("pick_and_place") as session:
        session.step(1000)
        session.set("controller.kp", 6)
        session.set("plant.push_force", (0, 5, 0))
        session.step(100)
        session.release("plant.push_force")
        session.finish()

It is recorded like any run, and each action is journalled: `replay` and
`panda-cosim replay` repeat it bit for bit.
"""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..assets import STEP_SIZE
from ..fmus.errors import InputError, SimulationError
from ..fmus.interface.parameters import ParameterValue
from ..fmus.interface.plant import FORCES
from ..fmus.interface.tables import INTERFACES
from ..fmus.interface.variables import Scalar, Value
from ..fmus.master.step import Coupling
from ..fmus.master.wiring import Array
from ..task.scenario import Push, Scenario, load_scenario
from ..task.table import TrajectoryTable
from ..task.trajectory import StartPose, Trajectory
from ..task.typed import typed
from ..task.values import Values
from .execution import Execution, Progress
from .folder import keep_scenario, refuse_existing
from .inputs import Inputs
from .journal import Act, Action, Adjustments, Head, MoveWaypoint, Release, Set, SetCoupling
from .options import Options
from .output import Output
from .prepare import prepare
from .start import start_pose
from .stopping import stopping_on_signals
from .system.assembly import with_parameter_set

_DIGITS: Final = 9  # of a time in a scenario [s]; a tick is 1e-3


def _all_pushes(rows: Array, inputs: Inputs) -> Iterator[Push]:
    """Yield the pushes on all bodies, one for each span of constant force [N]."""
    for body, name in FORCES.items():
        if f"plant.{name}" not in inputs:
            continue
        force = rows[:, inputs.columns(f"plant.{name}")]
        changes = np.flatnonzero(np.diff(force, axis=0).any(axis=1)) + 1
        for first, last in itertools.pairwise([0, *changes.tolist(), len(force)]):
            if force[first].any():
                start, duration = (
                    round(ticks * STEP_SIZE, _DIGITS) for ticks in (first, last - first)
                )
                newton = tuple(force[first].tolist())
                yield Push(start=start, duration=duration, force=newton, on=body)


@dataclass(frozen=True, eq=False)
class Saved:
    """A session as it was at a tick, to which `Session.restore` returns."""

    output: Output  # of the run that it belongs to
    place: int  # of the FMUs' states
    tick: int
    row: Array
    actions: list[Action]
    adjustments: Adjustments
    mark: tuple[tuple[int, int], int]  # in recording and journal


@typed
class Session(Execution):
    """A scenario stepped by the caller. One thread at a time may use it.

    A context manager: entering opens the FMUs and the run's folder, leaving ends the run.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it; pacing and time limits are up to the caller.
        values: Values to change, by key.
        ssv: Parameter set of SSP, by FMU.VARIABLE, in any units; `values` go before it.

    Attributes:
        scenario: As it is run.
        folder: The run's folder.
        interfaces: Variables of each FMU.
        actions: Actions so far.
        warnings: Messages of the FMUs, and what runs in Python because it was changed.
        failure: Why the run failed; "" if it has not.

    Raises:
        InputError: A scenario, folder or option is invalid.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        out: Path | str | None = None,
        options: Options | None = None,
        *,
        values: Values | None = None,
        ssv: Path | str | None = None,
    ) -> None:
        options, loaded = options or Options(), load_scenario(scenario)
        scenario = with_parameter_set(loaded, ssv, values or {}, options.kind)
        if options.realtime or options.time_limit is not None:
            raise InputError("realtime, time_limit: do not apply to a session; its caller steps it")
        super().__init__(prepare(scenario, options, interactive=True), out, journals=True)
        self.interfaces = self.prepared.assembly.interfaces
        self._places = count(1)  # of saved states
        self._saved: list[int] = []  # those that lie in this run's past

    def restart(self) -> None:
        """End this run, keep its folder, and open a new run in a new folder at t = 0."""
        if self._stack is not None:
            self.close()
        self.open()

    # Stepping.

    @property
    def is_open(self) -> bool:
        """Whether a run is under way; false after `close` or a failed `restart`."""
        return self._stack is not None

    def step(self, n: int = 1, progress: Progress | None = None) -> int:
        """Take communication steps as fast as possible; pace and pauses are the caller's.

        Args:
            n: Number of steps, of 1 ms unless a system sets `step`; fewer at the scenario's
                end.
            progress: Called with the completed and the total steps.

        Returns:
            Number of steps taken.

        Raises:
            SimulationError: An FMU fails; the run is over, and what was recorded is kept.
            KeyboardInterrupt: Ctrl-C, after the step under way.
        """
        if isinstance(n, bool) or n < 0:
            raise InputError(f"step: {n!r} steps; must be a whole number of at least 0")
        first = self.tick
        with stopping_on_signals() as stop:
            self.advance(min(first + int(n), self.ticks), stop, progress)
        if stop.signal:
            signal.raise_signal(stop.signal)  # back to the previous handlers
        return self.tick - first

    def finish(self) -> int:
        """Step to the scenario's end; returns the number of steps taken."""
        return self.step(self.ticks - self.tick)

    # Reading.

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of a row's values: `time`, then `plant.push_force[1]` and so on."""
        return self._begun.signals

    @property
    def head(self) -> Head:
        """Scenario and FMUs, as the journal has them."""
        return self._begun.head

    def row(self) -> Array:
        """Current values (len(signals),), of type object if a float64 cannot hold some of them.

        The controller's outputs are those of the last tick; its next step is still to come.
        """
        self._check_open()
        row = self._master.latest()
        external = self._adjustments.inputs[self.tick : self.tick + 1][0]
        row[1 : 1 + len(external)] = external
        return row

    def state(self) -> dict[str, float | str | bytes]:
        """Current values by signal, see `row`."""
        return dict(zip(self.signals, self.row().tolist(), strict=True))

    def numbers(self) -> dict[str, float]:
        """Current values of the signals that are numbers, see `row`."""
        texts = (str, bytes)
        return {n: float(v) for n, v in self.state().items() if not isinstance(v, texts)}

    @property
    def table(self) -> TrajectoryTable:
        """The current trajectory table; raises InputError if the scenario is a system."""
        if table := self._adjustments.inputs.table:
            return table
        raise InputError(f"{self.scenario.name}: a system has no trajectory table")

    @property
    def is_panda(self) -> bool:
        """Whether the plant is the project's own."""
        return self.interfaces.get("plant") is INTERFACES["plant"]

    @property
    def trajectory(self) -> Trajectory:
        """The current commanded path: the table's rows in the world; a system has none."""
        assert self.table
        return self._adjustments.inputs.guarded.path

    @property
    def start_pose(self) -> StartPose:
        """Poses of hand and block that the table refers to, the block's as the camera sees it."""
        return start_pose(self.prepared.values)

    @property
    def held(self) -> list[str]:
        """Scalar inputs that `set` holds, as `plant.push_force[1]`."""
        return self._adjustments.inputs.held

    @property
    def coupling(self) -> Coupling:
        """The current coupling."""
        return self._master.coupling

    @property
    def parameters(self) -> dict[str, dict[str, Value]]:
        """Current values of all parameters by instance and scalar variable."""
        return {instance: dict(values) for instance, values in self._adjustments.values.items()}

    @property
    def tunables(self) -> dict[str, Scalar]:
        """Parameters that `set` can change, with unit, bounds and description."""
        return self._adjustments.tunables

    # Actions.

    def set(self, name: str, value: ParameterValue) -> None:
        """Set a tunable parameter, or hold an input at a value until it is released.

        Args:
            name: `controller.kp` (all joints), `controller.kp[3]`; an external input:
                `plant.push_force`, `plant.block_force` [N], `controller.pos_cmd` [m] and the
                other commands.
            value: One for all scalars, or one per scalar.

        Raises:
            InputError: The name is unknown, the parameter is fixed, or the value is out of
                bounds; nothing has changed then.
            SimulationError: The FMU rejects it; the run is over.
        """
        self.act(Set(name=name, value=value))

    def release(self, name: str) -> None:
        """Give an input held by `set` back to the scenario.

        Raises:
            InputError: It is not held.
        """
        self.act(Release(name=name))

    def move_waypoint(self, row: int, **changes: Any) -> None:
        """Change a later row of the trajectory table, from the next tick on.

        If the hand is already on its way there, the commands jump by the change times the
        share of the way covered.

        Args:
            row: Index of the row, from 0.
            changes: `time` [s], `frame`, `position` [m], `orientation` (w, x, y, z), `grip` [m].

        Raises:
            InputError: The row has passed, or a value is out of bounds.
        """
        self.act(MoveWaypoint(row=row, **changes))

    def set_coupling(self, coupling: Coupling) -> None:
        """Change the coupling from the next tick on: "gauss-seidel" or "jacobi".

        Raises:
            InputError: There is no such coupling.
        """
        self.act(SetCoupling(coupling=coupling))

    def act(self, act: Act) -> None:
        """Take an action: check it, change the FMUs, and write it to the journal."""
        self._check_open()
        action = Action(self.tick, act)
        parameters = self._adjustments.take(action)
        with self._guarded():
            for instance, values in parameters.items():
                self._begun.system.slaves[instance].set_values(values)
        if self._adjustments.coupling != self.coupling:
            self._master.couple(self._adjustments.coupling)
        self._note(action)

    # Going back.

    def save(self) -> Saved:
        """Save the session as it is: the FMUs' states, inputs, actions and recording.

        Raises:
            InputError: An FMU cannot save its state; it is named.
        """
        self._check_open()
        for name, fmu in self._begun.system.fmus.items():
            fmu.check_restorable(name)
        place = next(self._places)
        try:
            row = self._master.save(place)
        except SimulationError as error:
            raise InputError(f"save: {error}") from error
        self._saved.append(place)
        adjustments, mark = self._adjustments.copied(), self._begun.mark()
        return Saved(self._begun, place, self.tick, row, [*self.actions], adjustments, mark)

    def restore(self, saved: Saved) -> None:
        """Return to what was saved in this run, as often as you like, with the same bits.

        What came after is dropped from recording and journal, as if it had not happened; states
        that were saved then are, too.

        Raises:
            InputError: It was saved in another run or has been dropped, or this run is over.
        """
        self._check_open()
        if saved.output is not self._begun or saved.place not in self._saved:
            raise InputError("restore: was saved in another run, or has been dropped by a restore")
        del self._saved[self._saved.index(saved.place) + 1 :]
        self._adjustments, self.actions = saved.adjustments.copied(), [*saved.actions]
        with self._guarded():
            self._master.couple(self._adjustments.coupling)
            self._master.restore(saved.place, saved.tick, saved.row)
        self._begun.go_back(saved.mark)

    # Keeping it.

    def as_scenario(self) -> Scenario:
        """Return a scenario that gives the same bits up to the current time.

        Its criteria are within that time, and its external inputs are computed and compared.

        Raises:
            InputError: An action cannot be written as a scenario; it is named.
        """
        if self.tick == 0:
            raise InputError("session: no step yet; a scenario needs at least one")
        scenario, adjustments = self.scenario, Adjustments(self.prepared)
        inputs, rows, first = adjustments.inputs, [], 0
        started = scenario
        for action in self.actions:
            rows.append(inputs[first : action.tick])
            first = action.tick
            started = started.changed(self._at_start(action))
            adjustments.take(action)
        session = np.vstack([*rows, inputs[first : self.tick]])
        start = self.prepared.assembly.start_time
        duration = round(self.tick * scenario.step, _DIGITS)
        written = replace(
            started,
            coupling=adjustments.coupling,
            table=inputs.table,
            duration=duration,
            success=scenario.success.within(start, start + duration),
            push=tuple(_all_pushes(session, inputs)),
            folder=scenario.folder if scenario.has_own_parts else None,
        )
        if written.coupling == "jacobi" and written.controller != scenario.controller:
            raise InputError(
                "session: a parameter was set before the first step, which with Jacobi coupling "
                "acts a tick later than a start value; give it in the session's `values`"
            )
        same = self.prepared.inputs(written)[: self.tick] == session
        if not same.all():
            tick = int(np.flatnonzero(~same.all(axis=1))[0])
            raise InputError(
                f"session: from {self._when(tick)} on, no table gives its commands: they were "
                "held, or a waypoint was moved when the hand was on its way to it"
            )
        return written

    def _at_start(self, action: Action) -> dict[str, ParameterValue]:
        """Values that an action changes, which a scenario has at its start alone."""
        match action.act:
            case Set(name=name, value=value) if name not in self.inputs:
                what, values = f"{name} was set", {name: value}
            case SetCoupling():
                what, values = "the coupling was changed", {}
            case _:
                return {}
        if action.tick > 0:
            when = self._when(action.tick)
            raise InputError(f"session: {what} at {when}; a scenario has it at its start alone")
        return values

    def _when(self, tick: int) -> str:
        start = self.prepared.assembly.start_time
        return f"t = {start + tick * self.scenario.step:.3f} s"

    def keep(self, folder: Path | str) -> None:
        """Write the session as a scenario into a new folder.

        Raises:
            InputError: See `as_scenario`; or the folder is not new.
        """
        scenario = self.as_scenario()
        refuse_existing(Path(folder))
        keep_scenario(scenario, self.prepared.assembly, Path(folder))
