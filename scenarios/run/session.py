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

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import CosimError, InputError, SimulationError
from ...fmus.interface.parameters import ParameterValue
from ...fmus.interface.tables import INTERFACES
from ...fmus.interface.variables import Scalar, Value
from ...fmus.master.master import RealtimePacer
from ...fmus.master.step import Coupling
from ..recording import AnyRecorder, MemoryRecorder, Recorder, Recording
from ..scenario.scenario import Scenario, load_scenario
from ..scenario.table import TrajectoryTable
from ..scenario.trajectory import StartPose, Trajectory
from .adjustments import Adjustments, as_json
from .exits import exit_guard
from .fmu_files import keep_scenario
from .folders import SCENARIO_FOLDER, claimed_folder, refuse_existing
from .journal import END, JOURNAL_FILE, Action, JournalWriter
from .options import Options
from .prepare import Prepared, prepare
from .result import Run
from .run_files import columns_of, metadata_of, provenance, write_summary
from .start import resolve, start_pose
from .stopping import StopRequest, stopping_on_signals
from .summary import Summary, summarize

Array = NDArray[np.float64]
_REFUSED = ("realtime", "time_limit", "keep_recording")  # options: the caller paces, and stops


class Session:
    """A scenario stepped by the caller. One thread at a time may use it.

    A context manager: entering opens the FMUs and the run's folder, leaving ends the run.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it; pacing and time limits are up to the caller.

    Attributes:
        scenario: As it is run.
        folder: The run's folder.
        signals: Names of a row's values: `time`, then `plant.push_force[1]` and so on.
        interfaces: Variables of each FMU.
        head: Scenario and FMUs, as the journal has them.
        actions: Actions so far.
        warnings: Messages of the FMUs.
        failure: Why the run failed; "" if it has not.

    Raises:
        InputError: Something given cannot be used.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        out: Path | str | None = None,
        options: Options | None = None,
    ) -> None:
        if not isinstance(scenario, Scenario):
            scenario = load_scenario(scenario)
        options = options or Options()
        for name in _REFUSED:
            if getattr(options, name) != getattr(Options(), name):
                raise InputError(f"{name}: does not apply to a session, whose caller steps it")
        self._begin(prepare(scenario, options, interactive=True), out, interactive=True)

    @classmethod
    def of(cls, prepared: Prepared, out: Path | str | None = None, *, writes: bool = True) -> Self:
        """Return a plain run: nothing is set from outside, and no journal is written.

        Args:
            prepared: What is run.
            out: See `Session`.
            writes: Whether there is a folder; else all stays in memory, as for rows of sweeps.
        """
        session = cls.__new__(cls)
        session._begin(prepared, out, interactive=False, writes=writes)
        return session

    def _begin(
        self,
        prepared: Prepared,
        out: Path | str | None,
        *,
        interactive: bool,
        writes: bool = True,
    ) -> None:
        self._prepared, self._interactive, self._writes = prepared, interactive, writes
        self.scenario, self._options = prepared.scenario, prepared.options
        self._start_values, self.interfaces = prepared.values, prepared.assembly.interfaces
        self._adjustments = Adjustments(prepared)
        self._out, self._numbers = None if out is None else Path(out), count(2)
        self._stack: ExitStack | None = None
        self._has_begun = False
        self.actions: list[Action] = []
        self.warnings: list[str] = []
        self.failure = ""
        self.folder = Path()

    # Opening and ending.

    def open(self) -> Self:
        """Open the FMUs and the run's folder, at t = 0.

        Raises:
            InputError: A file or a value cannot be used.
            SimulationError: An FMU fails.
        """
        if self._stack is not None:
            raise InputError("session: is already open; `close` or `restart` ends its run")
        self.actions, self.warnings = [], list(self._prepared.assembly.notes)
        self._adjustments = Adjustments(self._prepared)
        self.failure = ""
        with ExitStack() as stack:
            if self._writes:
                claimed = claimed_folder(self._out, self.scenario.name, retry=self._options.retry)
                self.folder = stack.enter_context(claimed)
            self._place = self.folder.absolute()  # an FMU may change the working directory
            with exit_guard(self.folder):
                self._open_system(stack)
            self._stack = stack.pop_all()
        return self

    def _open_system(self, stack: ExitStack) -> None:
        prepared, assembly = self._prepared, self._prepared.assembly
        opened = stack.enter_context(prepared.open(self.warnings))
        self._opened, self._master = opened, opened.master
        self._has_begun = True
        columns = columns_of(assembly)
        self.signals = tuple(column.name for column in columns)
        metadata = metadata_of(prepared, opened) if self._writes else {}
        if self._interactive:
            metadata |= {"session": JOURNAL_FILE}
        keeps_rows = self._writes and self._options.keep_recording
        make = Recorder if keeps_rows else MemoryRecorder
        self._recorder: AnyRecorder = make(self.folder, columns, metadata)
        stack.enter_context(self._recorder)
        if self._writes:
            # A full disk: the run itself matters more, but a session could not be repeated.
            with nullcontext() if self._interactive else suppress(InputError):
                keep_scenario(self.scenario, assembly, self.folder / SCENARIO_FOLDER)
        if self._interactive:
            self.head = {
                "scenario": self.scenario.name,
                "kind": self._options.kind,
                "fmus": provenance(opened)["fmus"],
            }
            self._journal = JournalWriter(self.folder / JOURNAL_FILE, self.head)
        with self._failure_kept():
            self._master.begin(self._recorder.append)

    def adjustments_at_start(self) -> Adjustments:
        """Return what checks actions from t = 0 on, without opening an FMU."""
        return Adjustments(self._prepared)

    def close(self, reason: str | None = None, *, number: int = 0) -> Run:
        """End the run: complete and judge the recording, free the FMUs.

        Args:
            reason: Why it ends before the scenario does, for the recording.
            number: That of the signal that stopped it, or 0.

        Raises:
            SimulationError: The last row is not finite, or the disk is full.
        """
        if self._stack is None:
            raise InputError("session: is not open; `open` opens it")
        with self._stack:
            self._stack = None
            with self._summarized():
                if not self.failure:
                    self._end(reason)
        return Run(self.folder, self._summary, number, tuple(self.warnings), self._in_memory())

    def _end(self, reason: str | None) -> None:
        self._note(END, **({"reason": reason} if reason else {}))
        self._master.end(self._adjustments.inputs[self.tick : self.tick + 1])
        finished = self.tick == self.ticks
        reason = None if finished else reason or f"the session was ended at t = {self.time:.3f} s"
        self._recorder.close(complete=finished, reason=reason)

    @contextmanager
    def _summarized(self) -> Iterator[None]:
        """Write the summary at the end; a failure before it says more than a full disk then."""
        try:
            yield
        except BaseException:
            with suppress(CosimError):
                self._summarize()
            raise
        with suppress(CosimError) if self.failure else nullcontext():
            self._summarize()

    def _in_memory(self) -> Recording | None:
        """Return the recording, if it is not in the run's folder."""
        recorder = self._recorder
        return recorder.recording() if isinstance(recorder, MemoryRecorder) else None

    def _summarize(self) -> None:
        """Measure and judge what has been recorded, and write the summary."""
        kept = self._in_memory()
        recording = Recording.open(self._place) if kept is None else kept
        self._summary: Summary = summarize(recording, self.scenario, self._master.statistics)
        if self._writes:
            write_summary(self._place, self._summary)

    def __enter__(self) -> Self:
        """Open it."""
        return self.open()

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """End the run, unless it has ended."""
        if self._stack is None:
            return
        if error is None:
            self.close()
            return
        with suppress(CosimError):  # the error being raised says more
            name = type(error).__name__
            self.close(f"{name}: {error}" if str(error) else name)

    def restart(self) -> None:
        """End this run, keep its folder, and open a new run in a new folder at t = 0."""
        first = self._out
        if self._stack is not None:
            self.close()
        if first is not None:
            free = (first.with_name(f"{first.name}-{n}") for n in self._numbers)
            self._out = next(folder for folder in free if not folder.exists())
        try:
            self.open()
        finally:
            self._out = first

    # Stepping.

    @property
    def is_open(self) -> bool:
        """Whether a run is under way; false after `close` or a failed `restart`."""
        return self._stack is not None

    @property
    def tick(self) -> int:
        """Completed steps."""
        self._check_begun()
        return self._master.steps

    @property
    def ticks(self) -> int:
        """Steps from t = 0 to the scenario's end."""
        return self.scenario.ticks

    @property
    def time(self) -> float:
        """Current time [s]."""
        self._check_begun()
        return self._master.time

    def step(self, n: int = 1, progress: Callable[[int, int], None] | None = None) -> int:
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
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 0:
            raise InputError(f"step: {n!r} steps; must be a whole number of at least 0")
        first = self.tick
        with stopping_on_signals() as stop:
            self.advance(min(first + int(n), self.ticks), stop, progress)
        if stop.signal:
            signal.raise_signal(stop.signal)  # back to the previous handlers
        return self.tick - first

    def advance(
        self, last: int, stop: StopRequest, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Step up to a tick, or until asked to stop, at the pace of the options.

        Raises:
            SimulationError: An FMU fails; the run is over, and what was recorded is kept.
        """
        self._check_open()
        master, options = self._master, self._options
        pace = None
        if options.realtime:
            period = self.scenario.step / options.realtime
            pace = RealtimePacer(period, master.statistics).wait

        def look(done: int) -> None:
            stop.poll()
            if progress is not None:
                progress(done, self.ticks)

        stop.watch(master, options.time_limit)
        with self._failure_kept(), exit_guard(self.folder):
            inputs = self._adjustments.inputs
            master.step(last - self.tick, inputs, pace=pace, progress=look)
            master.flush()
        if progress is not None:
            progress(self.tick, self.ticks)

    def finish(self) -> int:
        """Step to the scenario's end; returns the number of steps taken."""
        return self.step(self.ticks - self.tick)

    def _check_begun(self) -> None:
        """Refuse what there is only from the first `open` on; a run that has ended still has it."""
        if not self._has_begun:
            raise InputError("session: is not open; `open` opens it")

    def _check_open(self) -> None:
        if self._stack is None:
            raise InputError("session: is not open; `open` opens it")
        if self.failure:
            raise InputError("session: its run has failed; `restart` begins another")

    def _failure_kept(self) -> ExitStack:
        """End the run if an FMU fails."""
        stack = ExitStack()

        def look(kind: Any, error: BaseException | None, _traceback: Any) -> None:
            if isinstance(error, SimulationError):
                self.failure = str(error)
                with suppress(CosimError):  # the failure itself says more
                    reason = f"{kind.__name__}: {error}"
                    self._recorder.close(complete=False, reason=reason)
                    self._summarize()

        stack.push(look)
        return stack

    # Reading.

    def row(self) -> Array:
        """Current values (len(signals),).

        The controller's outputs are those of the last tick; its next step is still to come.
        """
        self._check_open()
        row = self._master.latest()
        external = self._adjustments.inputs[self.tick : self.tick + 1][0]
        row[1 : 1 + len(external)] = external
        return row

    def state(self) -> dict[str, float]:
        """Current values by signal, see `row`."""
        return dict(zip(self.signals, self.row().tolist(), strict=True))

    @property
    def table(self) -> TrajectoryTable:
        """The current trajectory table."""
        return self._adjustments.inputs.table

    @property
    def is_panda(self) -> bool:
        """Whether the plant is the project's own."""
        return self.interfaces.get("plant") is INTERFACES["plant"]

    @property
    def trajectory(self) -> Trajectory:
        """The current commanded path: the table's rows in the world."""
        return resolve(replace(self.scenario, table=self.table), self._start_values)

    @property
    def start_pose(self) -> StartPose:
        """Poses of hand and block that the table refers to, the block's as the camera sees it."""
        values = self._start_values
        return start_pose(values["plant"], values.get("sensors"))

    @property
    def held(self) -> list[str]:
        """Scalar inputs that `set` holds, as `plant.push_force[1]`."""
        return self._adjustments.inputs.held

    @property
    def coupling(self) -> Coupling:
        """The current coupling."""
        self._check_begun()
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
            SimulationError: The FMU refuses it; the run is over.
        """
        self._check_open()
        change = self._adjustments.set(name, value)
        if change.instance:
            with self._failure_kept(), exit_guard(self.folder):
                self._opened.slaves[change.instance].set_values(change.parameters)
            self._adjustments.note(change)
        self._note("set", name=name, value=change.value)

    def release(self, name: str) -> None:
        """Give an input held by `set` the scenario's values again.

        Raises:
            InputError: It is not held.
        """
        self._check_open()
        self._adjustments.release(name)
        self._note("release", name=name)

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
        self._check_open()
        self._adjustments.move_waypoint(row, changes, self.time)
        self._note("move_waypoint", row=row, **{k: as_json(v) for k, v in changes.items()})

    def set_coupling(self, coupling: Coupling) -> None:
        """Change the coupling from the next tick on: "gauss-seidel" or "jacobi".

        Raises:
            InputError: There is no such coupling.
        """
        self._check_open()
        self._adjustments.check_coupling(coupling)
        self._master.couple(coupling)
        self._note("set_coupling", coupling=coupling)

    def _note(self, action: str, **arguments: Any) -> None:
        self.actions.append(Action(self.tick, action, arguments))
        if self._interactive:
            self._journal.append(self.actions[-1])

    # Keeping it.

    def as_scenario(self) -> Scenario:
        """Return a scenario that gives the same bits up to the current time.

        Raises:
            InputError: An action cannot be written as a scenario; it is named.
        """
        from .session_scenario import as_scenario  # noqa: PLC0415 - few ask for it

        return as_scenario(self.scenario, self.actions, self.tick, self._prepared.inputs)

    def keep(self, folder: Path | str) -> None:
        """Write the session as a scenario into a new folder.

        Raises:
            InputError: See `as_scenario`; or the folder is not new.
        """
        scenario = self.as_scenario()
        refuse_existing(Path(folder))
        keep_scenario(scenario, self._prepared.assembly, Path(folder))
