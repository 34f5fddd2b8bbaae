"""The master: runs coupled FMUs and records all values at the communication points.

It knows nothing of FMI, only the `Slave` protocol, so it can be tested with plain Python slaves.
A run does the following, in this order:

1. `initialize`, while slaves are in initialization mode: values go along the connections at t_0.
2. `begin`: all outputs are read. They belong to t_0.
3. `step`: tick k takes the system from t_k = t_0 + k * step_size to t_k+1. External inputs of t_k
   are written to row k first; the rest is the master's step, `Step.take` in step.py.
4. `end`: leaders take one step more, from the last instant, so that their outputs in its row belong
   to it as in every other; those that would go beyond their stop are only read. It is recorded.

An FMU may end the simulation, as FMI allows. If it ends it together with a step, the others finish
that step. If it ends it within a step, the row at the step's begin is the last; an FMU that is
alone adds that of its end.
"""

from __future__ import annotations

import ctypes
import time as clock
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ...assets import STEP_SIZE
from ..errors import SimulationEndedError, SimulationError
from .kernel import Kernel, make_kernel
from .step import ITERATIONS, Coupling, IteratedStep, Step, Stepper, settle
from .wiring import (
    BLOCK_ROWS,
    Array,
    ExternalInputs,
    Name,
    RowBuffer,
    Slave,
    SlowSlave,
    System,
    bind,
    nothing,
)

Sink = Callable[[Array], None]
Progress = Callable[[int], None]
# [s] wall time for which complete rows are held back at most. The recorder holds rows back, too;
# together, a kill loses at most half a second.
FLUSH_INTERVAL = 0.1


@dataclass
class RunStatistics:
    """Steps, wall time and overruns of a run."""

    steps: int = 0  # completed
    wall_time: float = 0.0  # [s] of all steps
    overruns: int = 0  # ticks that ended too late for real time
    worst_lateness: float = 0.0  # [s] largest delay of a tick
    in_c: int = 0  # steps that the kernel took; FMPy's methods took the others
    spent: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # see `Master.spent`

    @property
    def stepped_by(self) -> str:
        """What took the steps: "kernel", "fmpy", or both, after a change of the coupling."""
        took = {"kernel": self.in_c, "fmpy": self.steps - self.in_c}
        return " and ".join(name for name, count in took.items() if count)


class RealtimePacer:
    """Keeps in step with the wall clock; after a late tick, it may go on from there instead."""

    def __init__(
        self, period: float, statistics: RunStatistics, *, catches_up: bool = True
    ) -> None:
        self._period, self._statistics, self._catches_up = period, statistics, catches_up
        self._start = clock.perf_counter()

    def wait(self, ticks: int) -> None:
        """Sleep until the tick is due, or count an overrun."""
        ahead = self._start + ticks * self._period - clock.perf_counter()
        if ahead > 0:
            clock.sleep(ahead)
        else:
            self._statistics.overruns += 1
            self._statistics.worst_lateness = max(self._statistics.worst_lateness, -ahead)
            self._start -= 0.0 if self._catches_up else ahead


