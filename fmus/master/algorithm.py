"""The master: steps the FMUs and exchanges their values at communication points.

It knows nothing of FMI, only the `Slave` protocol, so it can be tested with plain Python slaves.
A run does the following, in this order:

1. `begin`: all outputs are read. They belong to t_0.
2. `step`: tick k takes the system from t_k = t_0 + k * step_size to t_k+1.
   Gauss-Seidel (`Master._gauss_seidel`): a leader is a slave that feeds a later one. Each leader
   is set, stepped and read, so its outputs act within the same tick. The row of t_k is then
   complete. The followers are set, stepped and read; their outputs belong to t_k+1.
   Jacobi (`Master._jacobi`): the row of t_k is complete from the start. All slaves are set, then
   all are stepped, then all are read; all outputs belong to t_k+1, so they act one tick later.
3. `end`: the row of the last instant is recorded; leaders' outputs keep their last values.

External inputs of t_k are written to the row of t_k before anything else happens in that tick.

Slaves read their inputs from the recording's row of that instant, and write their outputs to it.
There is no other copy of these values.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ..errors import CosimError, InputError, SimulationError
from ..interface.tables import Connection
from .realtime import RealtimePacer, RunStatistics
from .row_buffer import BLOCK_ROWS, ExternalInputs, RowBuffer
from .wiring import Exchange, Name, Slave, bind_inputs, find_sources

Array = NDArray[np.float64]
Sink = Callable[[Array], None]
Coupling = Literal["gauss-seidel", "jacobi"]
COUPLINGS: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")
# [s] wall time for which complete rows are held back at most. The recorder holds rows back, too;
# together, a kill loses at most half a second.
FLUSH_INTERVAL = 0.1


class _Calls(NamedTuple):
    """The functions of one slave that a tick calls; `set` and `get` take the index of a row."""

    set: Exchange
    step: Callable[[float, float], None]
    get: Exchange


class Master:
    """Steps slaves and records every exchanged value.

    Args:
        slaves: In the order of stepping.
        outputs: Scalar outputs to read, by the slave's name.
        connections: Which output feeds which input.
        external: Inputs that the caller gives for each tick.
        step_size: Communication step size [s].
        coupling: "gauss-seidel" or "jacobi".
        start: Start time t_0 [s].
        late_check: Check for values that are not finite in many rows at once, which is faster;
            for slaves that refuse NaN and infinity themselves. Otherwise each row is checked
            before any follower reads it.

    Attributes:
        columns: Instance and variable of each column of a row after the time: external inputs,
            then outputs, in the order given.
        external: Inputs that the caller gives, as passed.
        coupling: As passed, or as changed by `couple`.
        stop_requested: Set it, from a signal handler for example, to return after the present
            step.

    Raises:
        InputError: A connection's source or target does not exist, or an input is fed twice.
    """

    def __init__(  # noqa: PLR0913 - a coupled system has this many parts
        self,
        slaves: Sequence[Slave],
        outputs: Mapping[str, Sequence[str]],
        connections: Sequence[Connection],
        external: Sequence[Name] = (),
        step_size: float = STEP_SIZE,
        coupling: Coupling = "gauss-seidel",
        *,
        start: float = 0.0,
        late_check: bool = False,
    ) -> None:
        self.step_size, self.start = step_size, start
        self._late_check = late_check
        self.external = tuple(external)
        self.columns: list[Name] = list(external)
        for instance, names in outputs.items():
            self.columns += [(instance, name) for name in names]
        self._index = {name: i for i, name in enumerate(self.columns, start=1)}
        self._buffer = RowBuffer(len(self.columns) - len(external), len(external), start, step_size)
        self._sources = find_sources(connections, external, self._index, {s.name for s in slaves})
        self._slaves = {
            slave.name: self._bind(slave, outputs.get(slave.name, ())) for slave in slaves
        }
        self._couple(coupling)
        self.stop_requested = False
        self._statistics = RunStatistics()
        self._flush_at = 0.0  # time of the next flush, by the performance counter

    # A run, in the order given above.

    def begin(self, sink: Sink) -> None:
        """Read all outputs at t_0; the slaves have just been initialized.

        Args:
            sink: Is called with complete rows (n, columns + 1), time [s] first, at least every
                tenth of a second of stepping. The array is reused.

        Raises:
            SimulationError: A slave fails.
        """
        self._statistics, self._flush_at = RunStatistics(), 0.0
        self._buffer.begin(sink)
        with self._rows_kept():
            for slave in self._slaves.values():
                slave.get(0)

    def step(
        self,
        n: int,
        external: ExternalInputs,
        *,
        pace: Callable[[int], None] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> int:
        """Take n communication steps, or fewer if `stop_requested` is set.

        Args:
            n: Number of steps.
            external: External inputs of each tick (at least n, number of external).
            pace: Is called with the completed steps after each tick, to wait for real time.
            progress: Is called with the completed steps a few times a second.

        Returns:
            Number of steps taken.

        Raises:
            SimulationError: A slave fails, or a value is not finite. The sink has then got the
                rows of all completed steps, up to the first that is not finite.
        """
        first = self.steps
        take = self._gauss_seidel if self.coupling == "gauss-seidel" else self._jacobi
        with self._rows_kept():
            while (done := self.steps - first) < n and not self.stop_requested:
                count = min(n - done, BLOCK_ROWS - self._row)
                self._buffer.set_external(self._row, external[done : done + count])
                take(self._ticks(count, pace, progress))
                if self._row == BLOCK_ROWS:
                    self.flush()
                    self._buffer.turn()
        return self.steps - first

    def _gauss_seidel(self, ticks: Iterable[tuple[int, float]]) -> None:
        """Step the leaders, whose outputs act at once, then the followers."""
        leaders, (set_all, step_all, get_all) = self._leaders, self._followers
        step_size, complete, fed_back = self.step_size, self._complete, self._fed_back
        for row, time in ticks:
            for set_inputs, step, get_outputs in leaders:
                set_inputs(row)
                step(time, step_size)
                get_outputs(row)
            complete(row)
            for set_inputs in set_all:
                set_inputs(row)
            for step in step_all:
                step(time, step_size)
            for get_outputs in get_all:
                get_outputs(row + 1)
            if fed_back:  # read by this or an earlier leader in the next tick
                self._buffer.rows[row + 1, fed_back] = self._buffer.rows[row, fed_back]

    def _jacobi(self, ticks: Iterable[tuple[int, float]]) -> None:
        """Step all slaves with the outputs of the tick before."""
        set_all, step_all, get_all = self._followers  # all slaves: there are no leaders
        step_size, complete = self.step_size, self._complete
        for row, time in ticks:
            complete(row)
            for set_inputs in set_all:
                set_inputs(row)
            for step in step_all:
                step(time, step_size)
            for get_outputs in get_all:
                get_outputs(row + 1)

    def _ticks(
        self,
        count: int,
        pace: Callable[[int], None] | None,
        progress: Callable[[int], None] | None,
    ) -> Iterator[tuple[int, float]]:
        """Yield row and time [s] of each tick; pace, flush and report progress after it."""
        first, start, step_size = self._buffer.first, self.start, self.step_size
        statistics, now = self._statistics, clock.perf_counter
        for k in range(statistics.steps, statistics.steps + count):
            if self.stop_requested:
                return
            yield k - first, start + k * step_size
            statistics.steps = k + 1
            if pace is not None:
                pace(k + 1)
            if now() >= self._flush_at:  # checked in each tick, since a tick may be slow
                self.flush()
                if progress is not None:
                    progress(k + 1)
                self._flush_at = now() + FLUSH_INTERVAL

    def end(self, external: Array) -> None:
        """Record the row of the last instant.

        Args:
            external: External inputs at that instant (1, number of external).

        Raises:
            SimulationError: A value is not finite.
        """
        with self._rows_kept():
            self._buffer.hold(self._row)
            self._buffer.set_external(self._row, external)
            self._buffer.filled = self._row + 1
            self.flush()

    def run(
        self,
        steps: int,
        external: ExternalInputs,
        sink: Sink,
        *,
        realtime: float = 0.0,
        progress: Callable[[int], None] | None = None,
    ) -> RunStatistics:
        """Run from t_0 to the end, or until `stop_requested` is set.

        Args:
            steps: Number of communication steps.
            external: External inputs at each instant (steps + 1, number of external).
            sink: Is called with complete rows, see `begin`.
            realtime: Speed relative to the wall clock; 0: as fast as possible.
            progress: Is called with the number of completed steps, a few times a second.

        Returns:
            Steps, wall time and overruns.

        Raises:
            SimulationError: See `step`.
        """
        if external.shape != (steps + 1, self._buffer.external):
            raise ValueError(
                f"external: shape {external.shape}; must be {(steps + 1, self._buffer.external)}"
            )
        self.begin(sink)
        pacer = RealtimePacer(self.step_size / realtime, self._statistics) if realtime > 0 else None
        self.step(steps, external, pace=pacer.wait if pacer else None, progress=progress)
        if self.steps < steps:
            self.flush()
            return self._statistics
        self.end(external[steps : steps + 1])
        if progress is not None:
            progress(steps)
        return self._statistics

    # Between steps.

    def couple(self, coupling: Coupling) -> None:
        """Change the coupling from the next step on.

        Leaders' outputs keep the values of the last tick, as in `end`.

        Raises:
            InputError: There is no such coupling.
        """
        self._buffer.hold(self._row)
        self._couple(coupling)

    def latest(self) -> Array:
        """Copy of the present row (columns + 1,).

        External inputs and outputs of leaders are still those of the last tick.
        """
        self._buffer.hold(self._row)
        row: Array = self._buffer.rows[self._row].copy()
        return row

    def flush(self) -> None:
        """Give all complete rows to the sink now.

        Raises:
            SimulationError: A value is not finite.
        """
        non_finite = self._buffer.flush()
        if non_finite is not None:
            raise self._not_finite(non_finite)

    @property
    def statistics(self) -> RunStatistics:
        """Steps, wall time and overruns so far."""
        return self._statistics

    @property
    def steps(self) -> int:
        """Completed steps since `begin`."""
        return self._statistics.steps

    @property
    def time(self) -> float:
        """Time of the present step, or at the end [s]."""
        return self.start + self.steps * self.step_size

    @property
    def _row(self) -> int:
        """Index of the row of the present instant."""
        return self.steps - self._buffer.first

    # Leaders and followers, and the columns of their values.

    def _bind(self, slave: Slave, outputs: Sequence[str]) -> _Calls:
        rows, inputs = self._buffer.rows, self._sources[slave.name]
        set_inputs: Exchange = _nothing
        get_outputs: Exchange = _nothing
        if outputs:
            first = self._index[(slave.name, outputs[0])]
            get_outputs = slave.bind_get(outputs, rows[:, first : first + len(outputs)])
        if inputs:
            set_inputs = bind_inputs(slave, inputs, rows)
        return _Calls(set_inputs, slave.step, get_outputs)

    def _couple(self, coupling: Coupling) -> None:
        """Separate the slaves that feed a later one from the others."""
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.coupling = coupling
        names = list(self._slaves)
        leaders = [
            name
            for i, name in enumerate(names)
            if coupling == "gauss-seidel" and self._fed_by(name) & set(names[i + 1 :])
        ]
        self._leaders = [self._slaves[name] for name in leaders]
        followers = [calls for name, calls in self._slaves.items() if name not in leaders]
        self._followers = (
            [calls.set for calls in followers],
            [calls.step for calls in followers],
            [calls.get for calls in followers],
        )
        # Columns of leaders that feed themselves or an earlier leader: they act one tick later.
        feeding_back = [
            name for i, name in enumerate(leaders) if self._fed_by(name) & set(leaders[: i + 1])
        ]
        self._fed_back = self._columns_of(feeding_back)
        self._buffer.set_held(self._columns_of(leaders))

    def _fed_by(self, name: str) -> set[str]:
        """Names of the slaves that a slave feeds."""
        columns = set(self._columns_of([name]))
        return {fed for fed, inputs in self._sources.items() if columns & set(inputs.values())}

    def _columns_of(self, names: Sequence[str]) -> list[int]:
        """Columns of the slaves' outputs."""
        given = self._buffer.external
        return [i for i, (name, _) in enumerate(self.columns, 1) if i > given and name in names]

    # Values that are not finite, and errors.

    def _complete(self, row: int) -> None:
        """Mark the row of a tick as complete, before any follower reads its values."""
        if not self._late_check and not np.isfinite(self._buffer.rows[row]).all():
            raise self._not_finite(row)
        self._buffer.filled = row + 1

    def _not_finite(self, row: int) -> SimulationError:
        values = self._buffer.rows[row]
        column = int(np.flatnonzero(~np.isfinite(values))[0])
        instance, variable = self.columns[column - 1]
        return SimulationError(
            f"value {values[column]} is not finite",
            time=float(values[0]),
            instance=instance,
            variable=variable,
        )

    @contextmanager
    def _rows_kept(self) -> Iterator[None]:
        """If an error ends the run, pass complete rows to the sink and add the error's time."""
        began = clock.perf_counter()
        try:
            yield
        except SimulationError as error:
            explained = self._explained(error)
            self._buffer.flush()
            if explained is error:
                raise
            raise explained from error
        except BaseException:
            self._buffer.flush()
            raise
        finally:
            self._statistics.wall_time += clock.perf_counter() - began

    def _explained(self, error: SimulationError) -> SimulationError:
        """Add the time to an error; a value that is not finite is the cause, so it goes first."""
        buffer, statistics = self._buffer, self._statistics
        non_finite = buffer.find_non_finite(self._row + 1)
        if non_finite is not None:
            statistics.steps = min(statistics.steps, buffer.first + non_finite)
            if error.instance and not error.variable:  # raised by a slave, not by the sink
                return self._not_finite(non_finite)
        if error.time is None:
            return SimulationError(
                error.message,
                time=self.time,
                instance=error.instance,
                variable=error.variable,
            )
        return error


def _nothing(_row: int, /) -> None:
    """Do nothing: a slave without inputs, or without outputs."""


__all__ = [
    "COUPLINGS",
    "CosimError",
    "Coupling",
    "Exchange",
    "Master",
    "Name",
    "RunStatistics",
    "Slave",
]