class Master:
    """Steps slaves and records every exchanged value.

    `open_system` makes it of FMUs, tests of plain objects. It is for one run from t_0 on; a run of
    a scenario, with its folder, signals and verdict, is an `Execution`. Steps that go back to a
    state are those of a `PerturbedSystem`.
    """

    timed = False  # whether calls in C are timed, too; those of Python always are

    def __init__(  # noqa: PLR0913 - a run has this many sides
        self,
        slaves: Sequence[Slave],  # in the order of stepping
        system: System,  # whose values go along its connections as they are converted there
        step_size: float = STEP_SIZE,  # communication step size [s]
        coupling: Coupling = "gauss-seidel",
        *,
        start: float = 0.0,  # t_0 [s]
        objects: Collection[Name] = (),  # columns of values that a float64 cannot hold
        stepper: Stepper = "kernel",
        at_end: Collection[str] = (),  # slaves whose outputs belong to the end of their step
    ) -> None:
        self.step_size, self.start = step_size, start
        self.system, self._stepper, self._at_end = system, stepper, at_end
        # Of a row after the time: external inputs, then outputs, as given.
        self.columns = [*system.external, *system.read]
        if coupling == "iterated":
            self.columns.append(ITERATIONS)
        self._buffer = RowBuffer(self.columns, system, start, step_size, objects)
        self.checked = self._buffer.checked  # columns of a row whose values must be finite
        steps = system.steps
        self.slaves = [
            SlowSlave(each, steps[each.name]) if steps.get(each.name, 1) > 1 else each
            for each in slaves
        ]
        self._bound = bind(self.slaves, self.columns, system, self._buffer.rows)
        self._stop = ctypes.c_int32()
        self._kernel: Kernel | None = None
        self._set_coupling(coupling)
        self.statistics = RunStatistics()
        self._flush_at = 0.0  # time of the next flush, by the performance counter

    # A run, in the order given above.

    def initialize(self, external: Array) -> Name | None:
        """Exchange values at t_0, with inputs (1, n); returns a variable that does not settle."""
        self._buffer.set_external(0, external)
        row = self._buffer.rows[0]
        feeding = [each for each in self._bound if any(map(each.feeds, self._bound))]

        def exchange() -> None:
            for slave in self._bound:
                slave.set_inputs(0)
                if slave in feeding:
                    slave.get_outputs(0)

        fed = {column for each in self._bound for column in each.inputs}
        columns = sorted(c for each in feeding for c in each.outputs if c in fed)
        with self._rows_kept():
            for slave in feeding:
                slave.get_outputs(0)
            first = row.copy()
            # Without a loop, as many iterations as there are slaves are exact.
            _, worst = settle(row, columns, exchange, plain=len(self._bound))
            if worst is None:
                return None
            row[:] = first
            for slave in self._bound:
                slave.set_inputs(0)
        return self.columns[worst - 1]

    def begin(self, sink: Sink) -> None:
        """Read all outputs at t_0; the slaves have just been initialized."""
        self.statistics, self._flush_at = RunStatistics(), 0.0
        self._buffer.begin(sink)
        with self._rows_kept():
            for bound in self._bound:
                bound.slave.spent.clear()
                bound.get_outputs(0)
        self._buffer.set_ahead(self._ahead(), 0)

    def step(
        self,
        n: int,
        external: ExternalInputs,
        *,
        pace: Callable[[int], None] | None = None,
        progress: Progress = nothing,
    ) -> int:
        """Take n communication steps, or fewer if `stop_requested` is set."""
        first = self.steps
        with self._rows_kept():
            while (done := self.steps - first) < n and not self.stop_requested:
                count = min(n - done, BLOCK_ROWS - self._row)
                tick = self.steps
                # With those at the last step's end, which iterations need.
                self._buffer.set_external(self._row, external[tick : tick + count + 1])
                self._take_steps(count, pace, progress)
                if self._row == BLOCK_ROWS:
                    self.flush()
                    self._buffer.turn()
        return self.steps - first

    def _take_steps(
        self, count: int, pace: Callable[[int], None] | None, progress: Progress
    ) -> None:
        """Take steps within the buffer's rows; pace, flush and report progress after each."""
        end = self.steps + count
        while self.steps < end and not self.stop_requested:
            self._advance(1 if pace is not None else end - self.steps)
            if pace is not None:
                pace(self.steps)
            if clock.perf_counter() >= self._flush_at:  # in each tick, since a tick may be slow
                self.flush()
                progress(self.steps)
                self._flush_at = clock.perf_counter() + FLUSH_INTERVAL

    def _advance(self, count: int) -> None:
        """Take one step in Python, or as many as can be taken in C in a few milliseconds."""
        statistics, row = self.statistics, self._row
        try:
            if self._kernel is None:
                self._step.take(row, self.time)
                statistics.steps += 1
                return
            taken, self._buffer.filled = self._kernel.take(self.steps, row, count, timed=self.timed)
            statistics.steps += taken
            statistics.in_c += taken
            self._kernel.check(self.time)
        except SimulationEndedError as ended:
            self._end_within(ended)

    def _end_within(self, ended: SimulationEndedError) -> None:
        """Make the row at the begin of the present step the last, see above."""
        self._step.ended, row, rows = ended, self._row, self._buffer.rows
        for leader in self._step.leaders:
            leader.get_outputs(row)
        self._buffer.complete(row)
        if len(self._bound) == 1 and ended.reached > self.time:
            rows[row + 1] = rows[row]
            rows[row + 1, 0] = ended.reached
            self._bound[0].get_outputs(row + 1)
            self._buffer.complete(row + 1)

    @property
    def ended(self) -> SimulationEndedError | None:
        """What an FMU said that has ended the simulation; None: none has."""
        return self._step.ended

    @property
    def stop_requested(self) -> bool:
        """Set it, from a signal handler for example, to return after the present step."""
        return bool(self._stop.value) or self.ended is not None

    @stop_requested.setter
    def stop_requested(self, value: bool) -> None:
        self._stop.value = value

    def end(self, external: Array) -> None:
        """Step the leaders a last time and record the last instant's row; `external` is (1, n)."""
        with self._rows_kept():
            if self._buffer.filled <= self._row:  # else an FMU ended within the step
                self._buffer.set_external(self._row, external)
                self._step.finish(self._row, self.time)
                self._buffer.complete(self._row)
            self.flush()

    # Between steps.

    def couple(self, coupling: Coupling) -> None:
        """Change the coupling from the next step on; leaders' outputs keep their last values."""
        self._buffer.hold(self._row)
        self.flush()
        ended = self.ended
        self._set_coupling(coupling)
        self._step.ended = ended
        self._buffer.set_ahead(self._ahead(), self._row)

    def _ahead(self) -> dict[int, list[int]]:
        """Columns of leaders whose rows have values of the end of the step, by rows of a step."""
        ahead = defaultdict[int, list[int]](list)
        for leader in self._step.leaders:
            if leader.slave.name in self._at_end:
                ahead[self.system.steps.get(leader.slave.name, 1)] += leader.outputs
        return {**ahead}

    def spent(self) -> dict[str, dict[str, float]]:
        """Wall time since `begin` by FMU and call [s]."""
        if self._kernel is not None:
            self._kernel.account()
        return {slave.name: dict(slave.spent) for slave in self.slaves}

    def save(self, place: int) -> Array:
        """Keep the slaves' states in a place; returns the present row, which `restore` takes."""
        self.flush()
        for slave in self.slaves:
            slave.save_state(place)
        self.couple(self.coupling)  # from here on, slaves are told that steps may be undone
        return self.latest()

    def restore(self, place: int, tick: int, row: Array) -> None:
        """Go back to a tick at which states were kept; rows after it are for the sink to drop."""
        for slave in self.slaves:
            slave.restore_state(place)
        self.statistics.steps, self._step.ended = tick, None
        self._buffer.go_back(tick, row)

    def latest(self) -> Array:
        """Copy of the present row; inputs and leaders' outputs are those of the last tick."""
        self._buffer.hold(self._row)
        return np.array(self._buffer.rows[self._row])

    def flush(self) -> None:
        """Give all complete rows to the sink."""
        self._buffer.flush()

    @property
    def steps(self) -> int:
        """Completed steps since `begin`."""
        return self.statistics.steps

    @property
    def time(self) -> float:
        """Time of the present step, or at the end [s]."""
        return self.start + self.steps * self.step_size

    @property
    def _row(self) -> int:
        """Index of the row of the present instant."""
        return self.steps - self._buffer.first

    def _set_coupling(self, coupling: Coupling) -> None:
        buffer, self.coupling = self._buffer, coupling
        self.spent()  # of the kernel that there was
        kind = IteratedStep if coupling == "iterated" else Step
        self._step = kind(self._bound, coupling, self.step_size, buffer.rows, buffer.complete)
        buffer.set_held(self._step.leader_columns)
        self._kernel = None
        if self._stepper == "kernel":
            course = (self.start, self._stop, buffer.checked)
            self._kernel = make_kernel(self._step, buffer.rows, *course)

    @contextmanager
    def _rows_kept(self) -> Iterator[None]:
        """If an error ends the run, pass complete rows to the sink and add the error's time.

        What a slave fails at is often a value that is not finite, which is then the error.
        """
        began = clock.perf_counter()
        try:
            yield
        except BaseException as error:
            cause = self._buffer.non_finite(self._row)
            self._buffer.flush()
            if isinstance(error, SimulationError):
                if cause and error.instance and not error.variable:  # by a slave, not by the sink
                    raise cause from error
                error.time = self.time if error.time is None else error.time
            raise
        finally:
            self.statistics.wall_time += clock.perf_counter() - began
